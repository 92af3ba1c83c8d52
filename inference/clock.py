"""Time as the runtime sees it, so that a test can replace it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """The three calls of the standard `time` module that the runtime uses; all in seconds."""

    def time(self) -> float:
        """Seconds since 1970 (UTC): what a frame is stamped with."""

    def monotonic(self) -> float:
        """Seconds since some fixed moment; never steps back: what durations are measured with."""

    def sleep(self, seconds: float, /) -> None:
        """Wait."""


SYSTEM_CLOCK: Clock = time
