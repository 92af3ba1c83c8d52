"""Observers receive every report and cannot affect verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .events import Event

if TYPE_CHECKING:
    from .frame import Frame
    from .policy.policy import Judgement
    from .report import Report


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
