"""Agreement of two annotators, and the patches to settle."""

from __future__ import annotations

from fastapi import APIRouter
from starlette.responses import Response

from tokt.features.common.errors import ToktError
from tokt.labels.agreement import agreement_of_counts

from .requests import Blind, SessionOf, Who, refuse_blind
from .responses import json_response, refuse

router = APIRouter(prefix="/api")


@router.get("/agreement")
def get_agreement(session: SessionOf, a: Who, b: Who, blind: Blind = False) -> Response:
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
            **found.to_json(),
            "blind": {"a": board.blind_count(a), "b": board.blind_count(b)},
            "conflicts": [different._asdict() for different in board.differences(a, b)],
        }
    )
