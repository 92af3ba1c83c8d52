"""The queue of frames to label next."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.responses import Response

from tokt.labels.page.suggestions.queue import next_frames

from .requests import Blind, Camera, Frame, SessionOf, Who
from .responses import json_response

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
        for entry in next_frames(session.suggester, labelled, n, now)
    ]
    return _queue(frames, "", done, total)


def _none(why_not: str) -> Response:
    return _queue([], why_not, 0, 0)


def _queue(frames: list[dict[str, Any]], why_not: str, done: int, total: int) -> Response:
    return json_response(
        {
            "ready": bool(total) and done == total,
            "done": done,
            "total": total,
            "why_not": why_not,
            "frames": frames,
        }
    )
