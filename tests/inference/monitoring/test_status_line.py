"""The status line on a real terminal, and events where there is none."""

import contextlib
import os
import re
import sys
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from tests.waiting import until
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame
from tokt.inference.monitoring import status_line
from tokt.inference.monitoring.run_counts import CountingParts, RunCounts
from tokt.inference.monitoring.status_line import PERIOD_S, StatusLine
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Event, Report
from tokt.inference.verdict import Verdict, unknown_verdict

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a pty")

OBSTACLE = Verdict(1, 3, 4, None, 9.0, 2.34, "texture", "reef/7")
CLEAR = Verdict(0, 0, 0, None, 0.0, None, "texture", "reef/7")
DARK = unknown_verdict(Fault(Reason.DARK, "too dark: \x1b[2J\nmean 3"))


@pytest.fixture
def counts(hand_clock):
    return RunCounts(hand_clock)


@pytest.fixture
def terminal(monkeypatch):
    """Open a terminal of so many columns: the end that shows, and the stream that is written to."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    opened: list[Any] = []

    def start(columns: int) -> tuple[int, Any]:
        import termios

        shown, written = os.openpty()
        termios.tcsetwinsize(written, (24, columns))
        stream = os.fdopen(written, "w")
        opened.extend((stream, os.fdopen(shown, "rb", buffering=0)))
        os.set_blocking(shown, False)
        return shown, stream

    yield start
    for file in opened:
        file.close()


def shown_text(shown: int) -> str:
    data = b""
    while True:
        try:
            data += os.read(shown, 65536)
        except BlockingIOError:
            return data.decode()


def screen(text: str) -> list[str]:
    """What stands on the terminal: lines, the last one that of the cursor."""
    lines = [""]
    for char in text.replace("\r\n", "\n").replace("\r\x1b[2K", "\f"):
        if char == "\f":
            lines[-1] = ""
        elif char == "\n":
            lines.append("")
        else:
            lines[-1] += char
    return [re.sub(r"\x1b\[.*?m", "", line) for line in lines]


def tell(counts: RunCounts, verdict: Verdict, seq: int = 1, **more: Any) -> None:
    report = Report(seq, seq, 1.0, 8.4, verdict, **more)
    counts.judged(Frame(seq, 1.0, None, None), Judgement(verdict), report)


def test_a_trend_that_is_sure_and_a_time_to_contact_are_shown(counts, hand_clock):
    growing = replace(OBSTACLE, trend="growing", trend_confidence=0.95, expansion_contact_s=7.6)
    tell(counts, replace(growing, distance_m=None))
    assert "obstacle growing, contact in 8 s" in text_of(counts, hand_clock)
    tell(counts, growing)  # the distance is measured: the time from the picture alone is not told
    shown = text_of(counts, hand_clock)
    assert "obstacle 2.3 m growing" in shown and "contact" not in shown
    tell(counts, replace(OBSTACLE, trend="growing", trend_confidence=0.85))
    assert "growing" not in text_of(counts, hand_clock)


def text_of(counts: RunCounts, clock: Any, columns: int = 500, **more: Any) -> str:
    """The line as it would be shown."""
    read, write = os.pipe()
    with os.fdopen(write, "w") as stream, os.fdopen(read):
        line = StatusLine(counts, clock, stream, **more)
        line.close()
        console = Console(force_terminal=True, color_system=None)
        return line.rendered(console, columns)


def test_the_line_tells_what_matters(counts, hand_clock):
    assert text_of(counts, hand_clock) == "waiting for the first frame"
    counts.event(Event(0.0, "start", "", {"model": {"label": "reef/7", "sha256": "ab"}}))
    tell(counts, CLEAR, age_ms=10.2)
    tell(counts, OBSTACLE, age_ms=10.2)
    hand_clock.now += 0.05
    assert text_of(counts, hand_clock) == (
        "obstacle 2.3 m  age 60 ms  latency 8 ms  0.0 fps  2 frames, 1 obstacle, 0 unknown  reef/7"
    )
    counts.heartbeat(Report(3, None, None, None, unknown_verdict(Fault(Reason.STALE, "no frame"))))
    text = text_of(counts, hand_clock)
    assert text.startswith("unknown (stale)  0.0 fps") and "1 heartbeats" in text
    assert text.endswith("no frame")


def test_warnings_stand_until_they_are_over(counts, hand_clock):
    tell(counts, OBSTACLE)
    recorder = SimpleNamespace(writer=SimpleNamespace(frames=12, fault=""))
    for name in ("left", "right"):
        counts.event(Event(0.0, "camera_lost", f"the {name} camera is lost", {"camera": name}))
    counts.event(Event(0.0, "drift", "drift: lbp_3"))
    text = text_of(counts, hand_clock, parts=CountingParts(recorder=recorder))
    assert "left camera is lost" in text and "right camera is lost" in text
    assert "drift: lbp_3" in text and "12 recorded" in text
    counts.event(Event(0.0, "camera_back", "", {"camera": "left"}))
    counts.event(Event(0.0, "drift_over", ""))
    recorder.writer.fault = "no space"
    text = text_of(counts, hand_clock, parts=CountingParts(recorder=recorder))
    assert "left" not in text and "right camera is lost" in text and "drift" not in text
    assert "NOT recording: no space" in text


def test_it_fits_the_terminal_and_nothing_moves_the_cursor(counts, hand_clock):
    tell(counts, DARK, age_ms=5.0)
    whole = text_of(counts, hand_clock)
    assert whole.isprintable() and r"\x1b[2J\nmean 3" in whole
    for columns in (1, 2, 20, 80):
        cut = text_of(counts, hand_clock, columns)
        assert whole.startswith(cut.rstrip()) and len(cut) <= max(1, columns - 1)


def test_one_line_is_rewritten_and_events_stand_above_it(terminal):
    shown, stream = terminal(60)
    counts = RunCounts(SYSTEM_CLOCK)
    line = StatusLine(counts, SYSTEM_CLOCK, stream)
    text = ""

    def shows(words: str) -> bool:
        nonlocal text
        text += shown_text(shown)
        return screen(text)[-1].startswith(words)

    began = time.monotonic()
    for seq in range(1, 75):
        tell(counts, CLEAR, seq, age_ms=1.0)
    until(lambda: shows("clear"))
    line.event(Event(3661.0, "model", "model reef/8 runs\x07"))
    for seq in range(75, 150):
        tell(counts, OBSTACLE, seq, age_ms=1.0)
    until(lambda: shows("obstacle 2.3 m  age "))
    took = time.monotonic() - began
    first, second = screen(text)
    assert first == r"01:01:01Z model reef/8 runs\x07"
    assert len(second) <= 59
    assert 2 <= text.count("\x1b[2K") <= took / PERIOD_S + 1
    assert "\x1b[1;31mobstacle" in text
    line.close()
    assert screen(text + shown_text(shown))[1:] == [""]


def test_a_terminal_that_is_held_keeps_nobody_waiting(terminal, monkeypatch):
    monkeypatch.setattr(status_line, "_JOIN_S", 0.2)
    shown, stream = terminal(60)  # nobody reads its other end
    counts = RunCounts(SYSTEM_CLOCK)
    line = StatusLine(counts, SYSTEM_CLOCK, stream)
    for _ in range(3000):
        line.event(Event(0.0, "odd", "x" * 200))
    time.sleep(PERIOD_S * 1.5)
    line.event(Event(0.0, "odd", "one more"))
    line.close()  # where anything waited for the terminal, it would wait for ever
    while True:  # let the thread go
        with contextlib.suppress(BlockingIOError):
            os.read(shown, 65536)
        if not line._thread.is_alive():
            return


def begin(stream: Any, counts: RunCounts) -> None:
    line = StatusLine(counts, SYSTEM_CLOCK, stream)
    line.event(Event(0.0, "start", "it begins"))
    line.close()


def test_a_dumb_terminal_gets_lines_too(terminal, monkeypatch, counts):
    shown, stream = terminal(60)
    monkeypatch.setenv("TERM", "dumb")
    tell(counts, replace(CLEAR, method="disparity"))
    begin(stream, counts)
    assert shown_text(shown) == "00:00:00Z it begins\r\n"


def test_a_reader_that_has_gone_is_no_error(capfd, counts):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as stream:
        begin(stream, counts)
    assert capfd.readouterr().err == ""
