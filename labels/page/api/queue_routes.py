"""Which frame to label next."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.responses import Response

from .answers import answered
from .bodies import Camera
from .queries import Blind, Frame, SessionOf, Who
from .queue import order

router = APIRouter(prefix="/api")
_SCORE_DECIMALS = 4


@router.get("/queue")
def get_queue(
    session: SessionOf,
    who: Who | None = None,
    blind: Blind = False,
    n: Annotated[int, Query(ge=1, le=1000)] = 30,
    camera: Camera | None = None,
    frame: Frame | None = None,
) -> Response:
    """The next `n` frames for a person who sees `frame` now; what the model does not know waits."""
    if session.suggester is None:
        return _none("no model was given: start tokt label with --model")
    if blind:
        return _none("not while labelling blind: the order would show what the model says")
    done, total = session.suggester.progress
    labelled = dict.fromkeys(session.board.labelled_frames(who or session.annotator), True)
    now = None if camera is None or frame is None else (camera, frame)
    frames = [
        {
            "camera": entry.camera,
            "frame": entry.frame,
            "why": entry.why,
            "score": round(entry.score, _SCORE_DECIMALS),
        }
        for entry in order(session.suggester, labelled, n, now)
    ]
    return _queue(frames, "", done, total)


def _none(why_not: str) -> Response:
    return _queue([], why_not, 0, 0)


def _queue(frames: list[dict[str, Any]], why_not: str, done: int, total: int) -> Response:
    return answered(
        {
            "ready": bool(total) and done == total,
            "done": done,
            "total": total,
            "why_not": why_not,
            "frames": frames,
        }
    )
