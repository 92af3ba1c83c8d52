"""Time as the runtime sees it, so that a test can replace it."""

import sys
import time
from collections.abc import Callable
from typing import Protocol, TypeVar

Result = TypeVar("Result")
_PRECISE_S = 0.01
_BOOTTIME: int | None = getattr(time, "CLOCK_BOOTTIME", None)  # Linux has it


class Clock(Protocol):
    """The calls that the runtime uses; all in seconds."""

    def time(self) -> float:
        """Seconds since 1970 (UTC): what a frame is stamped with."""

    def monotonic(self) -> float:
        """Seconds since some fixed moment; never steps back: what durations are measured with.

        It goes on while the computer is suspended, and waits (`sleep`, conditions) do not.
        """

    def suspended(self) -> float:
        """Seconds of `monotonic` that the computer was suspended; to `_PRECISE_S`."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""


class SystemClock:
    """The computer's clock. Where it does not tell time that it was suspended, it says 0 of that.

    Linux's CLOCK_MONOTONIC, which Python's `time.monotonic` is, stands still meanwhile: a frame
    would be no older after the night.
    """

    time, sleep = staticmethod(time.time), staticmethod(time.sleep)

    def monotonic(self) -> float:
        """Time since the computer was started, on Linux."""
        if sys.platform == "win32" or _BOOTTIME is None:
            return time.monotonic()
        return time.clock_gettime(_BOOTTIME)

    def suspended(self) -> float:
        """How far the two clocks are apart."""
        while _BOOTTIME is not None:
            before = time.monotonic()
            difference = self.monotonic() - before
            if time.monotonic() - before < _PRECISE_S:  # nothing came between
                return difference
        return 0.0


SYSTEM_CLOCK: Clock = SystemClock()


def awake_s(clock: Clock) -> float:
    """Seconds that the computer ran: what tells that another process or a camera hangs."""
    return clock.monotonic() - clock.suspended()


class Stopwatch:
    """Times calls."""

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and how many seconds it took."""
        start = SYSTEM_CLOCK.monotonic()
        return call(), SYSTEM_CLOCK.monotonic() - start


class FixedStopwatch(Stopwatch):
    """Says of each call that it took `seconds`, however long it does take."""

    seconds = 0.0  # until they are set: never late

    def took(self, call: Callable[[], Result]) -> tuple[Result, float]:
        """Call it; what it gave, and the seconds."""
        return call(), self.seconds


SYSTEM_STOPWATCH = Stopwatch()
