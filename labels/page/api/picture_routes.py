"""Pictures of frames and of patches."""

import re
from typing import Annotated

from fastapi import APIRouter, Path, Query
from starlette.responses import Response

from tokt.features.common.errors import ToktError
from tokt.features.frames.numbering import LAST_FRAME
from tokt.labels.page.frames import is_near
from tokt.labels.page.state.pictures import frame_picture
from tokt.labels.page.state.session import Session

from .messages import Camera, SessionOf, Version, check_frame, check_version, refuse

router = APIRouter(prefix="/api")
_KEEP = {"cache-control": "private, max-age=31536000, immutable"}
_KEEP_NOT = {"cache-control": "no-store"}
MAX_PATCHES = 400
_CELL = re.compile(r"(left|right):(\d{1,10}):(\d{1,10})", re.ASCII)

CameraPart = Annotated[Camera, Path()]
FramePart = Annotated[int, Path(ge=0, le=LAST_FRAME)]
Enhance = Annotated[int, Query(ge=0, le=100)]


@router.get("/picture/{camera}/{frame}")
def get_picture(
    session: SessionOf,
    camera: CameraPart,
    frame: FramePart,
    enhance: Enhance = 0,
    version: Version = "",
) -> Response:
    """One frame, with its contrast raised by `enhance` per cent."""
    check_version(session, version)
    check_frame(session, camera, frame)
    return _picture(session, version, frame_picture(session.mission, camera, frame, enhance))


@router.get("/thumb/{camera}/{frame}")
def get_thumb(
    session: SessionOf,
    camera: CameraPart,
    frame: FramePart,
    width: Annotated[int, Query(ge=16, le=2000)] = 240,
    enhance: Enhance = 0,
    version: Version = "",
    near: bool = False,
) -> Response:
    """One frame made smaller; if only a `near` one is wanted, nothing where it would take long."""
    check_version(session, version)
    check_frame(session, camera, frame)
    if near and not is_near(session.mission, frame):
        return Response(status_code=204, headers=_KEEP_NOT)
    made = frame_picture(session.mission, camera, frame, enhance, width)
    return _picture(session, version, made)


@router.get("/patches")
def get_patches(
    session: SessionOf,
    cells: Annotated[str, Query(max_length=MAX_PATCHES * 30)],
    size: Annotated[int, Query(ge=16, le=256)] = 72,
    margin: Annotated[float, Query(ge=0, le=1)] = 0.25,
    enhance: Enhance = 0,
    version: Version = "",
) -> Response:
    """Patches side by side in one picture, ten in a row, from ``left:17:34,left:17:35``."""
    check_version(session, version)
    wanted = _cells(cells)
    for camera, frame, _ in wanted:
        check_frame(session, camera, frame)
    try:
        made = session.pictures.sprite(wanted, size, margin, enhance)
    except ToktError as error:
        raise refuse(400, str(error)) from None
    return _picture(session, version, made)


def _cells(text: str) -> list[tuple[str, int, int]]:
    found = []
    for part in text.split(","):
        match = _CELL.fullmatch(part)
        if match is None:
            raise refuse(400, f"not a patch: {part!r} (write CAMERA:FRAME:CELL)")
        found.append((match[1], int(match[2]), int(match[3])))
    if len(found) > MAX_PATCHES:
        raise refuse(400, f"{len(found)} patches at once; the most is {MAX_PATCHES}")
    return found


def _picture(session: Session, version: str, made: tuple[bytes, str]) -> Response:
    data, media_type = made
    headers = _KEEP if version == session.pictures_version else _KEEP_NOT
    return Response(data, media_type=media_type, headers=headers)
