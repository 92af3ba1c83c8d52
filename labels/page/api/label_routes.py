"""Labels of frames, the actions that change them, the events that tell other pages."""

import math
import re
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any

from fastapi import APIRouter, Query
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response, StreamingResponse

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT, parse_frames
from tokt.labels.page.masks import covered_frame
from tokt.labels.page.state.board import LabelChanges
from tokt.labels.page.state.live import ALIVE, event_text
from tokt.labels.page.state.session import Session
from tokt.labels.record import SETTLED, utc_now
from tokt.labels.store.actions import Action, ActionResult, Change, Conflict
from tokt.labels.store.store import Note

from .messages import (
    ActionBody,
    Blind,
    Camera,
    Frame,
    NoteBody,
    SessionOf,
    StepBody,
    Version,
    Who,
    check_cell,
    check_frame,
    check_version,
    json_response,
    refuse,
    refuse_blind,
)

router = APIRouter(prefix="/api")
MAX_FRAMES = 60
_VALUE_DECIMALS = 4
_RANGE = re.compile(r"(\d{1,18})\s*-\s*(\d{1,18})")


@router.get("/labels")
def get_labels(
    session: SessionOf,
    blind: Blind,
    camera: Camera,
    frames: str,
    who: Who | None = None,
    suggest: bool = False,
    version: Version = "",
) -> Response:
    """Labels of up to `MAX_FRAMES` frames, as ``17,18,19`` or ``17-19``."""
    check_version(session, version)
    numbers = _frame_numbers(frames)
    for number in numbers:
        check_frame(session, camera, number)
    found = []
    event = session.board.event
    for number in numbers:
        said = _labels(session, who or session.annotator, blind, camera, number)
        suggestions = _suggestions(session, camera, number) if suggest and not blind else None
        found.append({**said, "suggestions": suggestions})
    return json_response({"event": event, "frames": found})


@router.get("/carried")
def get_carried(session: SessionOf, frame: Frame, who: Who | None = None) -> Response:
    """A person's labels of a left frame, as they lie in the right one; nothing is written."""
    if session.carry is None:
        raise refuse(400, "no calibration was given: start tokt label with --calibration")
    for camera in (LEFT, RIGHT):
        check_frame(session, camera, frame)
    mission, masks = session.mission, session.board.masks
    left, right = (covered_frame(mission, masks, camera, frame) for camera in (LEFT, RIGHT))
    labels = session.board.labels(who or session.annotator, LEFT, frame)
    clear = {known.name for known in session.taxonomy.classes if not known.obstacle}
    return json_response({"labels": session.carry(left, right, labels, clear)})


@router.post("/actions")
def post_action(session: SessionOf, body: ActionBody) -> Response:
    """Apply a person's action, but not to masked patches; it is on disk when this answers."""
    _check_addressee(session, body)
    action = _action(session, body)
    applied = _applied(session, body, session.store.apply(action))
    masked = sum(len(change.cells) for change in body.changes) - len(action.changes)
    return json_response({**applied, "masked": masked})


@router.post("/undo")
def post_undo(session: SessionOf, body: StepBody) -> Response:
    """Take back a person's last action."""
    return _step(session, body, session.store.undo)


@router.post("/redo")
def post_redo(session: SessionOf, body: StepBody) -> Response:
    """Do again what was taken back last."""
    return _step(session, body, session.store.redo)


@router.post("/notes")
def post_note(session: SessionOf, body: NoteBody) -> Response:
    """Keep a note on a patch or a frame; it is on disk when this answers."""
    check_frame(session, body.camera, body.frame)
    grid, row, col = None, None, None
    if body.cell is not None:
        check_cell(session, body.cell)
        grid, (row, col) = session.grid, divmod(body.cell, session.grid.cols)
    place = (session.mission.name, body.camera, body.frame, grid, row, col)
    session.store.add_note(Note(*place, body.text, body.who, utc_now()))
    session.refresh()
    return json_response({"notes": _notes(session, body.who, body.camera, body.frame)})


@router.get("/events")
async def get_events(
    session: SessionOf,
    who: Who | None = None,
    since: Annotated[int | None, Query(ge=0, le=2**63 - 1)] = None,
) -> StreamingResponse:
    """What changes from now on, and first what changed after event `since`."""
    return StreamingResponse(
        _stream(session, who or session.annotator, since),
        media_type="text/event-stream",
        headers={"cache-control": "no-store"},
    )


def _frame_numbers(text: str) -> list[int]:
    # Before they are listed: a few ranges may name more frames than fit into memory.
    for first, last in _RANGE.findall(text):
        _check_number(int(last) - int(first) + 1)
    try:
        numbers = parse_frames(text)
    except ToktError as error:
        raise refuse(400, str(error)) from None
    _check_number(len(numbers))
    return numbers


def _check_number(n: int) -> None:
    if n > MAX_FRAMES:
        raise refuse(400, f"{n} frames at once; the most is {MAX_FRAMES}")


def _labels(session: Session, who: str, blind: bool, camera: str, frame: int) -> dict[str, Any]:
    board = session.board
    return {
        "camera": camera,
        "frame": frame,
        "mine": board.labels(who, camera, frame),
        "models": board.versions(who, camera, frame),
        "others": {} if blind else board.others(who, camera, frame),
        "settled": ([None] * session.grid.n_patches if blind else board.settled(camera, frame)),
        "notes": _notes(session, who, camera, frame),
        "hidden": board.hidden(who, camera, frame),
    }


def _notes(session: Session, who: str, camera: str, frame: int) -> list[dict[str, Any]]:
    return [
        {"cell": cell, "text": note.text, "who": note.annotator, "time": note.time}
        for cell, note in session.board.notes(who, who in session.blind, camera, frame)
    ]


def _suggestions(session: Session, camera: str, frame: int) -> dict[str, Any] | None:
    """Suggested classes (indices into the model's) and margins by cell; None without a model.

    A margin is null where nothing is suggested: the patch is masked, or clear and not seen.
    """
    if session.suggester is None:
        return None
    found = session.suggester.of(camera, frame)
    if found is None:
        return None
    values = found.values.round(_VALUE_DECIMALS).tolist()
    # A page that was opened with another model must not take these for that one's.
    return {
        "model": session.suggester.bundle.label,
        "classes": found.classes.tolist(),
        "values": [None if math.isnan(value) else value for value in values],
        "fault": found.fault,
    }


def _check_addressee(session: Session, body: ActionBody | StepBody) -> None:
    here, grid = session.mission.name, session.grid.to_json()
    if body.mission not in (None, here):
        raise refuse(421, f"this server shows mission {here}; the action is for {body.mission}")
    if body.grid not in (None, grid):
        given = ", ".join(f"{name} {value}" for name, value in body.grid.items())
        raise refuse(421, f"this server shows the grid {session.grid}; the action is for {given}")


def _action(session: Session, body: ActionBody) -> Action:
    if body.source == SETTLED:
        refuse_blind(body.who in session.blind, 409)  # not 403, on which pages wait and try again
    known = session.names(body.who)
    changes = []
    for change in body.changes:
        check_frame(session, change.camera, change.frame)
        if change.label is not None and change.label not in known:
            raise refuse(400, f"unknown class {change.label!r}; known: {', '.join(known)}")
        masked = session.board.masked(change.camera)
        for cell, base in zip(change.cells, change.base, strict=True):
            check_cell(session, cell)
            if masked[cell]:
                continue
            row, col = divmod(cell, session.grid.cols)
            changes.append(
                Change(change.camera, change.frame, row, col, change.label, base, change.model)
            )
    said = (body.key, body.who, session.mission.name, session.grid, body.kind, body.time)
    try:
        return Action(*said, tuple(changes), body.source, body.blind)
    except ToktError as error:
        raise refuse(400, str(error)) from None


def _step(
    session: Session, body: StepBody, reverse: Callable[..., ActionResult | None]
) -> Response:
    _check_addressee(session, body)
    applied = reverse(
        body.who, session.mission.name, session.grid, body.key, body.time, body.target
    )
    if applied is None:
        return json_response({"nothing": True})
    frames = [list(frame) for frame in applied.frames]
    answer = _applied(session, body, applied)
    return json_response({**answer, "kind": applied.kind, "frames": frames})


def _applied(
    session: Session, body: ActionBody | StepBody, applied: ActionResult
) -> dict[str, Any]:
    session.refresh()
    return {
        "key": applied.key,
        "event": applied.event,
        "changed": applied.changed,
        "repeated": applied.repeated,
        "conflicts": [_conflict(session, body, conflict) for conflict in applied.conflicts],
        **session.state_after(body.who, set(applied.frames)),
    }


def _conflict(
    session: Session, body: ActionBody | StepBody, conflict: Conflict
) -> dict[str, str | int | None]:
    camera, frame, theirs = conflict.camera, conflict.frame, conflict.theirs
    cell = conflict.row * session.grid.cols + conflict.col
    if body.who in session.blind:
        # Where a settlement is undone, what holds may be somebody else's word.
        theirs = session.board.labels(body.who, camera, frame)[cell]
    said = {"theirs": theirs, "yours": conflict.yours}
    return {"camera": camera, "frame": frame, "cell": cell, **said}


async def _stream(session: Session, who: str, since: int | None) -> AsyncIterator[str]:
    yield event_text("status", _status(session.status(), who))
    async for changed, status in session.live.listen():
        if since is not None:
            missed = await run_in_threadpool(session.board.changed_since, since)
            changed, since = missed if changed is None else missed.merged(changed), None
        if status:
            yield event_text("status", _status(session.status(), who))
        heard = changed.seen_by(who, who in session.blind) if changed else None
        if heard:
            yield event_text("change", await run_in_threadpool(_news, session, who, heard))
        elif not status:
            yield ALIVE


def _status(status: dict[str, Any], who: str) -> dict[str, Any]:
    blind = who in status["blind"]
    hidden: dict[str, Any] = {"model": None, "job": None, "settings": {}} if blind else {}
    return {**status, **hidden, "blind": blind}


def _news(session: Session, who: str, changed: LabelChanges) -> dict[str, Any]:
    return {
        "event": changed.event,
        "since": changed.since,
        "frames": [list(frame) for frame in sorted(changed.frames)],
        "noted": [list(frame) for frame in sorted(set().union(*changed.noted.values()))],
        "by": [] if who in session.blind else sorted(changed.annotators),
        **session.state_after(who, changed.frames),
    }
