"""Reports on their way out: verdicts with their age, heartbeats that say unknown, and who is told.

Two threads publish: the loop its verdicts, and the heartbeat that there has been none for too long,
such as while a detector hangs. One lock keeps their reports in order.
"""

import json
import math
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

from tokt.features.common.errors import counted
from tokt.inference.links.vehicle import VehiclePlace
from tokt.inference.policy.object_tracker import HELD, SEARCHING
from tokt.inference.policy.policy import Judgement

from .clock import Clock
from .config import Limits
from .frame import Frame
from .reason import Fault, Reason
from .report import HEALTH_BYTES, Event, Report
from .verdict import CLEAR, OBSTACLE, Verdict, health_of, unknown_verdict

TICK_S = 0.05
"""Seconds between two looks at whether something has to be said."""

_KEPT_HEARTBEATS = 1000


class Sender(Protocol):
    """A receiver of reports, such as a UDP socket."""

    sent: int  # datagrams or messages that went out
    failed: int  # those that did not
    last_error: str  # why the last of these did not

    def send(self, report: Report) -> None:
        """Pass a report on; never waits and never raises for what the network does."""

    def close(self) -> None:
        """Send nothing more."""


def mark_stale(verdict: Verdict, age_s: float, judging_s: float, stale_s: float) -> Verdict:
    """The same verdict while its frame is young; a clear of an old one is unknown.

    An old obstacle stays one, and says so; nothing is held in an old frame. In seconds: `age_s`
    since the frame arrived, `judging_s` of them that it was being judged, `stale_s` that are old.
    """
    if age_s <= stale_s:
        return verdict
    if verdict.anchor == HELD:
        verdict = replace(verdict, anchor_x=None, anchor_y=None, anchor_size=None, anchor=SEARCHING)
    if verdict.status not in (CLEAR, OBSTACLE):
        return verdict
    came_old = age_s - judging_s > stale_s
    reason, word = (Reason.STALE, "stale") if came_old else (Reason.LATE, "late")
    health = health_of(f"{word}: the frame is {1000 * age_s:.0f} ms old", verdict.health)
    if verdict.status == CLEAR:
        return replace(unknown_verdict(Fault(reason, health)), anchor=verdict.anchor)
    return replace(verdict, health=health, reason=reason)


def mark_overloaded(verdict: Verdict, left_out: int) -> Verdict:
    """The same verdict, which says how many frames before it there was no time for."""
    if left_out == 0:
        return verdict
    frames = counted(left_out, "frame")
    health = health_of(verdict.health, f"overload: no time for {frames} before this one")
    reason = Reason.OVERLOAD if verdict.reason is Reason.OK else verdict.reason
    return replace(verdict, health=health, reason=reason)


def mark_parts(verdict: Verdict, words: Sequence[str]) -> Verdict:
    """The same verdict, whose health names the parts of the run that are not working.

    In the first of the words for which there is room: what a replay compares is never cut short.
    """
    for health in (health_of(verdict.health, each) for each in words if each):
        if len(json.dumps(health)) - 2 <= HEALTH_BYTES:
            return replace(verdict, health=health)
    return verdict


@dataclass(eq=False)
class ReportPublisher:
    """Number the reports and send each to every sender, of which one may be added at any time.

    Only where frames come in real time, live, are they stale or late. `parts_health` gives the
    parts of the run that are not working: at length and in short words.
    """

    senders: Collection[Sender]
    clock: Clock
    limits: Limits
    live: bool
    place: Callable[[], VehiclePlace] = VehiclePlace  # where the vehicle is
    parts_health: Callable[[], Sequence[str]] = tuple
    first_at_once: bool = False  # whether unknown is due before anything has been said

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._seq = 0
        self._latest_frame: Frame | None = None
        self._judging_since: float | None = None
        self._judged_s = self.clock.monotonic()
        self._published_s = -math.inf if self.first_at_once else self._judged_s
        self._heartbeats: deque[Report] = deque(maxlen=_KEPT_HEARTBEATS)

    def begin(self, frame: Frame) -> None:
        """A frame is being judged from now on."""
        with self._lock:
            self._latest_frame = frame
            self._judging_since = self.clock.monotonic()

    def publish(self, frame: Frame, judgement: Judgement, left_out: int = 0) -> Report:
        """Send the report of the frame that `begin` was called for."""
        with self._lock:
            now = self.clock.monotonic()
            since = now if self._judging_since is None else self._judging_since
            age_s = None if frame.arrived is None else now - frame.arrived
            judging_s = now - since
            verdict = mark_overloaded(judgement.verdict, left_out)
            if self.live and age_s is not None:
                verdict = mark_stale(verdict, age_s, judging_s, self.limits.stale_s)
            verdict = mark_parts(verdict, self.parts_health())
            self._judging_since, self._judged_s = None, now
            latency_ms, age_ms = _ms(judging_s), _ms(age_s)
            told = frame.number, frame.t, latency_ms, verdict, age_ms, left_out, self.place()
            return self._send(Report(self._seq + 1, *told), now)

    def heartbeat(self) -> None:
        """Publish unknown, if nothing was published for too long."""
        with self._lock:
            now = self.clock.monotonic()
            if now - self._published_s < self.limits.heartbeat_s:
                return
            frame, t, age_s = self._latest_frame, None, None
            if frame is not None:
                t, age_s = frame.t, None if frame.arrived is None else now - frame.arrived
            verdict = unknown_verdict(self._silence_fault(now))
            parts = self.parts_health()
            verdict = replace(verdict, health=health_of(verdict.health, *parts[:1]))
            age_ms, place = _ms(age_s), self.place()
            report = Report(self._seq + 1, None, t, None, verdict, age_ms, place=place)
            self._heartbeats.append(self._send(report, now))

    @contextmanager
    def heartbeat_thread(self) -> Iterator[Callable[[], bool]]:
        """Let a thread say unknown where nothing is said for too long, in real time.

        Gives what tells whether that thread is alive.
        """
        stopped = threading.Event()

        def beat() -> None:
            while not stopped.wait(TICK_S):
                if self.senders:
                    self.heartbeat()

        thread = threading.Thread(target=beat, name="tokt heartbeat", daemon=True)
        thread.start()
        try:
            yield thread.is_alive
        finally:
            stopped.set()
            thread.join()

    def heartbeats(self) -> list[Report]:
        """Those since the last call, oldest first."""
        with self._lock:
            reports = list(self._heartbeats)
            self._heartbeats.clear()
            return reports

    def _send(self, report: Report, now: float) -> Report:
        self._seq = report.seq
        self._published_s = now
        for sender in list(self.senders):
            sender.send(report)
        return report

    def _silence_fault(self, now: float) -> Fault:
        """Why no report was published."""
        if self._judging_since is not None:
            words = f"a frame has been judged for {now - self._judging_since:.1f} s"
            return Fault(Reason.STALLED, words)
        if self._latest_frame is None:
            return Fault(Reason.NO_FRAME, "no frame has come yet")
        return Fault(Reason.STALE, f"no frame judged for {now - self._judged_s:.1f} s")


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1000 * seconds


class Observer:
    """Told of everything by the loop's own thread, after the datagrams are out.

    Each method does nothing here. An observer is quick, and never raises for what a disk or a
    network does.
    """

    fault: str = ""  # why it does not do its work at present

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """A frame has its verdict; its pictures are not to be written to.

        What was sent, the report's, may differ from the judgement's: a late clear is unknown.
        """

    def heartbeat(self, report: Report) -> None:
        """Unknown was said as there was nothing else to say."""

    def event(self, event: Event) -> None:
        """Something else happened."""

    def close(self) -> None:
        """The run is over."""
