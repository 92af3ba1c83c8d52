"""A time of day that is set while a run goes on."""

from collections.abc import Callable

from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.report import Event, Report

CLOCK_SET = "clock_set"
"""Event: the time of day was set, and times in the log do not follow each other there."""
STEP_S = 1.0
"""Seconds between two reports by which no clock is off that is merely corrected (500 ppm)."""


class ClockWatch(Observer):
    """Tell when the time of day was set: ages and order do not depend on it, times in logs do."""

    def __init__(self, clock: Clock, tell: Callable[[Event], None]) -> None:
        self._clock, self._tell = clock, tell
        self._ahead_s = clock.time() - clock.monotonic()

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Compare the two clocks."""
        self.heartbeat(report)

    def heartbeat(self, report: Report) -> None:
        """Compare the two clocks."""
        before_s, self._ahead_s = self._ahead_s, self._clock.time() - self._clock.monotonic()
        by_s = self._ahead_s - before_s
        if abs(by_s) >= STEP_S:
            way = "forward" if by_s > 0 else "back"
            words = f"the time of day was set {way} by {abs(by_s):.0f} s: order is that of seq"
            self._tell(Event(self._clock.time(), CLOCK_SET, words, {"by_s": round(by_s, 3)}))
