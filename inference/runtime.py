"""The loop: a frame in, a verdict out to the log and to every receiver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from .clock import Clock
from .log import JsonLines
from .policy import Judgement, Policy
from .report import Report
from .sources import Source
from .udp import Sender
from .verdict import CLEAR, OBSTACLE, UNKNOWN


@dataclass
class Summary:
    """What a run came to.

    Parameters
    ----------
    frames, obstacle, clear, unknown : int
        Frames judged, and how.
    seconds : float
        From the first frame asked for to the last verdict.
    latency_ms_mean, latency_ms_max : float
        From a frame's delivery to its verdict, in milliseconds.
    sent, send_failures : int
        Datagrams over all receivers; a failure is one the operating system refused.
    log_failures : int
        Lines that could not be logged.
    """

    frames: int = 0
    obstacle: int = 0
    clear: int = 0
    unknown: int = 0
    seconds: float = 0.0
    latency_ms_mean: float = 0.0
    latency_ms_max: float = 0.0
    sent: int = 0
    send_failures: int = 0
    log_failures: int = 0

    def add(self, report: Report) -> None:
        """Count one report."""
        name = {OBSTACLE: "obstacle", CLEAR: "clear", UNKNOWN: "unknown"}[report.verdict.status]
        setattr(self, name, getattr(self, name) + 1)
        self.frames += 1
        self.latency_ms_mean += (report.latency_ms - self.latency_ms_mean) / self.frames
        self.latency_ms_max = max(self.latency_ms_max, report.latency_ms)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return asdict(self)


class Runtime:
    """Judge every frame of a source and tell about it.

    Parameters
    ----------
    source : Source
    policy : Policy
    senders : sequence of Sender
    clock : Clock
        Durations come from its `monotonic`.
    log : JsonLines, optional
    log_values : bool
        Whether the log carries each patch's decision values, exact to the last bit: what
        training and serving can be compared by.
    """

    def __init__(
        self,
        source: Source,
        policy: Policy,
        senders: Sequence[Sender],
        clock: Clock,
        log: JsonLines | None = None,
        log_values: bool = False,
    ) -> None:
        self.source = source
        self.policy = policy
        self.senders = senders
        self.clock = clock
        self.log = log
        self.log_values = log_values

    def run(self) -> Summary:
        """Go on until the source ends or is stopped."""
        summary = Summary()
        start = self.clock.monotonic()
        for seq, frame in enumerate(self.source, 1):
            delivered = self.clock.monotonic()
            judgement = self.policy.judge(frame)
            latency_ms = 1000 * (self.clock.monotonic() - delivered)
            report = Report(seq, frame.number, frame.t, latency_ms, judgement.verdict)
            for sender in self.senders:
                sender.send(report)
            self._write(report, judgement)
            summary.add(report)
            summary.seconds = self.clock.monotonic() - start
        summary.sent = sum(sender.sent for sender in self.senders)
        summary.send_failures = sum(sender.failed for sender in self.senders)
        summary.log_failures = self.log.failed if self.log is not None else 0
        return summary

    def _write(self, report: Report, judgement: Judgement) -> None:
        if self.log is None:
            return
        line = {**report.fields(), "frame": report.frame}
        if self.log_values:
            values = judgement.decision_values
            line["decision_values"] = None if values is None else values.tolist()
        self.log.write(line)
