"""One frame, or one heartbeat, as logs and recordings write it: a JSON object.

The fields of UDP v2 (docs/udp.md), and what a replay needs to judge the frame again: what the
policy saw of it, and how long the texture detector took.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tokt.inference.events import Event
from tokt.inference.frame import Frame, pixel_mark
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault
from tokt.inference.report import LOG_ONLY, Report, filler


class _LineValues(NamedTuple):
    """Where a line's own fields are found."""

    run: str
    frame: Frame
    judgement: Judgement
    report: Report
    left: str | dict[str, str]
    right: str | dict[str, str]


_log_only = filler(LOG_ONLY)


def frame_line(run: str, frame: Frame, judgement: Judgement, report: Report) -> dict[str, Any]:
    """The line of a frame that was judged.

    Returns
    -------
    dict
        Every one of `tokt.inference.report.FIELDS`; ``left`` and ``right`` are the `pixel_mark` of
        a picture, or ``{"reason", "words"}`` where there is none.
    """
    left, right = _side(frame.left, frame.left_fault), _side(frame.right, frame.right_fault)
    return {**report.fields(), **_log_only(_LineValues(run, frame, judgement, report, left, right))}


def heartbeat_line(run: str, report: Report) -> dict[str, Any]:
    """The line of a heartbeat: the fields of v2, ``run``, and ``frame`` None."""
    return {**report.fields(), "run": run, "frame": None}


def event_line(run: str, seq: int, event: Event) -> dict[str, Any]:
    """The line of an event: ``event``, ``t``, ``words``, ``run``, ``seq`` and its own fields.

    ``seq`` is that of the newest report when the event came, 0 before the first.
    """
    line = {"event": event.name, "t": event.t, "words": event.words, "run": run, "seq": seq}
    return {**line, **event.fields}


def json_values(values: NDArray[np.float64] | None) -> list[Any] | None:
    """Decision values, exact to the last bit; what is not finite becomes None."""
    if values is None:
        return None
    if np.isfinite(values).all():
        return list(values.tolist())
    return [[v if math.isfinite(v) else None for v in row] for row in values.tolist()]


def _side(picture: NDArray[np.uint8] | None, fault: Fault) -> str | dict[str, str]:
    if picture is not None:
        return pixel_mark(picture)
    return {"reason": fault.reason.value, "words": str(fault)}
