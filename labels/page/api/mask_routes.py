"""The mask of a dive: the patches of a camera's frames that are no view.

``POST /api/mask`` masks the ``cells`` of a camera and no others; all pages then load the mission
anew. ``POST /api/fixed_marks`` begins to look for patches with marks that never move, beside the
page; ``GET /api/fixed_marks`` answers their ``cells``, null while they are being looked for.
"""

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field
from starlette.responses import Response

from tokt.features.common.errors import ToktError
from tokt.labels.page.state.session import Session

from .messages import Body, Camera, Name, SessionOf, check_cell, json_response, refuse

router = APIRouter(prefix="/api")


class MarksBody(Body):
    """A camera in whose pictures somebody wants marks looked for."""

    who: Name | None = None
    camera: Camera


class MaskBody(MarksBody):
    """All masked patches of a camera."""

    cells: list[Annotated[int, Field(ge=0)]]


@router.post("/mask")
def post_mask(session: SessionOf, body: MaskBody) -> Response:
    """Mask patches of a camera's frames, and write the dive's mask beside them."""
    _check_camera(session, body.camera)
    for cell in body.cells:
        check_cell(session, cell)
    try:
        session.mask_patches(body.camera, body.cells)
    except ToktError as error:  # labels can be saved all the same
        raise refuse(409, str(error)) from None
    return json_response({})


@router.post("/fixed_marks")
def post_fixed_marks(session: SessionOf, body: MarksBody) -> Response:
    """Begin to look for marks that never move in a camera's pictures."""
    _check_camera(session, body.camera)
    session.marks.start(body.camera)
    return json_response({})


@router.get("/fixed_marks")
def get_fixed_marks(session: SessionOf, camera: Camera) -> Response:
    """The patches that were found; null while they are being looked for."""
    _check_camera(session, camera)
    return json_response({"cells": session.marks.found(camera)})


def _check_camera(session: Session, camera: str) -> None:
    if camera not in session.board.frames:
        raise refuse(404, f"mission {session.mission.name} has no {camera} camera")
