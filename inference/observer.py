"""Observers: what looks on while the runtime works, and never has a say in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .policy import Judgement
    from .report import Report
    from .sources import Frame


@dataclass(frozen=True)
class Event:
    """Something that happened besides frames, such as a new model.

    Parameters
    ----------
    t : float
        Seconds since 1970 (UTC).
    name : str
        What kind, for programs: ``start``, ``model``, ``camera_lost``, ...
    words : str
        One line for people.
    fields : mapping
        JSON: the figures that belong to it.
    """

    t: float
    name: str
    words: str
    fields: Mapping[str, Any] = field(default_factory=dict)


class Observer:
    """Told of everything by the loop's own thread, after the datagrams are out.

    Each method does nothing here. An observer is quick, and never raises for what a disk or a
    network does.
    """

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """A frame has its verdict.

        Parameters
        ----------
        frame : Frame
            As it was judged; its pictures are not to be written to.
        judgement : Judgement
        report : Report
            What was sent; its verdict may differ from the judgement's, as a late clear is unknown.
        """

    def heartbeat(self, report: Report) -> None:
        """Unknown was said as there was nothing else to say."""

    def event(self, event: Event) -> None:
        """Something else happened."""

    def close(self) -> None:
        """The run is over."""
