"""The counts of a run so far: kept by the loop, read from other threads.

No lock: one thread writes, and whoever reads takes whole values (a number, a copy of a list). Two
values read one after the other may be one frame apart.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tokt.inference.clock import Clock
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.recording.run_start import ModelName
from tokt.inference.report import MODEL, START, Event, Report
from tokt.inference.verdict import STATUS_WORDS, UNKNOWN

if TYPE_CHECKING:
    from tokt.inference.recording.recorder import Recorder
    from tokt.inference.recording.run_log import RunLog
    from tokt.inference.sources.cameras.live_source import CameraSource

BOUNDS_S = (
    *(0.001, 0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.075),
    *(0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0),
)
"""Upper bounds of a histogram's buckets in seconds; a frame is stale at 0.5."""

_WARNINGS = (
    "part_failed",
    "camera_lost",
    "receiver_refused",
    "place_lost",
    "place_doubtful",
    "drift",
)


@dataclass(eq=False)
class CountingParts:
    """The parts of a run that count for themselves; each may join it at any time."""

    log: RunLog | None = None
    recorder: Recorder | None = None
    cameras: CameraSource | None = None


class Histogram:
    """A histogram of durations: a count for each of `BOUNDS_S`, and one for what is beyond."""

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)
        self.sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one."""
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.sum_s += seconds


class RunCounts(Observer):
    """Count frames, heartbeats and events.

    Frames are `missed` that were not delivered, where it is known how many: overload's and the
    cameras'. Those of them that the loop had no time for are `left_out`. Times that end in ``_s``
    are the clock's `monotonic`, the others seconds since 1970 (UTC).
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.frames = self.heartbeats = self.missed = self.left_out = 0
        self.verdicts: Counter[tuple[str, ...]] = Counter()  # by status and reason, in words
        self.heartbeat_reasons: Counter[str] = Counter()
        self.events: Counter[str] = Counter()  # by name
        self.latency = Histogram()  # from when a frame was taken up to its verdict
        self.age = Histogram()  # from its arrival to its datagram
        self.last_report: Report | None = None  # of a frame, or a heartbeat
        self.started_t = clock.time()
        self.last_report_s = self.started_s = clock.monotonic()
        self.model: ModelName | None = None
        self.warnings: dict[str, str] = {}  # wrong at present: camera, receiver, place, drift

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Count a frame."""
        self.frames += 1
        verdict = report.verdict
        self.verdicts[STATUS_WORDS[verdict.status], verdict.reason.value] += 1
        if frame.missed < MANY_MISSED:
            self.missed += frame.missed
        self.left_out += report.left_out
        if report.latency_ms is not None:
            self.latency.add(report.latency_ms / 1000)
        if report.age_ms is not None:
            self.age.add(report.age_ms / 1000)
        self._note(report)

    def heartbeat(self, report: Report) -> None:
        """Count a heartbeat."""
        self.heartbeats += 1
        self.heartbeat_reasons[report.verdict.reason.value] += 1
        self._note(report)

    def event(self, event: Event) -> None:
        """Count an event, and note what it changes."""
        self.events[event.name] += 1
        if event.name in (START, MODEL):
            model = event.model
            self.model = ModelName(model["label"], model["sha256"]) if model else None
        kind = event.name.partition("_")[0]
        what = f"{kind} {event.fields.get(kind, '')}"
        if event.name in _WARNINGS:
            self.warnings[what] = event.words
        elif event.name in (
            "part_joined",
            "camera_back",
            "receiver_back",
            "place_back",
            "drift_over",
        ):
            self.warnings.pop(what, None)

    @property
    def unknown(self) -> dict[str, int]:
        """How many frames are unknown, by the code of their reason."""
        return {
            reason: count
            for (status, reason), count in self.verdicts.items()
            if status == STATUS_WORDS[UNKNOWN]
        }

    def _note(self, report: Report) -> None:
        self.last_report, self.last_report_s = report, self._clock.monotonic()
