"""Label files through the page: export, import, and a copy of the store.

``GET /api/export?format=coco`` downloads this mission's labels, a folder as ``.zip``; ``only=anna``
hers alone, ``full=1`` all columns. With ``check=1`` it answers how many and what gets lost.
``POST /api/import?name=ben.csv`` takes a file as its body and answers what it would do, and the
classes it does not know; ``map=fish=reef`` (often) says what they are, ``apply=1`` does it.
``GET /api/backup`` downloads a checked copy of the whole store.
"""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.responses import FileResponse, Response

from tokt.features.common.errors import ToktError, os_errors_as
from tokt.labels.export import Wanted, export_labels
from tokt.labels.formats.formats import FORMATS, format_named, format_to_read
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.labels import assumed_annotator
from tokt.labels.page.state.session import CACHE, Session
from tokt.labels.record import HUMAN, NoLabelsError, utc_now
from tokt.labels.store.backup import back_up
from tokt.labels.taxonomy import UnknownClassError

from .messages import MAX_NAME, Blind, Camera, SessionOf, Who, json_response, refuse, refuse_blind

router = APIRouter(prefix="/api")
_NOT_IN_NAMES = re.compile(r'[\\/:*?"<>|]')
_FormatName = Annotated[str, Query(alias="format", max_length=MAX_NAME)]


@router.get("/export")
def get_export(
    session: SessionOf,
    chosen: _FormatName,
    only: Who | None = None,
    full: bool = False,
    check: bool = False,
    who: Who | None = None,
    blind: Blind = False,
) -> Response:
    """Labels in force of this mission and grid, as a file of a format."""
    refuse_blind(blind and only != (who or session.annotator))
    kind = FORMATS[_known_format(chosen)]
    wanted = Wanted(session.mission.name, only, session.grid)
    options = WriteOptions(session.taxonomy, MissionImages(session.mission), full)
    others = f"labels on {session.other_grids} other grids left out"
    told: dict[str, Any] = {}

    def write(folder: Path) -> Path:
        file = folder / f"{_plain(session.mission.name)}-{_plain(only or 'all')}{kind.ending}"
        written = export_labels(session.store, file, chosen, wanted, options)
        lost = [*written.lost, *([others] if session.other_grids else [])]
        told.update(file=file.name, format=chosen, labels=written.labels, lost=lost)
        return Path(shutil.make_archive(str(file), "zip", file)) if file.is_dir() else file

    try:
        answer = _download(session, write)
    except NoLabelsError:  # it names all annotators
        raise refuse(409, "no such labels") from None
    return json_response(told) if check else answer


@router.get("/backup")
def get_backup(session: SessionOf, blind: Blind) -> Response:
    """The whole store in one checked file."""
    refuse_blind(blind)

    def write(folder: Path) -> Path:
        file = folder / f"labels-{utc_now()[:10]}.db"
        back_up(session.store, file)
        return file

    return _download(session, write)


@router.post("/import")
async def post_import(
    session: SessionOf,
    request: Request,
    name: Annotated[str, Query(max_length=MAX_NAME)],
    chosen: _FormatName = "",
    annotator: Who | None = None,
    camera: Camera = "left",
    folder: Annotated[str | None, Query(max_length=MAX_NAME)] = None,
    classes: Annotated[list[str], Query(alias="map", max_length=MAX_NAME)] = [],  # noqa: B006
    apply: bool = False,
    who: Who | None = None,
) -> Response:
    """Tell what a label file would add and what is odd in it, or with `apply` add it.

    Who labels blind takes only own labels: how many are new would tell what others say.
    """
    who = who or session.annotator
    bare = PureWindowsPath(name).name  # what a browser on any system calls it
    if not bare.isprintable() or bare in ("", ".", ".."):
        raise refuse(400, f"{name!r} is no name of a file")
    with _scratch(session) as folder, os_errors_as(bare):
        file = Path(folder) / bare
        try:
            with file.open("wb") as sink:
                async for part in request.stream():
                    sink.write(part)
        except ClientDisconnect:
            raise refuse(400, "the file broke off") from None
        images = MissionImages(session.mission, folder=folder)
        mapped = dict(pair.partition("=")[::2] for pair in classes)
        options = ReadOptions(session.taxonomy, annotator, session.grid, images, mapped, camera)
        try:
            told = await run_in_threadpool(_take, session, file, chosen, options, apply, who)
        except ToktError as error:
            if error.__cause__ is not None:  # the store's: all pages hear of it
                raise
            raise refuse(409, str(error).replace(f"{folder}{os.sep}", "")) from None
    return json_response({"file": bare, **told})


def _take(
    session: Session, file: Path, chosen: str, options: ReadOptions, apply: bool, who: str
) -> dict[str, Any]:
    kind = _known_format(chosen) if chosen else format_to_read(file)
    try:
        read = FORMATS[kind].read(file, options)
    except UnknownClassError as error:
        if apply:
            raise
        return {"format": kind, "applied": False, "unknown": error.names}
    own = all((record.annotator, record.source) == (who, HUMAN) for record in read.records)
    refuse_blind(who in session.blind and not own)
    assumed = assumed_annotator(file, options.annotator, read.records)
    added = session.store.add_counted(read.records, dry=not apply, assumed=assumed)
    if apply:
        session.refresh()
    here = session.mission.name, session.grid
    return {
        "format": kind,
        "applied": apply,
        "unknown": [],
        "annotators": sorted({record.annotator for record in read.records}),
        "labels": len(read.records),
        "here": sum((record.mission, record.grid) == here for record in read.records),
        **vars(added),
        "lost": read.lost,
    }


def _known_format(name: str) -> str:
    try:
        return format_named(name)
    except ToktError as error:
        raise refuse(400, str(error)) from None


def _plain(name: str) -> str:
    return _NOT_IN_NAMES.sub("-", name)


def _scratch(session: Session) -> TemporaryDirectory[str]:
    cache = session.store.path.parent / CACHE
    with os_errors_as(str(cache)):
        cache.mkdir(exist_ok=True)
        return TemporaryDirectory(prefix=".partial-", dir=cache)


def _download(session: Session, write: Callable[[Path], Path]) -> Response:
    """The file that `write` writes into a folder, which goes when the file has been sent."""
    folder = _scratch(session)
    try:
        file = write(Path(folder.name))
    except BaseException:
        folder.cleanup()
        raise
    return FileResponse(
        file,
        media_type="application/octet-stream",
        headers={"cache-control": "no-store"},
        filename=file.name,
        background=BackgroundTask(folder.cleanup),
    )
