"""Edges and lines of patches by the compiled extension; `numpy_textures` says what they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid

from . import _native
from .checks import check_gray, check_lbp, check_samples
from .compiled_scratch import SCRATCH
from .lbp_points import nearest_points
from .threads import over_rows


def lbp_nearest_counts(
    gray: NDArray[np.uint8],
    grid: Grid,
    points: int,
    radius: float,
    border: str,
    threads: int = 1,
) -> NDArray[np.int64]:
    """Histograms of local binary patterns whose points are moved to the nearest whole pixel.

    Takes and gives what `tokt.features.kernels.numpy_textures.lbp_nearest_counts` does.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8, or an option is out of range.
    """
    gray = check_gray(gray, threads)
    check_lbp(points, radius, border)
    size = grid.patch_size(*gray.shape)
    moves = nearest_points(points, radius)
    reach, across = int(np.abs(moves).max()), border == "frame"
    counts = np.empty((grid.n_patches, points + 2), np.int64)

    def work(first: int, last: int) -> None:
        needed = _native.nearest_scratch_size(gray, *size, moves, reach, across)
        scratch = SCRATCH.array("nearest", needed, np.uint8)
        _native.nearest_counts(
            gray, grid.cols, *size, moves, reach, across, first, last, scratch, counts
        )

    over_rows(work, grid.rows, threads)
    return counts


def structure_sums(gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.int64]:
    """Sums of the structure tensor over each patch: changes across, down, and both together.

    Takes and gives what `tokt.features.kernels.numpy_textures.structure_sums` does.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8.
    """
    gray = check_gray(gray, threads)
    size = grid.patch_size(*gray.shape)
    sums = np.empty((grid.n_patches, 3), np.int64)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("structure", _native.structure_scratch_size(gray), np.int32)
        _native.structure_sums(gray, grid.cols, *size, first, last, scratch, sums)

    over_rows(work, grid.rows, threads)
    return sums


def line_sums(
    gray: NDArray[np.uint8],
    grid: Grid,
    middle: int,
    samples: Sequence[int],
    threads: int = 1,
) -> NDArray[np.int64]:
    """Sums along lines in 8 directions, over each patch's pixels.

    Takes and gives what `tokt.features.kernels.numpy_textures.line_sums` does.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8, or the samples or `middle` are others.
    """
    gray = check_gray(gray, threads)
    check_samples(samples, middle)
    size = grid.patch_size(*gray.shape)
    numbers = np.array(samples, np.int32)
    sums = np.empty((grid.n_patches, len(numbers), 9), np.int64)

    def work(first: int, last: int) -> None:
        needed = _native.lines_scratch_size(gray, size[0], numbers)
        scratch = SCRATCH.array("lines", needed, np.int16)
        _native.line_sums(gray, grid.cols, *size, middle, numbers, first, last, scratch, sums)

    over_rows(work, grid.rows, threads)
    return sums
