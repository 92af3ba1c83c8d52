"""Patches as boxes in pixels of the frame as the camera gave it, and which patches a box is."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

HALF = 0.5
"""A patch takes a box's class when the box covers at least this share of the patch."""

_MAX_SIDE_PX = 100_000
_MAX_PATCHES = 1_000_000  # a file may name any grid, and this one fills no memory
_ROUNDING_PX = 1.0  # what other tools round a coordinate by
_EPSILON = 1e-9


class Size(NamedTuple):
    """Height and width of a frame in pixels."""

    height: int
    width: int


class Box(NamedTuple):
    """Corners in pixels, from the frame's upper left corner."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def is_empty(self) -> bool:
        """Whether no pixel is in it."""
        return self.x1 <= self.x0 or self.y1 <= self.y0

    def is_outside(self, size: Size) -> bool:
        """Whether no part of it is in a frame of that size."""
        return self.x0 >= size.width or self.y0 >= size.height or self.x1 <= 0 or self.y1 <= 0

    def is_like(self, other: Box) -> bool:
        """Whether it is the same box, but for what other tools round."""
        return all(abs(a - b) <= _ROUNDING_PX for a, b in zip(self, other, strict=True))


@lru_cache(maxsize=256)
def _patch_size(grid: Grid, size: Size) -> tuple[float, float]:
    """Height and width of a patch in pixels of a frame of `size`."""
    if not all(1 <= side <= _MAX_SIDE_PX for side in size):
        raise ToktError(f"a frame of {size.width}x{size.height} pixels")
    if grid.n_patches > _MAX_PATCHES:
        raise ToktError(f"grid {grid} has more than {_MAX_PATCHES} patches")
    height, width = grid.resized(*size)
    patch_height, patch_width = grid.patch_size(height, width)
    return patch_height * size.height / height, patch_width * size.width / width


def patch_box(grid: Grid, size: Size, row: int, col: int) -> Box:
    """One patch's box in a frame of `size`, scaled back from the resized frame.

    Raises
    ------
    ToktError
        If the grid's patches would be under 3x3 pixels of the resized frame.
    """
    height, width = _patch_size(grid, size)
    return Box(col * width, row * height, (col + 1) * width, (row + 1) * height)


def patches_in_box(grid: Grid, size: Size, box: Box) -> list[tuple[int, int, float]]:
    """Patches that `box` covers by `HALF` or more: row, column and the share that it covers.

    Raises
    ------
    ToktError
        As `patch_box`.
    """
    height, width = _patch_size(grid, size)
    down = _overlap(grid.rows, height, box.y0, box.y1)
    across = _overlap(grid.cols, width, box.x0, box.x1)
    shares = np.outer(down, across)
    return [
        (int(row), int(col), float(shares[row, col]))
        for row, col in np.argwhere(shares >= HALF - _EPSILON)
    ]


def _overlap(n: int, length: float, start: float, end: float) -> F64:
    """Share of each of `n` stretches of `length` that lies between `start` and `end`."""
    begins = np.arange(n) * length
    common = np.minimum(begins + length, end) - np.maximum(begins, start)
    return np.asarray(common.clip(0, None) / length, np.float64)
