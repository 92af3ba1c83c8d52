"""Messages of pages, checked before anything is done with them, and of the server: JSON, errors."""

from __future__ import annotations

import re
import sqlite3
from typing import Annotated, Any, Literal, cast

from fastapi import Depends, FastAPI, Query, Request
from fastapi.exceptions import RequestValidationError
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response

from tokt.features.common.canonical import MAX_EXACT, exact_numbers
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.features.frames.numbering import LAST_FRAME
from tokt.labels.page.state.session import Session
from tokt.labels.record import HUMAN, SETTLED, check_name, utc_text

NOT_SAVED = 507
UNREADABLE = 422
_LONG_NUMBER = re.compile(rb"[0-9]{16}")
_NO_STORE = {"cache-control": "no-store"}


class _ExactResponse(JSONResponse):
    """JSON whose numbers browsers read as they are, see `exact_numbers`."""

    def render(self, content: Any) -> bytes:
        body = super().render(content)
        return super().render(exact_numbers(content)) if _LONG_NUMBER.search(body) else body


def json_response(value: dict[str, Any]) -> JSONResponse:
    """A JSON answer that no cache keeps."""
    return _ExactResponse(value, headers=_NO_STORE)


def error_response(
    status: int, message: str, headers: dict[str, str] | None = None
) -> JSONResponse:
    """An error: one line, whatever `message` repeats of what was sent."""
    line = " ".join(message.encode("utf-8", "backslashreplace").decode().split())
    return JSONResponse({"error": line}, status, headers={**_NO_STORE, **(headers or {})})


def refuse(status: int, message: str) -> HTTPException:
    """An exception that becomes `error_response`."""
    return HTTPException(status, message)


def add_error_handlers(app: FastAPI) -> None:
    """Make every exception of `app` an error response."""
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(ToktError, _user_error)
    app.add_exception_handler(Exception, _fault)


async def _http(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return error_response(error.status_code, str(error.detail), dict(error.headers or {}))


async def _invalid(_request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"][1:])
    return error_response(400, f"{where}: {first['msg']}" if where else str(first["msg"]))


async def _user_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, ToktError)
    # The label store could not be read or written, rather than asked something wrong.
    if isinstance(error.__cause__, sqlite3.Error | OSError):
        request.app.state.session.fault = str(error)  # all pages hear of it
        return error_response(NOT_SAVED, str(error))
    return error_response(UNREADABLE if isinstance(error, FrameError) else 409, str(error))


async def _fault(_request: Request, _error: Exception) -> Response:
    return error_response(500, "fault in tokt label; what it printed in the terminal says more")


MAX_NAME = 200  # letters
MAX_NOTE = 2000
_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


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


def _number(value: Any) -> Any:
    """A number that a page has as text, as it is too large for a browser's numbers."""
    is_large = isinstance(value, str) and value.isdecimal() and int(value) > MAX_EXACT
    return int(value) if is_large else value


def _note(value: str) -> str:
    if _CONTROL.search(value):
        raise ValueError("a note has no control characters but line breaks and tabs")
    return value


Name = Annotated[str, Field(max_length=MAX_NAME), AfterValidator(_name)]
Camera = Literal["left", "right"]
FrameNumber = Annotated[int, BeforeValidator(_number), Field(ge=0, le=LAST_FRAME)]
Time = Annotated[str, Field(max_length=MAX_NAME), AfterValidator(_time)]
Flag = Annotated[bool, Field(strict=False)]

assert {LEFT, RIGHT} == {"left", "right"}
assert {HUMAN, SETTLED} == {"human", "settled"}


class Body(BaseModel):
    """JSON that a page sent, with no more and no less than is named."""

    model_config = ConfigDict(strict=True, extra="forbid")


class ChangeBody(Body):
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


class _Write(Body):
    """What an action and an undo have in common.

    A page that replays what it kept names the mission and the grid it was made for: the server on
    this port may have been started anew with another one. `blind` says that it was done while the
    page hid what others say: only the page knows what it showed then.
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


class SeenBody(Body):
    """A person opened a frame."""

    who: Name
    camera: Camera
    frame: FrameNumber


class NoteBody(Body):
    """What a person writes about a patch, or without a cell about the frame; "" takes it back."""

    who: Name
    camera: Camera
    frame: FrameNumber
    cell: Annotated[int, Field(ge=0)] | None = None
    text: Annotated[str, Field(max_length=MAX_NOTE), AfterValidator(_note)]


class BlindBody(Body):
    """A person labels blind from now on, or no longer does."""

    who: Name
    blind: bool


class SettingBody(Body):
    """A setting of the mission, for everybody.

    ``obstacle_as``: the classes, joined by commas, that a model's "obstacle" may be here.
    """

    who: Name
    name: Literal["obstacle_as"]
    value: Annotated[str, Field(max_length=MAX_NOTE)]


async def _session(request: Request) -> Session:
    session = cast(Session, request.app.state.session)
    session.give_way()
    return session


SessionOf = Annotated[Session, Depends(_session)]
Who = Annotated[str, Query(min_length=1, max_length=MAX_NAME)]


async def _blind(session: SessionOf, who: Who | None = None) -> bool:
    return (who or session.annotator) in session.blind


Blind = Annotated[bool, Depends(_blind)]
"""Whether who asks labels blind. The store says so, whatever a page believes."""
Version = Annotated[str, Query(alias="v", max_length=MAX_NAME)]
"""Which mission's frames a page means: another one may be served on this port tomorrow."""
Frame = Annotated[int, Query(ge=0, le=LAST_FRAME)]


def check_frame(session: Session, camera: str, frame: int) -> None:
    """Answer 404 unless the mission has this frame."""
    if not session.board.has(camera, frame):
        raise refuse(404, f"mission {session.mission.name} has no {camera} frame {frame}")


def check_cell(session: Session, cell: int) -> None:
    """Answer 400 unless the grid has this patch."""
    if not 0 <= cell < session.grid.n_patches:
        raise refuse(400, f"cell {cell} is outside the grid {session.grid}")


def check_version(session: Session, version: str) -> None:
    """Answer 409 to a page that was opened on another mission, or on other pictures of it."""
    if version and version != session.pictures_version:
        raise refuse(
            409, f"the server now shows {session.mission.name} with other pictures: load the page"
        )


def refuse_blind(blind: bool, status: int = 403) -> None:
    """Answer 403 to a blind annotator who asks for what others say."""
    if blind:
        raise refuse(status, "not while labelling blind: it would show what others say")
