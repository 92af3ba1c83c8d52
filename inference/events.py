"""Events on their way to the loop, from whatever thread they happen in."""

from __future__ import annotations

from collections import deque

from .observer import Event

_MOST = 1000
"""Events that wait at most; the oldest are lost, which a loop that comes round never sees."""


class EventQueue:
    """Collect events until the loop passes them on between two frames."""

    def __init__(self) -> None:
        self._waiting: deque[Event] = deque(maxlen=_MOST)

    def put(self, event: Event) -> None:
        """Add one; from any thread, and while others are being passed on."""
        self._waiting.append(event)

    def take(self) -> list[Event]:
        """Those that wait, oldest first."""
        taken = []
        while self._waiting:
            taken.append(self._waiting.popleft())
        return taken
