"""Opening a session: mission, store and board, and the model if there is one."""

from __future__ import annotations

import hashlib
from pathlib import Path

from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.labels.page.suggestions.suggestion_table import mission_stamp
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.known_missions import note_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import load_taxonomy
from tokt.models.bundle.bundle import Bundle

from .board import Board
from .session import Session

CACHE = "cache"


def open_session(
    mission: Mission,
    workspace: Path,
    grid: Grid,
    annotator: str,
    version: str,
    taxonomy: Path | None = None,
    bundle: Bundle | None = None,
) -> Session:
    """Open the workspace's labels of a mission, ready to be served.

    Parameters
    ----------
    mission : Mission
    workspace : Path
        Made if it is not there.
    grid : Grid
    annotator : str
        Who labels unless a page says otherwise.
    version : str
        Of tokt.
    taxonomy : Path, optional
        Instead of the workspace's or the packaged one.
    bundle : Bundle, optional
        The model whose suggestions are shown.

    Raises
    ------
    ToktError
        If the store cannot be written, its labels of this name are of another dive, or the
        mission, the annotator's name, the taxonomy or the model cannot be used.
    """
    _check_frames(mission, grid, annotator)
    classes = load_taxonomy(workspace, taxonomy)
    store = LabelStore(workspace / FILE_NAME)
    try:
        store.check_writable()
        note_mission(workspace, mission)
        board = Board(mission, grid, classes, store)
        board.refresh()
        session = Session(mission, classes, store, board, annotator, version)
        session.other_grids = len(set(store.grids(mission.name)) - {str(grid)})
        session.pictures_version = _pictures_version(mission, version)
        session.find_fault()
        if bundle is not None:
            from tokt.labels.page.suggestions.suggester import Suggester

            session.suggester = Suggester(bundle, mission, grid, workspace / CACHE)
    except ToktError:
        store.close()
        raise
    return session


def _pictures_version(mission: Mission, version: str) -> str:
    text = f"{version}\n{mission.path.resolve()}\n{mission_stamp(mission)}"
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:16]


def _check_frames(mission: Mission, grid: Grid, annotator: str) -> None:
    """Refuse now what could not be labelled later: names, frame numbers, too fine a grid."""
    for camera in mission.cameras:
        last = mission.frames(camera)[-1]
        LabelRecord(mission.name, camera, last, grid, 0, 0, None, annotator, utc_now())
    camera = mission.cameras[0]
    try:
        height, width = mission.read(mission.frames(camera)[0], camera).shape[:2]
    except FrameError:
        return  # the page shows which frames cannot be read
    grid.patch_size(*grid.resized(height, width))
