"""What pages send: every field is checked before anything is done with it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from ...features.errors import ToktError
from ...features.mission import LEFT, RIGHT
from ..record import HUMAN, SETTLED, check_name, utc_text

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
