"""Parameters that several routes take, and the session they work on."""

from __future__ import annotations

from typing import Annotated, cast

from fastapi import Depends, Query, Request

from .answers import refuse
from .bodies import MAX_NAME, Camera
from .session import Session


async def _session(request: Request) -> Session:
    session = cast(Session, request.app.state.session)
    session.give_way()
    return session


SessionOf = Annotated[Session, Depends(_session)]
Who = Annotated[str, Query(min_length=1, max_length=MAX_NAME)]
Blind = Annotated[bool, Query()]
CameraOf = Annotated[Camera, Query()]
Version = Annotated[str, Query(alias="v", max_length=MAX_NAME)]
"""Which mission's frames a page means: another one may be served on this port tomorrow."""
Frame = Annotated[int, Query(ge=0, le=2**31 - 1)]


def check_frame(session: Session, camera: str, frame: int) -> None:
    """Answer 404 unless the mission has this frame."""
    if not session.board.has(camera, frame):
        raise refuse(404, f"mission {session.mission.name} has no {camera} frame {frame}")


def check_version(session: Session, version: str) -> None:
    """Answer 409 to a page that was opened on another mission, or on other pictures of it."""
    if version and version != session.pictures_version:
        raise refuse(
            409, f"the server now shows {session.mission.name} with other pictures: load the page"
        )


def refuse_blind(blind: bool) -> None:
    """Answer 403 to who labels blind and asks for what others say."""
    if blind:
        raise refuse(403, "not while labelling blind: it would show what others say")
