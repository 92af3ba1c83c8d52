"""All patches that a person gave one label, odd ones first."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from .requests import MAX_NAME, SessionOf, Who
from .responses import json_response, refuse

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
    if label not in session.board.names:
        raise refuse(404, f"no class {label!r}")
    ranked = session.sheet.ranked(who or session.annotator, label)
    return json_response(
        {
            "total": len(ranked.patches),
            "by": ranked.by,
            "ready": ranked.ready,
            "done": ranked.done,
            "of": ranked.of,
            "patches": [
                {
                    "camera": patch.camera,
                    "frame": patch.frame,
                    "cell": patch.cell,
                    "value": round(patch.value, _VALUE_DECIMALS)
                    if math.isfinite(patch.value)
                    else None,
                }
                for patch in ranked.patches[offset : offset + limit]
            ],
        }
    )
