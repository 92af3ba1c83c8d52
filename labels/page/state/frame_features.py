"""Texture features of the frames that have labels, computed beside the page and kept in memory."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tokt.features.common.arrays import F32, F64, I64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import Mission
from tokt.features.frames.view_mask import CameraMasks
from tokt.labels.page.background import Background
from tokt.labels.page.frames import for_background
from tokt.labels.page.masks import covered_frame

from .board import FrameName, Numbering

WHAT = "LBP and Haralick features"
_EXTRACTOR = extractor_named("lbp_10_5_frame+haralick")
_FIRST_ROOM = 64  # frames

CellName = tuple[str, int, int]


@dataclass(frozen=True)
class PatchLocations:
    """Places of patches in a `FeatureSnapshot`: each one's frame, and its cell in that frame."""

    rows: I64
    cells: I64


@dataclass(frozen=True)
class FeatureSnapshot:
    """The features known at one moment; row i of each array is one frame."""

    features: F32
    """Of shape (at least n, n_patches, dim), only of frames that are `good`."""
    positions: I64  # of the frames in the dive, counted from 1
    good: Bools
    """Which frames have been looked at and could be read."""
    done: int
    """How many have been looked at."""


class FrameFeatures:
    """Features of every patch of the frames that were asked for, what is masked being covered.

    For any number of threads. It needs some 100 bytes a patch.
    """

    def __init__(self, mission: Mission, grid: Grid, masks: CameraMasks) -> None:
        self._mission = for_background(mission)
        self._grid = grid
        self._masks = masks
        self._lock = threading.Lock()
        self._rows = Numbering[FrameName]()
        self._good: list[bool] = []
        self._features = np.zeros((_FIRST_ROOM, grid.n_patches, _EXTRACTOR.dim), np.float32)
        self.background = Background("tokt-sheet", self._step)

    def locate(self, cells: Sequence[CellName]) -> PatchLocations:
        """Places of patches in the next `snapshot`; their frames are computed if need be."""
        with self._lock:
            rows = (self._rows[camera, frame] for camera, frame, _ in cells)
            located = PatchLocations(
                np.fromiter(rows, np.int64, len(cells)),
                np.fromiter((cell for _, _, cell in cells), np.int64, len(cells)),
            )
        self.background.wake()
        return located

    def snapshot(self) -> FeatureSnapshot:
        """All that is known; what comes later does not change it."""
        with self._lock:
            n = len(self._rows.words)
            good = np.zeros(n, bool)
            good[: len(self._good)] = self._good
            place = self._mission.place
            positions = np.fromiter(
                (1 + place(frame) for _, frame in self._rows.words), np.int64, n
            )
            return FeatureSnapshot(self._features, positions, good, len(self._good))

    def _step(self) -> bool:
        row = len(self._good)
        with self._lock:
            if row == len(self._rows.words):
                return False
            camera, frame = self._rows.words[row]
        features = self._describe(camera, frame)
        with self._lock:
            if row == len(self._features):
                # A new array: somebody may be reading the old one.
                self._features = np.concatenate([self._features, np.zeros_like(self._features)])
            if features is not None:
                self._features[row] = features
            self._good.append(features is not None)
        return True

    def _describe(self, camera: str, frame: int) -> F64 | None:
        try:
            picture = covered_frame(self._mission, self._masks, camera, frame)
            return _EXTRACTOR.describe(picture, self._grid)
        except (ToktError, ValueError):  # unreadable, or too small for the grid
            return None
