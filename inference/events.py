"""Events besides frames, such as a new model, and their way to the loop from any thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_MAX_WAITING = 1000
"""Events that wait at most; the oldest are lost, which a loop that comes round never sees."""


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


class EventQueue:
    """Collect events until the loop passes them on between two frames."""

    def __init__(self) -> None:
        self._waiting: deque[Event] = deque(maxlen=_MAX_WAITING)

    def put(self, event: Event) -> None:
        """Add one; from any thread, and while others are being passed on."""
        self._waiting.append(event)

    def take(self) -> list[Event]:
        """Those that wait, oldest first."""
        taken = []
        while self._waiting:
            taken.append(self._waiting.popleft())
        return taken
