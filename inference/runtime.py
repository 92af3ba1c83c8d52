"""The loop: a frame in, a verdict out to every receiver, then to the observers.

docs/explanation/failsafe.md has the states it can be in, and what each fault comes to.
"""

import threading
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from tokt.features.frames.view_mask import CameraMasks
from tokt.inference.links.vehicle import VehiclePlace
from tokt.inference.policy.policy import Policy

from .clock import Clock
from .config import Limits
from .frame import Frame, Source
from .freshness.frozen_frames import StuckFrameDetector
from .freshness.stale_frames import StaleFrameDetector
from .publisher import Observer, ReportPublisher, Sender
from .report import Event, EventQueue, Report
from .verdict import STATUS_WORDS

_JOIN_S = 2.0


class EveryFrame:
    """Every frame, as soon as the loop asks for it."""

    left_out = 0

    def __init__(self, source: Source) -> None:
        self._frames: Iterator[Frame] = iter(source)
        self.ended = False

    def take(self, wait_s: float) -> Frame | None:
        """The next frame, however long it takes; None if there is none any more."""
        frame = next(self._frames, None)
        self.ended = frame is None
        return frame

    def close(self) -> None:
        """Nothing is left to do."""


class LatestFrameBuffer:
    """The latest frame; older ones that were not taken in time are left out.

    ::

        source ──> its thread ──> latest frame ──> loop          live: never a queue
                                      │
                                      └─ one that is overtaken is counted, and told as missed

    `left_out` frames were overtaken just before the one that was taken last.
    """

    def __init__(self, source: Source) -> None:
        self.left_out = 0
        self._overtaken = 0
        self._source = source
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._finished = False
        self._fault: Exception | None = None
        self._thread = threading.Thread(target=self._read, name="tokt frames", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> bool:
        """Whether the source has ended and its last frame was taken; not where it has failed."""
        with self._changed:
            return self._finished and self._frame is None and self._fault is None

    def _read(self) -> None:
        try:
            for frame in self._source:
                self._put(frame)
        except Exception as error:  # noqa: BLE001 - raised again in the loop's thread, by `take`
            self._fault = error
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify()

    def _put(self, frame: Frame) -> None:
        with self._changed:
            overtaken = self._frame
            if overtaken is not None:
                self._overtaken += 1
                frame = replace(frame, missed=frame.missed + overtaken.missed + 1)
            self._frame = frame
            self._changed.notify()

    def take(self, wait_s: float) -> Frame | None:
        """The latest frame, waiting for one; None if there is none yet, or none any more.

        Raises what the source raised, once its last frame was taken.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._finished, wait_s)
            frame, self._frame = self._frame, None
            self.left_out, self._overtaken = self._overtaken, 0
            if frame is None and self._fault is not None:
                raise self._fault
            return frame

    def close(self) -> None:
        """Stop the source and wait for its thread, though not for ever."""
        self._source.stop()
        self._thread.join(_JOIN_S)


POLL_S = 0.1
"""Longest time in seconds that the loop waits for a frame before it looks for anything else."""


@dataclass
class Summary:
    """A run in numbers, as it ends.

    Its seconds go from the first frame asked for to the last verdict, latencies from when a frame
    was taken up to its verdict.
    """

    frames: int = 0
    obstacle: int = 0
    clear: int = 0
    unknown: int = 0
    heartbeats: int = 0  # times that unknown was said without a frame
    dropped: int = 0  # frames that there was no time for
    reasons: Counter[str] = field(default_factory=Counter)  # of frames' verdicts
    seconds: float = 0.0
    latency_ms_mean: float = 0.0
    latency_ms_max: float = 0.0
    sent: int = 0  # datagrams over all receivers
    send_failures: int = 0  # those that the operating system refused
    log_failures: int = 0  # lines that could not be logged

    def add(self, report: Report) -> None:
        """Count one frame's report."""
        name = STATUS_WORDS[report.verdict.status]
        setattr(self, name, getattr(self, name) + 1)
        self.reasons[report.verdict.reason.value] += 1
        self.frames += 1
        self.dropped += report.left_out
        latency_ms = report.latency_ms or 0.0
        self.latency_ms_mean += (latency_ms - self.latency_ms_mean) / self.frames
        self.latency_ms_max = max(self.latency_ms_max, latency_ms)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {**asdict(self), "reasons": dict(sorted(self.reasons.items()))}


@dataclass(eq=False)
class Runtime:
    """Judge the frames of a source and tell about each.

    Observers are told after the senders, in their order, by the loop's thread. `between` two frames
    the model is exchanged; it gives what there is to tell before the next one. `alive` is called
    each time the loop comes round, at least every `POLL_S` seconds unless a frame is being judged:
    what a watchdog goes by. `place` gives where the vehicle is, for any thread.
    """

    source: Source
    policy: Policy
    senders: Collection[Sender]
    clock: Clock  # durations come from its `monotonic`
    observers: Sequence[Observer] = ()
    limits: Limits = Limits()  # noqa: RUF009 - frozen
    events: EventQueue = field(default_factory=EventQueue)  # passed on between two frames
    between: Callable[[], Sequence[Event]] = tuple
    alive: Callable[[], None] = lambda: None
    place: Callable[[], VehiclePlace] = VehiclePlace
    masks: CameraMasks | None = None  # what is no view; None leaves what the source says
    publisher: ReportPublisher | None = None  # one that has said something before the first frame

    def __post_init__(self) -> None:
        self._stuck_frames = StuckFrameDetector(self.limits)
        self._stale_frames = StaleFrameDetector(self.clock, self.limits)
        self._publisher = self.publisher or ReportPublisher(
            self.senders, self.clock, self.limits, self.source.live, self.place
        )
        self._heartbeat_alive: Callable[[], bool] = lambda: True

    def run(self) -> Summary:
        """Go on until the source ends or is stopped.

        Raises what the source raises: a loop that cannot see ends, and is started anew by who
        watches over it.
        """
        summary = Summary()
        start = self.clock.monotonic()
        buffer = (LatestFrameBuffer if self.source.live else EveryFrame)(self.source)
        try:
            with ExitStack() as threads:
                if self.source.live:
                    thread = self._publisher.heartbeat_thread()
                    self._heartbeat_alive = threads.enter_context(thread)
                while not buffer.ended:
                    self._round(buffer, summary)
                    summary.seconds = self.clock.monotonic() - start
            self._tell_heartbeats(summary)
        finally:
            buffer.close()
            self._tell_events(self.events.take())
        summary.sent = sum(sender.sent for sender in self.senders)
        summary.send_failures = sum(sender.failed for sender in self.senders)
        return summary

    def _tell_events(self, events: Sequence[Event]) -> None:
        for event in events:
            for observer in self.observers:
                observer.event(event)

    def _round(self, buffer: EveryFrame | LatestFrameBuffer, summary: Summary) -> None:
        if not self._heartbeat_alive():
            raise RuntimeError("the heartbeat has failed: nobody would say that the loop hangs")
        self.alive()
        self._tell_events(self.events.take())
        self._tell_events(self.between())
        frame = buffer.take(POLL_S)
        self._tell_heartbeats(summary)
        if frame is not None:
            self._judge(frame, buffer.left_out, summary)

    def _judge(self, frame: Frame, left_out: int, summary: Summary) -> None:
        self._publisher.begin(frame)
        if self.masks is not None:
            frame = replace(frame, masks=self.masks)
        if self.source.live:
            frame = self._stale_frames.remove(frame)
        frame = self._stuck_frames.remove(frame)
        judgement = self.policy.judge(frame)
        report = self._publisher.publish(frame, judgement, left_out)
        summary.add(report)
        self._tell_heartbeats(summary)
        for observer in self.observers:
            observer.judged(frame, judgement, report)
        self._stuck_frames.prepare()

    def _tell_heartbeats(self, summary: Summary) -> None:
        for report in self._publisher.heartbeats():
            summary.heartbeats += 1
            for observer in self.observers:
                observer.heartbeat(report)
