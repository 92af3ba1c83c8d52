"""The session of one running server: opened; the mission, its labels, what follows from them."""

import hashlib
import json
import math
import re
import shutil
import threading
import zlib
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, ToktError, os_words
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.features.frames.single_pictures import why_single_pictures
from tokt.features.frames.view_mask import CameraMasks, read_masks, write_masks
from tokt.labels.formats.frame_metadata import FrameMetadata, mission_metadata
from tokt.labels.formats.images import FrameKey
from tokt.labels.page.masks import covered_frame, drawn_mask, shown_size
from tokt.labels.page.suggestions.suggester import Sight, Suggester
from tokt.labels.page.suggestions.suggestion_table import mission_stamp
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.known_missions import note_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import Taxonomy, load_taxonomy
from tokt.models.bundle.bundle import Bundle

from .audits import Audits
from .board import Board, FrameName
from .jobs import Jobs
from .live import Broadcaster
from .mark_search import MarkSearch
from .pictures import PatchPictures
from .review_sheet import ReviewSheet

CACHE = "cache"
Carry = Callable[[U8, U8, Sequence[str | None], Collection[str]], list[str | None]]
_MAX_ROWS = 20
_MAX_NAME = 60  # an audit's name has the dataset's hash, too
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9]+")
LITTLE_BYTES = 20_000_000


@dataclass
class Session:
    """One mission on one workspace, served to any number of pages."""

    mission: Mission
    taxonomy: Taxonomy
    store: LabelStore
    board: Board
    annotator: str
    """Who labels unless a page says otherwise."""
    version: str
    """Of tokt."""
    suggester: Suggester | None = None
    other_grids: int = 0
    """Number of other grids in which this mission is labelled."""
    pictures_version: str = ""
    """Changes with the mission's files and with tokt: the same one, the same pictures."""
    live: Broadcaster = field(default_factory=Broadcaster)
    fault: str = ""
    """Why nothing can be saved at present, or an empty string."""
    settings: dict[str, str] = field(default_factory=dict)
    """Of the mission, for everybody."""
    blind: frozenset[str] = frozenset()
    """Who labels this mission blind: these hear nothing of what others or the model said, whatever
    browser they use. The store knows it, and no page is asked."""
    taxonomy_file: Path | None = None
    """Where the classes come from, if not from the workspace."""
    carry: Carry | None = None
    """Gives a right frame its labels from both frames, the left one's labels and the names of what
    is clear."""
    sight: Sight | None = None
    changing: threading.Lock = field(default_factory=threading.Lock)
    """Held by who changes the classes or the masks."""
    jobs: Jobs = field(default_factory=Jobs)
    _refreshing: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self.pictures = PatchPictures(self.mission, self.grid)
        self.sheet = ReviewSheet(self.mission, self.board)
        self.audits = Audits(self.store, self.board)
        self.marks = MarkSearch(self.mission, self.grid)

    @cached_property
    def metadata(self) -> dict[FrameKey, FrameMetadata]:
        """What is known of frames: when, where, how deep; raises ToktError."""
        return mission_metadata(self.mission)

    @cached_property
    def is_of_single_pictures(self) -> bool:
        """Whether the mission is no sequence, so that no frame says anything of the next."""
        with suppress(ToktError):  # a picture that cannot be read, which the page tells
            return bool(why_single_pictures(self.mission))
        return False

    @property
    def grid(self) -> Grid:
        """The grid that is labelled in."""
        return self.board.grid

    def refresh(self) -> None:
        """Bring the board up to date and tell all pages; ToktError if the store cannot be read."""
        # Within one lock, so that pages hear of events in their order.
        with self._refreshing:
            self.settings = self.store.settings(self.mission.name)
            self.blind = self.store.blind_annotators(self.mission.name)
            changed = self.board.refresh()
            if changed:
                self.live.publish(changed)

    def find_fault(self) -> str:
        """Try whether something could be saved; sets and returns `fault`."""
        file = self.store.path
        try:
            self.store.check_writable()
            free = shutil.disk_usage(file.parent).free
            little = f"label store {file}: the disk is almost full, {free / 1e6:.0f} MB are left"
            self.fault = "" if free >= LITTLE_BYTES else little
        except ToktError as error:
            self.fault = str(error)
        except OSError as error:
            self.fault = f"{file.parent}: {os_words(error)}"
        return self.fault

    def status(self) -> dict[str, Any]:
        """The server's own state; pages get it without the names of who is `blind`."""
        job = self.jobs.last and self.jobs.last.to_json()
        state = {"fault": self.fault, "model": self.progress(), "setup": self.setup, "job": job}
        return {**state, "settings": self.settings, "blind": self.blind}

    @property
    def setup(self) -> str:
        """Changes with the classes, the model and the masks: pages load the mission anew."""
        model = self.suggester and self.suggester.bundle.sha256
        text = json.dumps([self.taxonomy.to_json(), model, self.board.masks.to_json()])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def use_taxonomy(self, taxonomy: Taxonomy) -> None:
        """Put other classes in force, and tell all pages."""
        self.board.use_classes(taxonomy.names)
        self.taxonomy = taxonomy
        self.live.publish()

    def use_model(self, bundle: Bundle) -> None:
        """Suggest what another model says, and tell all pages; ToktError if its grid differs."""
        cache = self.store.path.parent / CACHE
        fresh = Suggester(bundle, self.mission, self.grid, cache, self.board.masks, self.sight)
        before, self.suggester = self.suggester, fresh
        fresh.background.start()
        self.live.publish()
        if before is not None:
            before.close()

    def mask_patches(self, camera: str, cells: Collection[int]) -> None:
        """Mask these patches of a camera's frames and no others, and tell all pages.

        Raises ToktError if too little of the view is left or the mask cannot be written.
        """
        size = shown_size(self.mission, camera)
        patches = np.zeros((self.grid.rows, self.grid.cols), bool)
        patches.flat[list(cells)] = True
        with self.changing:
            before = read_masks(self.mission.path)
            mask = drawn_mask(before.of(camera), self.grid, patches, size)
            masks = replace(before, **{camera: mask})
            write_masks(self.mission.path, masks)
            self._use_masks(masks)

    def _use_masks(self, masks: CameraMasks) -> None:
        with self._refreshing:
            self.board.use_masks(masks)
        before, self.sheet = self.sheet, ReviewSheet(self.mission, self.board)
        before.background.close()
        if self.suggester is not None:
            self.use_model(self.suggester.bundle)
        self.live.publish()

    def unseen(self, camera: str, frame: int) -> Sequence[str]:
        """Why each patch of a frame is not seen; "" where it is. Raises FrameError."""
        if self.sight is None:
            return [""] * self.grid.n_patches
        limits = self.suggester.bundle.sight if self.suggester else ()
        masks = self.board.masks
        picture = covered_frame(self.mission, masks, camera, frame)
        return self.sight(limits, picture, masks.of(camera))

    def progress(self) -> dict[str, int] | None:
        """How many frames the model has been asked about; None without a model."""
        if self.suggester is None:
            return None
        done, total = self.suggester.progress
        return {"done": done, "total": total}

    def model_state(self) -> dict[str, Any] | None:
        """The model as pages get it; None without one."""
        if self.suggester is None:
            return None
        bundle = self.suggester.bundle
        return {
            "label": bundle.label,
            "classes": list(bundle.model.classes),
            "obstacle": list(bundle.model.obstacle),
            "learnt": _learnt(bundle),
            "right": _right_by_margin(bundle),
            **(self.progress() or {}),
        }

    def mark_seen(self, who: str, camera: str, frame: int) -> None:
        """Keep that `who` opened a frame. Raises ToktError if the store cannot be written."""
        if not self.board.is_seen(who, camera, frame):
            self.store.mark_seen(self.mission.name, camera, frame, who, utc_now())
            self.board.mark_seen(who, camera, frame)

    def set_setting(self, name: str, value: str, who: str) -> None:
        """Set what holds for everybody in this mission, and tell all pages."""
        self.store.set_setting(self.mission.name, name, value, who, utc_now())
        self._tell()

    def set_blind(self, who: str, *, blind: bool) -> None:
        """Let `who` label blind from now on, or see again, and tell all pages."""
        self.store.set_blind(self.mission.name, who, blind=blind, time=utc_now())
        self._tell()

    def _tell(self) -> None:
        self.refresh()
        self.live.publish()

    def start(self) -> None:
        """Begin what is computed beside the page."""
        if self.suggester is not None:
            self.suggester.background.start()

    def give_way(self) -> None:
        """Let what is computed beside the page wait a moment: somebody asks something."""
        if self.suggester is not None:
            self.suggester.background.give_way()
        self.sheet.background.give_way()
        self.marks.background.give_way()

    def shown(self, camera: str, frame: int) -> None:
        """Compute what is near this frame first: somebody looks at it."""
        if self.suggester is not None:
            self.suggester.prefer(camera, frame)

    def close(self) -> None:
        """End what is computed, and close the store."""
        self.jobs.close()
        if self.suggester is not None:
            self.suggester.close()
        self.sheet.background.close()
        self.marks.background.close()
        self.store.close()

    def undo_heads(self, who: str) -> dict[str, Any]:
        """What undo and redo would act on, as pages get it."""
        heads = self.store.history_top(who, self.mission.name, self.grid)
        return dict(zip(("undo", "redo"), (head and vars(head) for head in heads), strict=True))

    def names(self, who: str) -> list[str]:
        """Labels that `who` may give: classes, ``unsure``, and what the store has beside them.

        What only others used is theirs: somebody who labels blind does not hear of it.
        """
        if who in self.blind:
            return list(self.board.counts(who))
        return self.board.names

    def state_after(self, who: str, frames: set[FrameName]) -> dict[str, Any]:
        """What a page must know after a change: these frames' states and classes, counts, undo."""
        return {
            "states": self.board.states_of(who, who in self.blind, frames),
            "given": self.board.given(who, frames),
            "counts": self.board.counts(who),
            "undo": self.undo_heads(who),
        }


def _learnt(bundle: Bundle) -> dict[str, int]:
    """How many patches of each class a model learnt; what a bundle says of it may be anything."""
    counts = bundle.content.provenance.get("label_counts")
    items = counts.items() if isinstance(counts, dict) else ()
    return {name: n for name, n in items if isinstance(n, int)}


def _right_by_margin(bundle: Bundle) -> list[list[float | None]]:
    """Obstacle (1 or 0), least and greatest margin, at least so many right of a hundred.

    Nothing where nobody measured it, or what the bundle says of it is no such table.
    """
    found = []
    with suppress(KeyError, TypeError, ValueError, OverflowError):
        for one in bundle.content.metrics["right_by_margin"][:_MAX_ROWS]:
            high = math.inf if one["high"] is None else float(one["high"])
            low, share = float(one["low"]), float(one["at_least"])
            if 0 <= low < high and 0 <= share <= 1:
                end = None if high == math.inf else high
                found.append([int(one["obstacle"] is True), low, end, min(99, int(100 * share))])
    return found if len(bundle.model.classes) == 2 else []


def own_model_file(workspace: Path, mission: Mission) -> Path:
    """The bundle of the model that is trained of a mission's labels through the page."""
    name = _NOT_IN_NAMES.sub("-", mission.name)[:_MAX_NAME].strip("-")
    if name != mission.name:  # another mission's would be called the same
        name = f"{name or 'mission'}-{zlib.crc32(mission.name.encode('utf-8', 'replace')):08x}"
    return workspace / "models" / f"{name}.tokt"


def open_session(
    mission: Mission,
    workspace: Path,
    grid: Grid,
    annotator: str,
    version: str,
    taxonomy: Path | None = None,
    bundle: Bundle | None = None,
    sight: Sight | None = None,
) -> Session:
    """Open the workspace's labels of a mission, ready to be served.

    The workspace is made if it is not there. `taxonomy` goes before the workspace's and the
    packaged one; `bundle` is the model whose suggestions are shown, `sight` says what is not seen.

    Raises ToktError if the store cannot be written, its labels of this name are of another dive, or
    the mission, the annotator's name, the taxonomy or the model cannot be used.
    """
    _check_frames(mission, grid, annotator)
    classes = load_taxonomy(workspace, taxonomy)
    store = LabelStore(workspace / FILE_NAME)
    try:
        store.check_writable()
        note_mission(workspace, mission)
        store.keep_files(mission)
        board = Board(mission, grid, classes, store)
        session = Session(mission, classes, store, board, annotator, version)
        session.refresh()
        session.other_grids = len(set(store.grids(mission.name)) - {str(grid)})
        shown = f"{version}\n{mission.path.resolve()}\n{mission_stamp(mission)}"
        stamp = hashlib.sha256(shown.encode("utf-8", "surrogateescape"))
        session.pictures_version = stamp.hexdigest()[:16]
        session.find_fault()
        session.taxonomy_file = taxonomy
        session.sight = sight
        if bundle is not None:
            cache = workspace / CACHE
            session.suggester = Suggester(bundle, mission, grid, cache, sight=sight)
    except ToktError:
        store.close()
        raise
    return session


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
