"""Requests of pages: their parameters and bodies, checked before anything is done with them."""

from __future__ import annotations

from typing import Annotated, Literal, cast

from fastapi import Depends, Query, Request
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.labels.page.state.session import Session
from tokt.labels.record import HUMAN, SETTLED, check_name, utc_text

from .responses import refuse

MAX_NAME = 200  # letters


def _name(value: str) -> str:
    try:
        check_name("name", value)
    except ToktError as error:
        raise ValueError(str(error)) from None
    return value


def _time(value: str) -> str:
    try:
        return utc_text(value)
    except ToktError as error:
        raise ValueError(str(error)) from None


Name = Annotated[str, Field(max_length=MAX_NAME), AfterValidator(_name)]
Camera = Literal["left", "right"]
FrameNumber = Annotated[int, Field(ge=0, le=2**31 - 1)]
Time = Annotated[str, Field(max_length=MAX_NAME), AfterValidator(_time)]
Flag = Annotated[bool, Field(strict=False)]

assert {LEFT, RIGHT} == {"left", "right"}
assert {HUMAN, SETTLED} == {"human", "settled"}


class _Body(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class ChangeBody(_Body):
    """Patches of one frame that get one label."""

    camera: Camera
    frame: FrameNumber
    label: Name | None
    model: Name | None = None
    cells: list[Annotated[int, Field(ge=0)]]
    base: list[Name | None]

    @model_validator(mode="after")
    def _one_base_a_cell(self) -> ChangeBody:
        if len(self.base) != len(self.cells):
            raise ValueError("base must have one value a cell")
        return self


class _Write(_Body):
    """What an action and an undo have in common.

    A page that replays what it kept names the mission and the grid it was made for: the server on
    this port may have been started anew with another one.
    """

    key: Name
    who: Name
    blind: Flag = False
    time: Time
    mission: str | None = None
    grid: dict[Literal["rows", "cols", "width"], int | None] | None = None


class ActionBody(_Write):
    """Something a person did in one go."""

    kind: Name
    source: Literal["human", "settled"] = "human"
    changes: Annotated[list[ChangeBody], Field(min_length=1)]


class StepBody(_Write):
    """An undo or a redo."""

    target: Name | None = None


class SeenBody(_Body):
    """A person opened a frame."""

    who: Name
    blind: Flag = False
    camera: Camera
    frame: FrameNumber


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
    """Answer 403 to a blind annotator who asks for what others say."""
    if blind:
        raise refuse(403, "not while labelling blind: it would show what others say")
