"""Marks that never move in a camera's pictures: a burned-in clock, a rim, a part of the vehicle.

Edges of what a vehicle passes go through the picture, so that over many frames they cancel out.
Edges of a mark add up:

    strength = |mean of the gradients|               grey levels a pixel
    fixed    = strength / mean of their lengths      1 where an edge never moves, else about 0

Nothing can be told while the whole scene stands still, such as before a camera on a tripod or a
vehicle on the seabed: where much of the view is fixed, nothing is named.
"""

from __future__ import annotations

import cv2
import numpy as np

from tokt.features.common.arrays import F32, U8, Bools

from .grid import Grid

FEWEST_PICTURES = 12
"""Of fewer that are far apart some edges agree by chance; of such a number in a row, those of what
is near hardly move: in the sea trial of 20 April 2016 4 of 94 times, of 30 none."""
_AROUND_PX = 15  # what changes over more than this is the light
_STRENGTH = 4.0  # grey levels a pixel: far above what is left of noise
_FIXED = 0.9  # a sharp edge that sways by half a pixel has less
_EDGE_PX = 12  # pixels of edges that make a patch marked: a letter has more
_MOST = 0.3  # of the patches; more of them are a scene that stands still


class FixedMarks:
    """Look for marks in the pictures of one camera, which come one by one."""

    def __init__(self) -> None:
        self.count = 0
        self._sums: F32 | None = None  # (3, height, width): gradients across, down, their length

    def add(self, gray: U8) -> None:
        """Take in one more picture, gray and 360 wide, uint8 (height, width)."""
        edges = _edges(gray)
        if self._sums is None or self._sums.shape != edges.shape:
            self._sums, self.count = np.zeros_like(edges), 0
        self._sums += edges
        self.count += 1

    def patches(self, grid: Grid) -> Bools:
        """Find the patches that hold marks, shape (rows, cols); none before enough pictures."""
        none = np.zeros((grid.rows, grid.cols), bool)
        if self._sums is None or self.count < FEWEST_PICTURES:
            return none
        across, down, length = self._sums / self.count
        strength = cv2.magnitude(across, down)
        fixed = (strength > _STRENGTH) & (strength > _FIXED * length)
        high, wide = fixed.shape
        # The grid's patches are cut from a picture of its own width: their edges go by parts.
        cells = cv2.resize(
            fixed.astype(np.float32), (grid.cols, grid.rows), interpolation=cv2.INTER_AREA
        )
        marked = cells * (high * wide / none.size) >= _EDGE_PX
        return none if marked.mean() > _MOST else np.asarray(marked)


def _edges(gray: U8) -> F32:
    fine = gray.astype(np.float32)
    fine -= cv2.blur(fine, (_AROUND_PX, _AROUND_PX))
    across, down = (
        cv2.Sobel(fine, cv2.CV_32F, *way, ksize=3, scale=1 / 8) for way in ((1, 0), (0, 1))
    )
    return np.stack([across, down, cv2.magnitude(across, down)])
