"""How long a call takes, so that a replay can say how long it took then."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from .clock import SYSTEM_CLOCK, Clock

Result = TypeVar("Result")


class Stopwatch(Protocol):
    """Times calls."""

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and the seconds to go by."""


class ClockStopwatch:
    """Times calls by a clock.

    Parameters
    ----------
    clock : Clock
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and how many seconds it took."""
        start = self._clock.monotonic()
        result = call()
        return result, self._clock.monotonic() - start


SYSTEM_STOPWATCH = ClockStopwatch(SYSTEM_CLOCK)
