"""What is said, and when: every verdict with its age, and unknown where there is none.

Two threads say something: the loop its verdicts, and the heartbeat that there has been none for
too long, such as while a detector hangs. One lock keeps their reports in order.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

from .aged import aged, overloaded
from .clock import Clock
from .limits import Limits
from .policy import Judgement
from .reason import Fault, Reason
from .report import Report
from .sources import Frame
from .udp import Sender
from .verdict import unknown_verdict

_KEPT_HEARTBEATS = 1000


class Announcer:
    """Number reports and send them.

    Parameters
    ----------
    senders : sequence of Sender
    clock : Clock
    limits : Limits
    live : bool
        Whether frames come in real time: only then are they stale or late.
    """

    def __init__(self, senders: Sequence[Sender], clock: Clock, limits: Limits, live: bool) -> None:
        self._senders = senders
        self._clock = clock
        self._limits = limits
        self._live = live
        self._lock = threading.Lock()
        self._seq = 0
        self._newest: Frame | None = None
        self._taken_up: float | None = None
        self._said = self._judged = clock.monotonic()
        self._unread: deque[Report] = deque(maxlen=_KEPT_HEARTBEATS)

    def take_up(self, frame: Frame) -> None:
        """A frame is being judged from now on."""
        with self._lock:
            self._newest = frame
            self._taken_up = self._clock.monotonic()

    def say(self, frame: Frame, judgement: Judgement, left_out: int = 0) -> Report:
        """Send what the frame that was taken up came to.

        Parameters
        ----------
        frame : Frame
        judgement : Judgement
        left_out : int
            Frames since the one before that there was no time for.
        """
        with self._lock:
            now = self._clock.monotonic()
            taken_up = now if self._taken_up is None else self._taken_up
            age_s = None if frame.arrived is None else now - frame.arrived
            judging_s = now - taken_up
            verdict = overloaded(judgement.verdict, left_out)
            if self._live and age_s is not None:
                verdict = aged(verdict, age_s, judging_s, self._limits.stale_s)
            self._taken_up = None
            t, latency_ms, age_ms = frame.t, _ms(judging_s), _ms(age_s)
            seq = self._seq + 1
            report = Report(seq, frame.number, t, latency_ms, verdict, age_ms, left_out)
            self._judged = now
            return self._send(report, now)

    def heartbeat(self) -> None:
        """Say that nothing is known, if nothing was said for too long."""
        with self._lock:
            now = self._clock.monotonic()
            if now - self._said < self._limits.heartbeat_s:
                return
            frame = self._newest
            age_s = None
            if frame is not None and frame.arrived is not None:
                age_s = now - frame.arrived
            verdict = unknown_verdict(self._silence(now))
            t = None if frame is None else frame.t
            report = Report(self._seq + 1, None, t, None, verdict, _ms(age_s))
            self._unread.append(self._send(report, now))

    def heartbeats(self) -> list[Report]:
        """Those since the last call, oldest first."""
        with self._lock:
            said = list(self._unread)
            self._unread.clear()
            return said

    def _send(self, report: Report, now: float) -> Report:
        self._seq = report.seq
        self._said = now
        for sender in self._senders:
            sender.send(report)
        return report

    def _silence(self, now: float) -> Fault:
        """Why nothing was said."""
        if self._taken_up is not None:
            words = f"a frame has been judged for {now - self._taken_up:.1f} s"
            return Fault(Reason.STALLED, words)
        if self._newest is None:
            return Fault(Reason.NO_FRAME, "no frame has come yet")
        return Fault(Reason.STALE, f"no frame judged for {now - self._judged:.1f} s")


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1000 * seconds
