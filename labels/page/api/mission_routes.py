"""The mission: its classes, the state of every frame, and which frame to label next."""

from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import asdict
from itertools import count
from math import floor
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query
from starlette.responses import Response

from tokt.features.common.canonical import MAX_EXACT
from tokt.features.common.errors import ToktError, counted
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.frame_metadata import ifdo_of
from tokt.labels.formats.images import FrameKey
from tokt.labels.page.state.board import FrameName
from tokt.labels.page.state.session import Session
from tokt.labels.page.suggestions.queue import next_frames
from tokt.labels.taxonomy import UNSURE, UNSURE_KEY

from .messages import (
    Blind,
    BlindBody,
    Camera,
    Frame,
    SeenBody,
    SessionOf,
    SettingBody,
    Version,
    Who,
    check_frame,
    check_version,
    json_response,
    refuse,
)

router = APIRouter(prefix="/api")
_NO_CLASS_COLOR = "#e6e6e6"
_SCORE_DECIMALS = 4
_MAX_BANDS = 8  # of depth


@router.get("/mission")
def get_mission(session: SessionOf, blind: Blind, who: Who | None = None) -> Response:
    """Everything but the labels themselves."""
    who = who or session.annotator
    board = session.board
    session.refresh()
    board.reload_seen(who)
    return json_response(
        {
            "mission": session.mission.name,
            "version": session.version,
            "pictures": session.pictures_version,
            "grid": session.grid.to_json(),
            "cameras": {camera: _ranges(frames) for camera, frames in board.frames.items()},
            "classes": _classes(session, who),
            "annotator": session.annotator,
            "blind": blind,
            "annotators": [who] if blind else sorted({*board.annotators, who}),
            "model": None if blind else session.model_state(),
            "fault": session.fault,
            "setup": session.setup,
            "event": board.event,
            "states": board.states(who, blind),
            "given": board.given(who),
            "counts": board.counts(who),
            "undo": session.undo_heads(who),
            "other_grids": session.other_grids,
            "described": ifdo_of(session.mission.path) is not None,
            "masked": {
                camera: np.flatnonzero(board.masked(camera)).tolist() for camera in board.frames
            },
            "settings": {} if blind else session.settings,
            "job": None if blind else session.status()["job"],
            "depths": _depth_bands(session),
            "carries": session.carry is not None,
            "single_pictures": session.is_of_single_pictures,
            "formats": {name: kind.title for name, kind in FORMATS.items()},
        }
    )


@router.post("/blind")
def post_blind(session: SessionOf, body: BlindBody) -> Response:
    """Let a person label blind from now on, or see again; all of that person's pages hear of it."""
    session.set_blind(body.who, blind=body.blind)
    return json_response({"blind": body.who in session.blind})


@router.post("/settings")
def post_setting(session: SessionOf, body: SettingBody) -> Response:
    """Set one of the mission's settings; all pages hear of it."""
    obstacles = {known.name for known in session.taxonomy.classes if known.obstacle}
    unknown = sorted(set(body.value.split(",")) - obstacles)
    if unknown:
        raise refuse(400, f"{body.name}: {unknown[0]!r} is no class of obstacles")
    session.set_setting(body.name, body.value, body.who)
    return json_response({})


@router.get("/labelled")
def get_labelled(session: SessionOf, of: Who) -> Response:
    """Frames in which somebody labelled something; not how, so it may be asked blind."""
    cameras = _by_camera(session, session.board.labelled_frames(of))
    if not any(cameras.values()):
        raise refuse(404, f"{of} labelled nothing in mission {session.mission.name}")
    return json_response({"of": of, "cameras": cameras})


@router.get("/frames_with")
def get_frames_with(
    session: SessionOf, label: Annotated[str, Query(alias="class")], who: Who | None = None
) -> Response:
    """Frames in which this person gave some patch a label; nobody else's count."""
    found = session.board.frames_with(who or session.annotator, label)
    return json_response({"cameras": _by_camera(session, found)})


@router.get("/frames_at")
def get_frames_at(session: SessionOf, above: int, below: int) -> Response:
    """Frames from a depth in metres down to another, by the mission's iFDO file."""
    found = [
        (key.camera, key.frame)
        for key, one in sorted(session.metadata.items())
        if one.depth_m is not None and above <= one.depth_m < below
    ]
    return json_response({"cameras": _by_camera(session, found)})


@router.post("/seen")
def post_seen(session: SessionOf, body: SeenBody) -> Response:
    """Note that a person opened a frame."""
    check_frame(session, body.camera, body.frame)
    session.shown(body.camera, body.frame)
    session.mark_seen(body.who, body.camera, body.frame)
    frames = [(body.camera, body.frame)]
    return json_response(
        {"states": session.board.states_of(body.who, body.who in session.blind, frames)}
    )


@router.get("/frame_info")
def get_frame_info(session: SessionOf, camera: Camera, frame: Frame) -> Response:
    """What the mission's iFDO file says of a frame; nothing where it says nothing."""
    check_frame(session, camera, frame)
    try:
        found = session.metadata.get(FrameKey(camera, frame))
    except ToktError as error:
        raise refuse(400, str(error)) from None
    return json_response(asdict(found) if found else {})


@router.get("/sight")
def get_sight(session: SessionOf, camera: Camera, frame: Frame, version: Version = "") -> Response:
    """Why each patch of a frame is not seen; an empty string where it is."""
    check_version(session, version)
    check_frame(session, camera, frame)
    return json_response({"causes": session.unseen(camera, frame)})


@router.get("/queue")
def get_queue(
    session: SessionOf,
    blind: Blind,
    who: Who | None = None,
    n: Annotated[int, Query(ge=1, le=1000)] = 30,
    camera: Camera | None = None,
    frame: Frame | None = None,
) -> Response:
    """The next `n` frames for a person who sees `frame` now; what the model does not know waits."""
    if session.suggester is None:
        return _queue(why_not="no model was given: start tokt label with --model")
    if blind:
        return _queue(why_not="not while labelling blind: the order would show what the model says")
    done, total = session.suggester.progress
    labelled = session.board.labelled_frames(who or session.annotator)
    now = None if camera is None or frame is None else (camera, frame)
    frames = [
        {**vars(entry), "score": round(entry.score, _SCORE_DECIMALS)}
        for entry in next_frames(session.suggester.known(), labelled, n, now)
    ]
    why_not = "" if frames else _why_nothing_is_left(session.suggester.faults(), set(labelled))
    return _queue(frames, done, total, why_not if done == total else "")


def _why_nothing_is_left(faults: dict[FrameName, str], labelled: Collection[FrameName]) -> str:
    """Say why the queue is empty, once the model has looked at every frame."""
    refused = Counter(fault for name, fault in faults.items() if name not in labelled)
    if not refused:
        return "No frame is left to ask about: you labelled something in each of the others."
    fault = refused.most_common(1)[0][0]
    also = ", for example" if len(refused) > 1 else ""
    frames = counted(refused.total(), "frame")
    return f"The model cannot judge {frames} without a label of yours{also}: {fault}"


def _depth_bands(session: Session) -> list[tuple[int, int]]:
    """Whole metres from and to, a few bands that hold all frames whose depth is known."""
    with suppress(ToktError):  # a file that cannot be read, which `get_frame_info` tells
        known = [one.depth_m for one in session.metadata.values() if one.depth_m is not None]
        if known:
            steps = (m * 10**n for n in count() for m in (1, 2, 5))
            step = next(each for each in steps if max(known) - min(known) <= each * _MAX_BANDS)
            first, last = floor(min(known) / step), floor(max(known) / step)
            return [(n * step, (n + 1) * step) for n in range(first, last + 1)]
    return []


def _queue(
    frames: Sequence[dict[str, Any]] = (), done: int = 0, total: int = 0, why_not: str = ""
) -> Response:
    found = {"done": done, "total": total, "why_not": why_not, "frames": frames}
    return json_response({"ready": bool(total) and done == total, **found})


def _by_camera(session: Session, found: list[FrameName]) -> dict[str, list[int]]:
    cameras: dict[str, list[int]] = {camera: [] for camera in session.board.frames}
    for camera, frame in found:
        cameras[camera].append(frame)
    return cameras


def _ranges(frames: list[int]) -> dict[str, Any]:
    """Runs of numbers that follow each other, in the dive's order."""
    ranges: list[list[int]] = []
    for frame in frames:
        if ranges and frame == ranges[-1][1] + 1 and frame <= MAX_EXACT:
            ranges[-1][1] = frame
        else:
            ranges.append([frame, frame])
    return {"ranges": ranges, "count": len(frames)}


def _classes(session: Session, who: str) -> list[dict[str, Any]]:
    classes: list[dict[str, Any]] = [vars(known) for known in session.taxonomy.classes]
    known = {*session.taxonomy.names, UNSURE}
    classes.append(_no_class(UNSURE, UNSURE_KEY, "Looked at, and could not be decided."))
    classes.extend(
        _no_class(name, "", "Not in the taxonomy; labels of this name are in the store.")
        for name in session.names(who)
        if name not in known
    )
    return classes


def _no_class(name: str, key: str, description: str) -> dict[str, Any]:
    said = {"name": name, "obstacle": None, "color": _NO_CLASS_COLOR, "key": key}
    return {**said, "description": description}
