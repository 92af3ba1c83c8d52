"""One frame's report: the verdict with its number and times, as datagrams and logs carry it."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from .verdict import Verdict

V2 = 2
HEALTH_BYTES, MODEL_BYTES = 300, 420
"""Longest health text and model name that are sent or logged, in the bytes that JSON takes for
them: any datagram fits one Ethernet frame (1472), and every model's name of ASCII is whole."""


@dataclass(frozen=True)
class Report:
    """What is said about one frame, or, as a heartbeat, of there being none.

    Parameters
    ----------
    seq : int
        1 for the first report of a run, then rising by one, whatever was sent.
    frame : int or None
        The frame's number in its source; None in a heartbeat.
    t : float or None
        Frame time: seconds since 1970 (UTC) when the source delivered it. A heartbeat has that of
        the newest frame, or None before the first.
    latency_ms : float or None
        From when the frame was taken up to its verdict, in milliseconds.
    verdict : Verdict
    age_ms : float or None
        From the frame's arrival in this process to the datagram, in milliseconds; a heartbeat has
        that of the newest frame.
    left_out : int
        Frames between the one before and this one that there was no time for.
    """

    seq: int
    frame: int | None
    t: float | None
    latency_ms: float | None
    verdict: Verdict
    age_ms: float | None = None
    left_out: int = 0

    def fields(self) -> dict[str, Any]:
        """The fields of UDP v2 (docs/udp.md); a number that is not finite becomes None."""
        verdict = self.verdict
        return {
            "v": V2,
            "seq": self.seq,
            "t": _finite(self.t),
            "status": verdict.status,
            "x": verdict.x,
            "y": verdict.y,
            "box": None if verdict.box is None else list(verdict.box),
            "mean": _finite(verdict.mean),
            "distance_m": _finite(verdict.distance_m),
            "method": verdict.method,
            "model": None if verdict.model is None else _cut(verdict.model, MODEL_BYTES),
            "latency_ms": _finite(self.latency_ms),
            "health": _cut(verdict.health, HEALTH_BYTES),
            "closing_m_s": _finite(verdict.closing_m_s),
            "contact_s": _finite(verdict.contact_s),
            "reason": verdict.reason.value,
            "age_ms": _finite(self.age_ms),
            "trend": verdict.trend,
            "trend_confidence": _finite(verdict.trend_confidence),
            "expansion_contact_s": _finite(verdict.expansion_contact_s),
            "anchor_x": _finite(verdict.anchor_x),
            "anchor_y": _finite(verdict.anchor_y),
            "anchor_size": _finite(verdict.anchor_size),
        }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _cut(text: str, most: int) -> str:
    """As much of a text's beginning as takes at most so many bytes in JSON of ASCII."""
    text = text[:most]
    while _json_bytes(text) > most:
        text = text[:-1]
    return text


def _json_bytes(text: str) -> int:
    return len(json.dumps(text)) - 2
