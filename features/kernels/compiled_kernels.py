"""The kernels as a compiled extension: checked arrays, tables, scratch memory and threads.

The arithmetic is in ``features/kernels/native``. Tables that depend only on sizes are made once and
kept; scratch memory belongs to a thread.
"""

from __future__ import annotations

import platform
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid

from . import _native, area
from .checks import check_frame, check_gray, check_lbp, check_size
from .compiled_matching import block_disparity as block_disparity
from .compiled_pictures import level_counts as level_counts
from .compiled_pictures import quantize as quantize
from .compiled_pictures import resized_gray16 as resized_gray16
from .compiled_scratch import SCRATCH
from .compiled_textures import lbp_nearest_counts as lbp_nearest_counts
from .compiled_textures import line_sums as line_sums
from .compiled_textures import structure_sums as structure_sums
from .lbp_points import LbpPoints, lbp_points, pattern_codes
from .threads import over_rows

_INTERFACE = 4
if getattr(_native, "INTERFACE", None) != _INTERFACE:
    raise ImportError("the extension was built from other sources; install tokt again")

DETAIL = f"{_native.INSTRUCTIONS[-1]} instructions"

_LOG2_TABLE = 1 << 16  # counts; larger ones are rare, and their logarithm is taken when needed
_MAX_POINTS_IN_TABLE = 12  # 4 kB of pattern codes; a larger table pushes out what it indexes
_INVERSE_DIFFERENCE = 1.0 / (1.0 + np.arange(256.0) ** 2)
_MAX_REDUCTION = 64.0  # beyond it so many values are near ties that OpenCV is as fast
# OpenCV's sums are known to be formed this way on x86; elsewhere its own resize is called.
_OWN_RESIZE = platform.machine().lower() in ("x86_64", "amd64")


@lru_cache(maxsize=16)
def _lbp_tables(points: int, radius: float, height: int, width: int) -> Any:
    made: LbpPoints = lbp_points(points, radius, height, width)
    return _native.LbpTables(
        made.reach,
        made.first,
        made.point,
        made.row_floor,
        made.row_fraction,
        made.column_floor,
        made.column_fraction,
        pattern_codes(points) if points <= _MAX_POINTS_IN_TABLE else None,
    )


def lbp_counts(
    gray: NDArray[np.uint8],
    grid: Grid,
    points: int,
    radius: float,
    border: str,
    threads: int = 1,
) -> NDArray[np.int64]:
    """Histograms of uniform rotation-invariant local binary patterns, one a patch.

    Takes and gives what `tokt.features.kernels.reference.lbp_counts` does, to the last integer.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8, or an option is out of range.
    """
    gray = check_gray(gray, threads)
    check_lbp(points, radius, border)
    patch_height, patch_width = grid.patch_size(*gray.shape)
    view = gray.shape if border == "frame" else (patch_height, patch_width)
    tables = _lbp_tables(points, radius, *view)
    size = tables.scratch_size(patch_height, patch_width)
    counts = np.zeros((grid.n_patches, points + 2), np.int64)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("lbp", size, np.float64)
        whole = border == "frame"
        tables.count_rows(
            gray, grid.cols, patch_height, patch_width, whole, first, last, scratch, counts
        )

    over_rows(work, grid.rows, threads)
    return counts


@lru_cache(maxsize=4)
def _log2_table(size: int) -> NDArray[np.float64]:
    table = np.zeros(size)
    table[1:] = np.log2(np.arange(1, size))
    return table


def haralick_features(
    gray: NDArray[np.uint8], grid: Grid, ignore_zeros: bool, threads: int = 1
) -> NDArray[np.float64]:
    """Haralick's first 13 texture features, mean over the 4 directions, one row a patch.

    Takes and gives what `tokt.features.kernels.reference.haralick_features` does, up to rounding.

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8.
    """
    gray = check_gray(gray, threads)
    patch_height, patch_width = grid.patch_size(*gray.shape)
    log2_of = _log2_table(min(2 * patch_height * patch_width + 1, _LOG2_TABLE))
    features = np.empty((grid.n_patches, 13))

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.glcm_scratch(patch_width)
        scratch.describe_rows(
            gray,
            grid.cols,
            patch_height,
            patch_width,
            ignore_zeros,
            first,
            last,
            log2_of,
            _INVERSE_DIFFERENCE,
            features,
        )

    over_rows(work, grid.rows, threads)
    return features


@lru_cache(maxsize=16)
def _area_tables(source: int, target: int) -> Any:
    """Which of `source` pixels make up each of `target`, and with what weight.

    Rounded as OpenCV rounds: positions in double precision, weights in single, and a share under
    a thousandth of a pixel is left out.
    """
    scale = 1.0 / (target / source)
    first, sources, weights = [0], [], []
    for index in range(target):
        start, end = index * scale, index * scale + scale
        whole = min(scale, source - start)
        last = min(int(np.floor(end)), source - 1)
        begin = min(int(np.ceil(start)), last)
        before = [(begin - start) / whole] if begin - start > 1e-3 else []
        after = [min(end - last, 1.0, whole) / whole] if end - last > 1e-3 else []
        sources.append(begin - len(before))
        weights += before + [1.0 / whole] * (last - begin) + after
        first.append(len(weights))
    return _native.AreaTables(
        np.array(first, np.int32), np.array(sources, np.int32), np.array(weights, np.float32)
    )


def _is_own_area(shape: tuple[int, ...], height: int, width: int) -> bool:
    """Whether this is a reduction by area that OpenCV has no shorter way for."""
    down = shape[0] / height, shape[1] / width
    whole = all(scale.is_integer() for scale in down)
    return _OWN_RESIZE and min(down) >= 1 and max(down) <= _MAX_REDUCTION and not whole


def _near_tie(shape: tuple[int, ...], height: int, width: int) -> float:
    """How far two orders of summing can be apart, in grey levels.

    A sum of n terms up to 255 in single precision is off by at most (n + 1) * 255 * 2**-24. There
    are two sums after each other, and two orders of them; a scale s has at most ceil(s) + 1 terms.
    """
    terms = np.ceil(shape[0] / height) + np.ceil(shape[1] / width) + 2
    return float(2 * (terms + 2) * 255 * 2.0**-24)


def resized_gray(
    frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
) -> NDArray[np.uint8]:
    """A frame resized by area, then gray, in one pass over it.

    Takes and gives what `tokt.features.kernels.area.resized_gray` does, to the last bit.

    Raises
    ------
    TypeError, ValueError
        If the frame is not (rows, columns) or (rows, columns, 3) of uint8.
    """
    frame = check_frame(frame, threads)
    check_size(height, width)
    if not _is_own_area(frame.shape, height, width):
        return area.resized_gray(frame, height, width)
    rows, columns = _area_tables(frame.shape[0], height), _area_tables(frame.shape[1], width)
    near_tie = _near_tie(frame.shape, height, width)
    pixels = frame.reshape(*frame.shape[:2], -1)
    picture = np.empty((height, width), np.uint8)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("area", _native.area_scratch_size(pixels, width), np.float32)
        _native.area_gray(pixels, rows, columns, first, last, near_tie, scratch, picture)

    over_rows(work, height, threads)
    return picture
