"""Deep pictures and their levels by the compiled extension; `numpy_pictures` says what they are."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native, numpy_pictures
from .checks import check_deep, check_frame, check_gray
from .compiled_scratch import SCRATCH
from .grid import Grid
from .levels import DEPTH, FRAME, LEAST_AROUND, RATIO, RATIO_OF, Levels
from .numpy_pictures import check_deep_size, deep_step, overlaps
from .threads import over_rows

_LARGEST_SUM = (1 << 31) - 1


@lru_cache(maxsize=16)
def _deep_tables(source: int, target: int) -> Any:
    first, weight = overlaps(source, target)
    counts = np.count_nonzero(weight, axis=0)
    return _native.DeepTables(
        np.concatenate([[0], counts.cumsum()]).astype(np.int32),
        first.astype(np.int32),
        weight.T[weight.T > 0].astype(np.int32),
    )


def deep_gray(
    frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
) -> NDArray[np.uint16]:
    """A frame resized by area and gray, in 1/256 grey level, in one pass over it.

    Takes and gives what `tokt.features.numpy_pictures.deep_gray` does, to the last bit.

    Raises
    ------
    TypeError, ValueError
        If the frame is not (rows, columns) or (rows, columns, 3) of uint8, or a size not positive.
    """
    frame = check_frame(frame, threads)
    check_deep_size(frame.shape, height, width)
    if 255 * frame.shape[0] * frame.shape[1] > _LARGEST_SUM:
        return numpy_pictures.deep_gray(frame, height, width)
    rows, columns = _deep_tables(frame.shape[0], height), _deep_tables(frame.shape[1], width)
    step = deep_step(frame.shape)
    pixels = frame.reshape(*frame.shape[:2], -1)
    deep = np.empty((height, width), np.uint16)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("deep", _native.deep_scratch_size(pixels, width), np.int32)
        _native.deep_gray(pixels, rows, columns, first, last, step, scratch, deep)

    over_rows(work, height, threads)
    return deep


@lru_cache(maxsize=16)
def _levels_kernel(levels: Levels) -> Any:
    return _native.LevelsKernel(
        levels.smooth,
        levels.window,
        levels.by == RATIO,
        RATIO_OF * DEPTH,
        LEAST_AROUND * DEPTH,
        levels.offset,
        levels.levels - 1,
    )


def to_levels(deep: NDArray[np.uint16], levels: Levels, threads: int = 1) -> NDArray[np.uint8]:
    """A deep picture as levels.

    Takes and gives what `tokt.features.numpy_pictures.to_levels` does, to the last bit.

    Raises
    ------
    TypeError, ValueError
        If `deep` is not a two-dimensional array of uint16.
    """
    deep = check_deep(deep, threads)
    kernel = _levels_kernel(levels)
    size = kernel.scratch_size(deep.shape[1])
    scale = levels.scale(_native.deep_total(deep) if levels.by == FRAME else 0, deep.size)
    picture = np.empty(deep.shape, np.uint8)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("levels", size, np.float64)
        kernel.rows(deep, scale, first, last, scratch, picture)

    over_rows(work, len(deep), threads)
    return picture


def level_counts(gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.int64]:
    """How many pixels of each patch have each of 256 levels, int64, shape (n_patches, 256).

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8.
    """
    gray = check_gray(gray, threads)
    patch_height, patch_width = grid.patch_size(*gray.shape)
    counts = np.empty((grid.n_patches, 256), np.int64)

    def work(first: int, last: int) -> None:
        _native.level_counts(gray, grid.cols, patch_height, patch_width, first, last, counts)

    over_rows(work, grid.rows, threads)
    return counts
