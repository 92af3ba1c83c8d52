"""The status line of a run on a terminal, and its events as lines.

A thread of its own writes, straight to the file descriptor: a terminal that is held (Ctrl-S) or a
pipe that nobody reads keeps this thread waiting, and neither the loop nor Python's own standard
error.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, TextIO

from tokt.features.common.errors import printable
from tokt.inference.clock import Clock
from tokt.inference.publisher import Observer
from tokt.inference.reason import Reason
from tokt.inference.report import Event
from tokt.inference.verdict import CLEAR, OBSTACLE, STATUS_WORDS, UNKNOWN, Verdict

from .run_counts import CountingParts, RunCounts

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

PERIOD_S = 0.2
"""Between two updates."""
SURE = 0.9
"""Least confidence of a trend that is shown: the line is read at a glance."""

_RATE_OVER_S = 2.0
_MAX_WAITING = 200
_JOIN_S = 1.0
_COLUMNS = 80
_STYLES = {OBSTACLE: "bold red", CLEAR: "bold green", UNKNOWN: "bold yellow"}
_ERASE = "\r\x1b[2K"


@dataclass(eq=False)
class StatusLine(Observer):
    """Show a run while it goes on."""

    counts: RunCounts  # an observer of the run, told before this one
    clock: Clock
    stream: TextIO | None = None  # default: standard error; where it is no terminal, events alone
    parts: CountingParts = field(default_factory=CountingParts)

    def __post_init__(self) -> None:
        stream = sys.stderr if self.stream is None else self.stream
        self._out = _Out(stream)
        self._console: Console | None = None
        if stream.isatty() and os.environ.get("TERM") != "dumb":
            from rich.console import Console

            self._console = Console(stderr=True, force_terminal=True)
        self._lines: deque[str] = deque(maxlen=_MAX_WAITING)
        self._seen: deque[tuple[float, int]] = deque()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._show, name="tokt status", daemon=True)
        self._thread.start()

    def event(self, event: Event) -> None:
        """A line of its own."""
        time = datetime.fromtimestamp(event.t, UTC).strftime("%H:%M:%S")
        self._lines.append(printable(f"{time}Z {event.words}"))

    def close(self) -> None:
        """Write what waits, take the line away, and write no more."""
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _show(self) -> None:
        try:
            while not self._closing.wait(PERIOD_S):
                self._update()
            self._update(last=True)
        except OSError:
            return  # the terminal is gone
        finally:
            self._out.close()

    def _update(self, last: bool = False) -> None:
        text = _ERASE if self._console is not None else ""
        while self._lines:
            text += self._lines.popleft() + "\n"
        if self._console is not None and not last:
            text += self.rendered(self._console, self._out.columns())
        if text:
            self._out.write(text)

    def rendered(self, console: Console, columns: int) -> str:
        """The line as a terminal takes it, cut to its width."""
        console.width = max(1, columns - 1)
        with console.capture() as captured:
            console.print(self._text(), end="", no_wrap=True, overflow="crop", highlight=False)
        return captured.get()

    def _text(self) -> Text:
        """What matters most first: a narrow terminal cuts the rest."""
        from rich.text import Text

        counts, now = self.counts, self.clock.monotonic()
        last = counts.last_report
        if last is None:
            return Text("waiting for the first frame")
        verdict = last.verdict
        line = Text(STATUS_WORDS[verdict.status], _STYLES[verdict.status])
        line.append(_nearness(verdict))
        if verdict.reason is not Reason.OK:
            line.append(f" ({verdict.reason.value})")
        for words in list(counts.warnings.values()):
            line.append(f"  {words}", "yellow")
        if last.age_ms is not None:
            line.append(f"  age {last.age_ms + 1000 * (now - counts.last_report_s):.0f} ms")
        if last.latency_ms is not None:
            line.append(f"  latency {last.latency_ms:.0f} ms")
        line.append(f"  {self._rate(now):.1f} fps  {self._tally()}")
        line.append(f"  {'no model' if counts.model is None else counts.model.label}")
        if self.parts.recorder is not None:
            writer = self.parts.recorder.writer
            fault, frames = writer.fault, writer.frames
            words = f"NOT recording: {fault}" if fault else f"{frames} recorded"
            line.append(f"  {words}", "yellow" if fault else "")
        if verdict.reason is not Reason.OK:
            line.append(f"  {verdict.health}")
        line.plain = printable(line.plain)
        return line

    def _tally(self) -> str:
        counts = self.counts
        by_status = dict.fromkeys(STATUS_WORDS.values(), 0)
        for (status, _), n in dict(counts.verdicts).items():
            by_status[status] += n
        words = [f"{counts.frames} frames", f"{by_status['obstacle']} obstacle"]
        words += [f"{by_status['unknown']} unknown"]
        words += [f"{counts.missed} missed"] if counts.missed else []
        words += [f"{counts.heartbeats} heartbeats"] if counts.heartbeats else []
        return ", ".join(words)

    def _rate(self, now: float) -> float:
        """Frames a second over the last seconds."""
        self._seen.append((now, self.counts.frames))
        while len(self._seen) > 2 and now - self._seen[0][0] > _RATE_OVER_S:
            self._seen.popleft()
        (first_s, first), (last_s, last) = self._seen[0], self._seen[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else 0.0


def _nearness(verdict: Verdict) -> str:
    """How far away it is, and whether it comes nearer, as far as that is known."""
    words = "" if verdict.distance_m is None else f" {verdict.distance_m:.1f} m"
    if verdict.trend is not None and (verdict.trend_confidence or 0.0) >= SURE:
        words += f" {verdict.trend}"
    # Where the distance is measured the expansion is the worse clock: docs/explanation/stereo.md.
    if verdict.expansion_contact_s is not None and verdict.distance_m is None:
        words += f", contact in {verdict.expansion_contact_s:.0f} s"
    return words


class _Out:
    """A stream's file descriptor, its own so that nobody closes it under the thread; the stream
    itself where it has none.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._descriptor: int | None = None
        with contextlib.suppress(OSError):  # such as of a StringIO
            self._descriptor = os.dup(stream.fileno())

    def write(self, text: str) -> None:
        if self._descriptor is None:
            self._stream.write(text)
            return
        data = text.encode("utf-8")
        with contextlib.suppress(BlockingIOError):  # a pipe that takes no more, and holds nobody
            while data:
                data = data[os.write(self._descriptor, data) :]

    def columns(self) -> int:
        if self._descriptor is None:
            return _COLUMNS
        try:
            return os.get_terminal_size(self._descriptor).columns or _COLUMNS
        except OSError:
            return _COLUMNS

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
