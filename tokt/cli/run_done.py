"""What a run of `tokt run` came to, in words and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..inference.runtime import Summary
from ..inference.udp import Sender
from ..models.bundle import Bundle
from .run_asked import Asked


@dataclass(frozen=True)
class Done:
    """A run that has ended.

    Parameters
    ----------
    asked : Asked
    model : Bundle or None
        What it began with.
    senders : list of Sender
    summary : Summary
    """

    asked: Asked
    model: Bundle | None
    senders: list[Sender]
    summary: Summary

    def words(self) -> str:
        """One line for people."""
        summary = self.summary
        line = (
            f"{summary.frames} frames in {summary.seconds:.1f} s: {summary.obstacle} obstacle, "
            f"{summary.clear} clear, {summary.unknown} unknown; {summary.sent} datagrams sent"
        )
        if summary.send_failures:
            reasons = sorted({sender.last_error for sender in self.senders if sender.last_error})
            line += f", {summary.send_failures} refused ({', '.join(reasons)})"
        if summary.heartbeats or summary.dropped:
            line += f"; {summary.heartbeats} heartbeats, no time for {summary.dropped} frames"
        if summary.log_failures:
            line += f"; {summary.log_failures} log lines could not be written"
        return line

    def to_json(self) -> dict[str, Any]:
        """What ``--json`` prints; without a model its figures are None."""
        rule = self.model and self.model.operating_point.rule
        return {
            "policy": self.asked.policy,
            "format": self.asked.format_,
            "model": self.model and self.model.label,
            "frame_rule": rule and rule.to_json(),
            "latency_frames": rule and rule.latency_frames,
            **self.summary.to_json(),
        }
