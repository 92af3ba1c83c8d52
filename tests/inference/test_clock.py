"""The computer's clock: a suspend counts, and is told from a process that had to wait."""

import sys
import time

import pytest

from tokt.inference.clock import SYSTEM_CLOCK, awake_s

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of a suspend")


def test_a_suspend_counts_and_is_told(monkeypatch):
    started, told = SYSTEM_CLOCK.monotonic(), SYSTEM_CLOCK.suspended()
    awake, real = awake_s(SYSTEM_CLOCK), time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + 3600)
    assert SYSTEM_CLOCK.monotonic() - started > 3599
    assert SYSTEM_CLOCK.suspended() - told == pytest.approx(3600, abs=0.02)
    assert awake_s(SYSTEM_CLOCK) - awake < 3599


def test_a_wait_between_two_looks_at_the_clocks_is_no_suspend(monkeypatch):
    told, real, waits = SYSTEM_CLOCK.suspended(), time.clock_gettime, [0.2, 0.2, 0.0]

    def late(clock: int) -> float:
        time.sleep(waits.pop(0) if waits else 0)
        return real(clock)

    monkeypatch.setattr(time, "clock_gettime", late)
    assert SYSTEM_CLOCK.suspended() - told == pytest.approx(0, abs=0.02)
    assert not waits
