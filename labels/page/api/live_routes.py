"""The stream of server-sent events that every open page listens to."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse

from tokt.labels.page.state.board import LabelChanges
from tokt.labels.page.state.live import ALIVE, event_text
from tokt.labels.page.state.session import Session

from .requests import Blind, SessionOf, Who

router = APIRouter(prefix="/api")


@router.get("/events")
async def get_events(
    session: SessionOf,
    who: Who | None = None,
    blind: Blind = False,
    since: Annotated[int | None, Query(ge=0, le=2**63 - 1)] = None,
) -> StreamingResponse:
    """What changes from now on, and first what changed after event `since`."""
    return StreamingResponse(
        _stream(session, who or session.annotator, blind, since),
        media_type="text/event-stream",
        headers={"cache-control": "no-store"},
    )


async def _stream(session: Session, who: str, blind: bool, since: int | None) -> AsyncIterator[str]:
    yield event_text("status", _status(session.status(), blind))
    async for changed, status in session.live.listen():
        if since is not None:
            missed = await run_in_threadpool(session.board.changed_since, since)
            changed, since = missed if changed is None else missed.merged(changed), None
        heard = changed.seen_by(who, blind) if changed else None
        if status is not None:
            yield event_text("status", _status(status, blind))
        if heard:
            yield event_text("change", await run_in_threadpool(_news, session, who, blind, heard))
        elif status is None:
            yield ALIVE


def _status(status: dict[str, Any], blind: bool) -> dict[str, Any]:
    return {**status, "model": None} if blind else status


def _news(session: Session, who: str, blind: bool, changed: LabelChanges) -> dict[str, Any]:
    return {
        "event": changed.event,
        "since": changed.since,
        "frames": [list(frame) for frame in sorted(changed.frames)],
        "by": [] if blind else sorted(changed.annotators),
        **session.state_after(who, blind, changed.frames),
    }
