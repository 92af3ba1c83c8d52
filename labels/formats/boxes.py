"""Patches as boxes in pixels of the frame as the camera gave it, and which patches a box is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

HALF = 0.5
"""A patch takes a box's class when the box covers at least this share of the patch."""

_MAX_SIDE_PX = 100_000
_MAX_PATCHES = 1_000_000  # a file may name any grid, and this one fills no memory
_ROUNDING_PX = 1.0  # what other tools round a coordinate by
_OVER_THE_EDGE = 0.1  # of the frame's width or height
_EPSILON = 1e-9
_FAR_PX = 1e7  # a corner beyond is no nearer to any frame
_SUBPIXEL_BITS = 4
_CIRCLE_CORNERS = 64
_LEAST = {"point": 2, "rectangle": 8, "polygon": 6}  # numbers

Outline = tuple[tuple[float, float], ...]
"""Corners (x, y) in pixels of what is no upright box; a single one is a point."""


class Size(NamedTuple):
    """Height and width of a frame in pixels."""

    height: int
    width: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height}"

    def is_like(self, other: Size) -> bool:
        """Tell whether one is the other scaled, but for rounding to whole pixels."""
        if min(*self, *other) < 1:
            return False
        small, large = sorted((self, other))
        down, across = large.height / small.height, large.width / small.width
        # A side of the small one may be rounded by half a pixel, a side of the large one too.
        slack = (0.5 * down + 0.5) / small.height + (0.5 * across + 0.5) / small.width
        return abs(down - across) <= slack


class Box(NamedTuple):
    """Corners in pixels, from the frame's upper left corner."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def corners(self) -> tuple[float, ...]:
        """All four as alternating x and y, clockwise from the upper left."""
        return self.x0, self.y0, self.x1, self.y0, self.x1, self.y1, self.x0, self.y1

    def is_outside(self, size: Size) -> bool:
        """Whether no part of it is in a frame of that size."""
        return self.x0 >= size.width or self.y0 >= size.height or self.x1 <= 0 or self.y1 <= 0

    def is_like(self, other: Box) -> bool:
        """Whether it is the same box, but for what other tools round."""
        return all(abs(a - b) <= _ROUNDING_PX for a, b in zip(self, other, strict=True))


class Shape(NamedTuple):
    """What somebody drew: an upright box, or the outline that `box` is around."""

    box: Box
    outline: Outline = ()

    @property
    def noun(self) -> str:
        """What remarks call it."""
        return "point" if len(self.outline) == 1 else "box" if not self.outline else "outline"

    @property
    def is_empty(self) -> bool:
        """Whether it has no area and is no point."""
        x0, y0, x1, y1 = self.box
        return self.noun != "point" and (x1 <= x0 or y1 <= y0)

    def scaled(self, size: Size, to: Size) -> Shape:
        """The same shape of a picture of another size; width and height may differ by rounding."""
        across, down = to.width / size.width, to.height / size.height
        x0, y0, x1, y1 = self.box
        outline = tuple((x * across, y * down) for x, y in self.outline)
        return Shape(Box(x0 * across, y0 * down, x1 * across, y1 * down), outline)

    def patches(self, grid: Grid, size: Size) -> list[tuple[int, int, float]]:
        """Row, column and covered share of the patches in it; a point covers nothing of its one."""
        if self.noun == "point":
            at = patch_at(grid, size, *self.outline[0])
            return [(*at, 0.0)] if at else []
        if self.outline:
            return patches_in_outline(grid, size, self.outline)
        return patches_in_box(grid, size, self.box)

    def is_beyond(self, size: Size) -> bool:
        """Tell whether it was drawn on a larger frame than of that size, so far out it lies.

        A point may lie on the edge; boxes may be moved over it by a tenth of the frame.
        """
        slack = _ROUNDING_PX if self.noun == "point" else None
        across, down = (slack or _OVER_THE_EDGE * side for side in (size.width, size.height))
        x0, y0, x1, y1 = self.box
        return (
            min(x0 + across, y0 + down) < 0 or x1 > size.width + across or y1 > size.height + down
        )

    def is_of_patch(self, grid: Grid, size: Size, row: int, col: int) -> bool:
        """Whether it is the patch's box, or a point in it."""
        if self.outline:
            return self.noun == "point" and (row, col, 0.0) in self.patches(grid, size)
        return self.box.is_like(patch_box(grid, size, row, col))


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

    ToktError if the grid's patches would be under 3x3 pixels of the resized frame.
    """
    height, width = _patch_size(grid, size)
    return Box(col * width, row * height, (col + 1) * width, (row + 1) * height)


def patches_in_box(grid: Grid, size: Size, box: Box) -> list[tuple[int, int, float]]:
    """Row, column and covered share of patches covered by `HALF` or more; as `patch_box`."""
    height, width = _patch_size(grid, size)
    down = _overlap(grid.rows, height, box.y0, box.y1)
    across = _overlap(grid.cols, width, box.x0, box.x1)
    shares = np.outer(down, across)
    return [
        (int(row), int(col), float(shares[row, col]))
        for row, col in np.argwhere(shares >= HALF - _EPSILON)
    ]


def patch_at(grid: Grid, size: Size, x: float, y: float) -> tuple[int, int] | None:
    """Row and column of the patch that holds a point, None where none does; as `patch_box`."""
    height, width = _patch_size(grid, size)
    if not (0 <= x < size.width and 0 <= y < size.height):
        return None
    row, col = math.floor(y / height), math.floor(x / width)
    return (row, col) if grid.contains(row, col) else None


def patches_in_outline(grid: Grid, size: Size, outline: Outline) -> list[tuple[int, int, float]]:
    """As `patches_in_box`, of a polygon, counted in pixels of the resized frame."""
    _patch_size(grid, size)
    height, width = grid.resized(*size)
    mask = np.zeros((height, width), np.uint8)
    corners = np.clip(outline, -_FAR_PX, _FAR_PX) * (width / size.width, height / size.height)
    pixels = np.clip(corners - 0.5, -_FAR_PX, _FAR_PX) * 2**_SUBPIXEL_BITS
    cv2.fillPoly(mask, [np.rint(pixels).astype(np.int32)], (1,), shift=_SUBPIXEL_BITS)
    shares = grid.cells(mask).mean(axis=(1, 2))
    return [(*divmod(int(n), grid.cols), float(shares[n])) for n in np.flatnonzero(shares >= HALF)]


def found_shape(kind: str, numbers: Sequence[float]) -> Shape | None:
    """A shape as other tools name it, in small or large letters, and give it.

    ``point``, ``rectangle`` and ``polygon`` have alternating x and y, ``circle`` x, y and radius.
    None for any other kind, or where the count of numbers is not the kind's.
    """
    kind = kind.lower().replace("single-pixel", "point")  # as iFDO calls it
    if kind == "circle" and len(numbers) == 3:
        x, y, radius = numbers
        turns = [2 * math.pi * n / _CIRCLE_CORNERS for n in range(_CIRCLE_CORNERS)]
        corners = [(x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns]
    elif len(numbers) % 2 or len(numbers) < _LEAST.get(kind, math.inf):
        return None
    else:
        corners = list(zip(numbers[::2], numbers[1::2], strict=True))
    across, down = zip(*corners, strict=True)
    box = Box(min(across), min(down), max(across), max(down))
    upright = kind == "rectangle" and all(x in box[::2] and y in box[1::2] for x, y in corners)
    return Shape(box, () if upright else tuple(corners[:1] if kind == "point" else corners))


def _overlap(n: int, length: float, start: float, end: float) -> F64:
    """Share of each of `n` stretches of `length` that lies between `start` and `end`."""
    begins = np.arange(n) * length
    common = np.minimum(begins + length, end) - np.maximum(begins, start)
    return np.asarray(common.clip(0, None) / length, np.float64)
