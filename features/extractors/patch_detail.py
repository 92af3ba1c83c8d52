"""The detail of a frame's patches: how much their pixels differ, near by and farther off.

Noise of a sensor is different from pixel to pixel, and no more so from one to another far off; what
is to be seen in water, specks, gradients and edges, makes pixels differ more the farther off they
are. A blurred picture has no noise left, a stretched one none in one direction, and noise that was
put on top of one, or that a covered lens gives, is alike over all distances.

Every patch is looked at together with its neighbours (3x3 patches), which steadies what a hundred
pixels say by chance.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from tokt.features.common.arrays import F64, I64, U8, Bools, median
from tokt.features.frames.grid import MAX_PICTURE, Grid
from tokt.features.frames.view_mask import ViewMask
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL

from .frame_pictures import FramePictures

DETAIL_GRID = Grid(10, 10, 360)
"""The patches that are looked at, whatever grid a model has: what was measured holds for these."""

MEASURES = (
    *("noise_across", "near_across", "middle_across", "far_across"),
    *("noise_down", "near_down", "middle_down", "far_down", "coarse"),
)
"""Logarithms to base 2, higher the less of a picture there is.

``noise``: of the square root of the level, over the difference of neighbouring pixels: photons and
so noise come by that root. ``near``, ``middle`` and ``far``: of differences over 1, 2 and 4 pixels,
over those of 2, 4 and 16. ``coarse``: of second differences over 1 pixel, over those of 4, in the
frame resized to width 360, where averaging has taken noise away.
"""

_LEAST_PATCH_PX = 3  # of the resized frame: the least of a grid
_LAGS = (1, 2, 4, 16)  # pixels of the frame
_COARSE_LAGS = (1, 4)  # pixels of the resized frame
_BEYOND_NOISE = 2  # from that lag on neighbouring noise is alike no more, be it of a mosaic
_NEXT_ROW = 2 + len(_LAGS)  # where the kernel has the differences from it
_PIXELS = 400  # of a patch that are compared: a thirtieth of those of 1360x1024
_FEWEST_VALUES = 60
"""Of a patch's row: fewer are the same as in the next row by chance, where noise is low."""
_LEAST_DIFFERENCE = 0.004  # grey levels: what is added, so that no logarithm is of 0
_LEAST_SQUARE = 1e-4  # grey levels squared


@dataclass(frozen=True)
class PatchDetail:
    """Measures of one frame's patches, arrays of float64 of shape (rows, cols, ...)."""

    level: F64  # mean level over all channels, 0 to 255
    bright: F64  # part of the pixels that have 250 or more
    difference: F64  # mean over all lags and both directions, in grey levels
    repeated: F64  # part of the rows of pixels that are the same as the next one; 0 if they are few
    measures: F64  # (rows, cols, 9): `MEASURES`
    contrast: F64  # of specks and edges, over the level: differences that noise does not make

    @property
    def visible_contrast(self) -> float:
        """The frame's: the median, as what is near or covered is a part of it."""
        return float(median(self.contrast.ravel()))


@lru_cache(maxsize=8)
def _rows(height: int, width: int) -> I64 | None:
    """Rows of a frame that are compared, as many in each row of patches; None if it is too low."""
    patch_height, patch_width = height // DETAIL_GRID.rows, width // DETAIL_GRID.cols
    lowest = height - 1 - _LAGS[-1]
    if min(patch_height, patch_width, lowest + 1) < 1:
        return None
    count = min(math.ceil(_PIXELS / patch_width), patch_height)
    inside = (2 * np.arange(count) + 1) * patch_height // (2 * count)
    rows = np.arange(DETAIL_GRID.rows)[:, None] * patch_height + inside
    return np.asarray(np.minimum(rows, lowest), np.int64)


def detail_grid(width: int) -> Grid:
    """`DETAIL_GRID` for frames of this width: what is narrower is not enlarged."""
    return DETAIL_GRID if width >= (DETAIL_GRID.width or 0) else replace(DETAIL_GRID, width=None)


def masked_patches(frame: U8, mask: ViewMask | None) -> Bools | None:
    """The patches that are measured and masked, (rows, cols); None where none is."""
    if mask is None or min(frame.shape[:2]) < _LEAST_PATCH_PX * DETAIL_GRID.rows:
        return None
    grid = detail_grid(frame.shape[1])
    size = grid.resized(*frame.shape[:2])
    return mask.patches(grid, *size) if min(size) >= _LEAST_PATCH_PX * grid.rows else None


def patch_detail(
    frame: U8, pictures: FramePictures | None = None, masked: Bools | None = None
) -> PatchDetail | None:
    """Measure a frame's patches.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it.
    pictures : FramePictures, optional
        Those of this frame on `detail_grid`, where the caller has them.
    masked : array of bool, shape (rows, cols), optional
        As `masked_patches` gives it: these say nothing about those beside them, and have the mean
        of the others.

    Returns
    -------
    PatchDetail or None
        None of a frame that is too small for patches, or of no camera's shape.
    """
    height, width = frame.shape[:2]
    rows = _rows(height, width)
    grid = detail_grid(width)
    small = grid.resized(height, width)
    least_px = _LEAST_PATCH_PX * max(grid.rows, grid.cols)
    if rows is None or min(small) < least_px or math.prod(small) > MAX_PICTURE:
        return None
    gray16 = (pictures or FramePictures(frame, grid)).near_gray16
    sums = KERNELS.difference_sums(frame, rows.ravel(), grid.cols, _LAGS)
    sums = sums.reshape(*rows.shape, grid.cols, -1)
    channels = frame.shape[2] if frame.ndim == 3 else 1
    repeated = (sums[..., _NEXT_ROW] == 0).mean(axis=1)
    if channels * (width // grid.cols) < _FEWEST_VALUES:
        repeated[:] = 0
    mean = sums.sum(axis=1) / (rows.shape[1] * (width // grid.cols) * channels)
    squares = KERNELS.curvature_sums(gray16, grid, (*_COARSE_LAGS, _BEYOND_NOISE))
    pixels = math.prod(grid.patch_size(*gray16.shape)) * STEPS_PER_LEVEL**2
    coarse = squares.reshape(grid.rows, grid.cols, -1) / pixels
    view = None if masked is None or masked.all() else ~masked
    if view is not None:
        for each in (mean, coarse, repeated):
            each[~view] = each[view].mean(axis=0)
    differences = mean[..., 2:]
    measures = _measures(mean[..., 0], differences, coarse[..., :2], view)
    mean_difference = differences.mean(axis=-1)
    contrast = np.sqrt(np.maximum(coarse[..., 1] - coarse[..., 2], 0)) / (mean[..., 0] + 1)
    return PatchDetail(mean[..., 0], mean[..., 1], mean_difference, repeated, measures, contrast)


def _measures(level: F64, differences: F64, coarse: F64, view: Bools | None) -> F64:
    """`MEASURES` of each patch with those of its neighbours that are view, or all if None."""
    both = np.concatenate(
        [np.sqrt(level + 1)[..., None], differences + _LEAST_DIFFERENCE, coarse + _LEAST_SQUARE],
        axis=-1,
    )
    around = cv2.blur(both, (3, 3), borderType=cv2.BORDER_REFLECT_101)
    if view is not None:
        weight = view.astype(np.float64)
        near = cv2.blur(weight, (3, 3), borderType=cv2.BORDER_REFLECT_101)[..., None]
        some = cv2.blur(both * weight[..., None], (3, 3), borderType=cv2.BORDER_REFLECT_101)
        around = np.where(near > 0, some / np.maximum(near, 1e-9), both)
    around = np.log2(around)
    root, fine, squares = around[..., :1], around[..., 1:9], around[..., 9:]
    found = []
    for first in (0, len(_LAGS)):
        of = fine[..., first : first + len(_LAGS)]
        found += [root - of[..., :1], of[..., :-1] - of[..., 1:]]
    return np.concatenate([*found, squares[..., :1] - squares[..., 1:]], axis=-1)
