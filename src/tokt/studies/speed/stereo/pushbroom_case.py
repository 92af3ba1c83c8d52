"""A stereo pair to its verdict: the thesis's disparity pipeline against pushbroom stereo."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.inference.frame_checks import pair_shape_fault
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import BAND, CELL_PX, PushbroomDetector
from tokt.studies.baselines.thesis_texture import GRID

from .pair_case import PairCase
from .pairs import Pair

MAX_DIFFERENT = 0.01
"""Part of the cells that both found whose depths may be further apart than a slice is deep."""


class PushbroomPair(PairCase):
    """A decoded pair to its detection, as ``tokt run --stereo pushbroom`` does it.

    Parameters
    ----------
    calibration : StereoCalibration
        Its maps are made once, as in a run.
    """

    def __init__(self, calibration: StereoCalibration) -> None:
        super().__init__(
            "pushbroom.pair",
            f"depths are within {BAND:.0%} of dense matching's in {1 - MAX_DIFFERENT:.0%} of a "
            "pair's cells that both found",
        )
        self._detector = PushbroomDetector(calibration, GRID)
        self._dense = DisparityDetector(calibration, GRID)
        self._places = self._dense_places()
        self._cells = {"found": 0, "found_by_both": 0}

    def _dense_places(self) -> NDArray[np.int64]:
        """The pixel (x, y) of the dense view at the middle of each cell, shape (n_cells, 2)."""
        width, height = self._detector.rectifier.size
        rows, columns = np.indices((height // CELL_PX, width // CELL_PX)).reshape(2, -1)
        middles = np.column_stack([columns, rows]) * CELL_PX + (CELL_PX - 1) / 2
        dense = self._dense.rectifier
        places = dense.from_frame(self._detector.rectifier.to_frame(middles))
        return places.round().astype(np.int64).clip(0, np.array(dense.size) - 1)

    def ours(self, item: Pair) -> object:
        """Rectify, match at a few disparities, remember."""
        return self._detector.detect(item.frame)

    def check(self, item: Pair) -> bool:
        """Every depth that ours finds against the one that dense matching finds there."""
        if pair_shape_fault(item.frame, self._detector.calibration.frame_size):
            return self.refused()
        ours = self._detector.look(item.left, item.right).ravel()
        matches = self._dense.match(item.left, item.right)
        x, y = self._places[ours > 0].T
        both = matches.valid[y, x]
        dense = self._dense.rectifier.focal_baseline_px_m / matches.disparity_px[y, x][both]
        apart = np.abs(ours[ours > 0][both] / dense - 1) > BAND
        self._cells["found"] += int((ours > 0).sum())
        self._cells["found_by_both"] += int(both.sum())
        different = bool(apart.sum() > MAX_DIFFERENT * apart.size)
        return self.compared(item, different, bool(ours.any()))

    def findings(self) -> dict[str, Any]:
        """What was compared, and how many cells."""
        return {**super().findings(), "cells": dict(self._cells)}
