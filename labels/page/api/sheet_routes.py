"""Sheets of patches: those of one label, odd ones first; agreement and conflicts; label audits."""

import math
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.responses import Response

from tokt.features.common.errors import ToktError
from tokt.labels.agreement import agreement_of_counts
from tokt.labels.formats.audit_csv import Audit
from tokt.labels.page.state.audits import Doubt
from tokt.labels.page.state.session import Session

from .messages import MAX_NAME, Blind, SessionOf, Who, json_response, refuse, refuse_blind

router = APIRouter(prefix="/api")
MAX_PATCHES = 2000
_VALUE_DECIMALS = 4


@router.get("/sheet")
def get_sheet(
    session: SessionOf,
    label: Annotated[str, Query(alias="class", max_length=MAX_NAME)],
    who: Who | None = None,
    offset: Annotated[int, Query(ge=0)] = 0,
    limit: Annotated[int, Query(ge=1, le=MAX_PATCHES)] = 200,
) -> Response:
    """A part of the sheet; ``value`` is null where the patch has not been looked at."""
    who = who or session.annotator
    if label not in session.names(who):
        raise refuse(404, f"no class {label!r}")
    ranked = session.sheet.ranked(who, label)
    return json_response(
        {
            "total": len(ranked.cells),
            "by": ranked.by,
            "ready": ranked.ready,
            "done": ranked.done,
            "of": ranked.of,
            "patches": [
                {**patch._asdict(), "value": _rounded(patch.value)}
                for patch in ranked.patches(offset, offset + limit)
            ],
        }
    )


def _rounded(value: float) -> float | None:
    return round(value, _VALUE_DECIMALS) if math.isfinite(value) else None


@router.get("/agreement")
def get_agreement(session: SessionOf, blind: Blind, a: Who, b: Who) -> Response:
    """Agreement of annotators `a` and `b`, and the patches that they labelled differently."""
    refuse_blind(blind)
    board = session.board
    for who in (a, b):
        if who not in board.annotators:
            raise refuse(404, f"{who} labelled nothing in mission {session.mission.name}")
    if a == b:
        raise refuse(400, "agreement is between two annotators; these are one")
    try:
        found = agreement_of_counts(
            board.pairs(a, b),
            sum(board.counts(a).values()),
            sum(board.counts(b).values()),
            session.taxonomy,
        )
    except ToktError as error:
        raise refuse(409, str(error)) from None
    return json_response(
        {
            "a": a,
            "b": b,
            **asdict(found),
            "blind": {"a": board.blind_count(a), "b": board.blind_count(b)},
            "conflicts": [different._asdict() for different in board.differences(a, b)],
        }
    )


@router.get("/audits")
def get_audits(session: SessionOf, blind: Blind) -> Response:
    """The audits that speak of this mission; ``fault`` says why one cannot be read."""
    refuse_blind(blind)
    found = [_listed(session, name) for name in session.audits.names()]
    return json_response({"audits": [one for one in found if one["patches"] or one["fault"]]})


@router.get("/audit")
def get_audit(
    session: SessionOf,
    blind: Blind,
    name: Annotated[str, Query(max_length=MAX_NAME)],
    who: Who | None = None,
) -> Response:
    """One audit's worst patches of this mission, with what `who` says, what is settled now, and
    what was decided since the audit.
    """
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
            "patches": _doubts(session, who or session.annotator, audit, doubts[:MAX_PATCHES]),
        }
    )


def _doubts(session: Session, who: str, audit: Audit, doubts: list[Doubt]) -> list[dict[str, Any]]:
    board = session.board
    frames = {(patch.camera, patch.frame) for _, patch in doubts}
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
            "group": patch.group,
            "mine": mine[patch.camera, patch.frame][cell],
            "settled": settled[patch.camera, patch.frame][cell],
            "decided": session.audits.decision(audit, patch),
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
