"""Time as the runtime sees it, so that a test can replace it."""

import time
from collections.abc import Callable
from typing import Protocol, TypeVar

Result = TypeVar("Result")


class Clock(Protocol):
    """The three calls of the standard `time` module that the runtime uses; all in seconds."""

    def time(self) -> float:
        """Seconds since 1970 (UTC): what a frame is stamped with."""

    def monotonic(self) -> float:
        """Seconds since some fixed moment; never steps back: what durations are measured with."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""


SYSTEM_CLOCK: Clock = time


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


class FixedStopwatch:
    """Says of each call that it took so long, however long it does take.

    Attributes
    ----------
    seconds : float
        0 until it is set: never late.
    """

    seconds = 0.0

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and the seconds."""
        return call(), self.seconds


Stopwatch = ClockStopwatch | FixedStopwatch
"""Times calls: gives what a call gave, and the seconds to go by."""
SYSTEM_STOPWATCH = ClockStopwatch(SYSTEM_CLOCK)
