"""One frame, or one heartbeat, as logs and recordings write it: a JSON object.

The fields of UDP v2 (docs/udp.md), and what a replay needs to judge the frame again: what the
policy saw of it, and how long the texture detector took.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .observer import Event
from .pixel_mark import pixel_mark
from .policy import Judgement
from .reason import Fault
from .report import Report
from .sources import Frame


def frame_line(run: str, frame: Frame, judgement: Judgement, report: Report) -> dict[str, Any]:
    """The line of a frame that was judged.

    Returns
    -------
    dict
        The fields of v2; ``run``; ``frame``, its number; ``missed`` and ``timed`` as in `Frame`;
        ``left_out`` as in `Report`; ``texture_s`` as in `Judgement`; ``left`` and ``right``: the
        `pixel_mark` of a picture, or ``{"reason", "words"}`` where there is none.
    """
    return {
        **report.fields(),
        "run": run,
        "frame": frame.number,
        "missed": frame.missed,
        "left_out": report.left_out,
        "timed": frame.timed,
        "texture_s": judgement.texture_s,
        "left": _side(frame.left, frame.left_fault),
        "right": _side(frame.right, frame.right_fault),
    }


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
