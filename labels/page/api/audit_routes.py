"""Label audits for the review sheet, each with its worst patches first."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.responses import Response

from tokt.features.common.errors import ToktError
from tokt.labels.page.state.audits import Doubt
from tokt.labels.page.state.session import Session

from .requests import MAX_NAME, Blind, SessionOf, Who, refuse_blind
from .responses import json_response, refuse

router = APIRouter(prefix="/api")
MAX_PATCHES = 2000


@router.get("/audits")
def get_audits(session: SessionOf, blind: Blind = False) -> Response:
    """The audits that speak of this mission; ``fault`` says why one cannot be read."""
    refuse_blind(blind)
    found = [_listed(session, name) for name in session.audits.names()]
    return json_response({"audits": [one for one in found if one["patches"] or one["fault"]]})


@router.get("/audit")
def get_audit(
    session: SessionOf,
    name: Annotated[str, Query(max_length=MAX_NAME)],
    who: Who | None = None,
    blind: Blind = False,
) -> Response:
    """One audit's worst patches of this mission, with what `who` says and what is settled now."""
    refuse_blind(blind)
    try:
        audit = session.audits.audit(name)
    except KeyError:
        raise refuse(404, f"no audit {name!r} in this workspace") from None
    except ToktError as error:
        raise refuse(409, str(error)) from None
    doubts = session.audits.doubts(audit)
    return json_response(
        {
            "name": audit.name,
            "of": audit.of,
            "rule": audit.rule,
            "total": len(doubts),
            "patches": _doubts(session, who or session.annotator, doubts[:MAX_PATCHES]),
        }
    )


def _doubts(session: Session, who: str, doubts: list[Doubt]) -> list[dict[str, Any]]:
    board = session.board
    frames = {(doubt.patch.camera, doubt.patch.frame) for doubt in doubts}
    mine = {frame: board.labels(who, *frame) for frame in frames}
    settled = {frame: board.settled(*frame) for frame in frames}
    return [
        {
            "camera": patch.camera,
            "frame": patch.frame,
            "cell": cell,
            "label": patch.label,
            "suggested": patch.suggested,
            "margin": patch.margin,
            "reason": patch.reason,
            "mine": mine[patch.camera, patch.frame][cell],
            "settled": settled[patch.camera, patch.frame][cell],
        }
        for cell, patch in doubts
    ]


def _listed(session: Session, name: str) -> dict[str, Any]:
    try:
        audit = session.audits.audit(name)
    except ToktError as error:
        return {"name": name, "of": "", "patches": 0, "fault": str(error)}
    doubts = session.audits.doubts(audit)
    return {"name": name, "of": audit.of, "patches": len(doubts), "fault": ""}
