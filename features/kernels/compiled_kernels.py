"""The kernels as a compiled extension: tables, scratch memory and threads.

The arithmetic is in ``features/kernels/native``. Tables that depend only on sizes are made once and
kept; scratch memory belongs to a thread. What is taken and given stands with `dispatch.Kernels`.
"""

import platform
import threading
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import astuple
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I16, I64, U8, U16, U32, U64
from tokt.features.frames.grid import Grid

from . import _native, numpy_pictures
from .block_matching import PADDING, BlockMatching, padded
from .checks import over_rows
from .lbp_points import lbp_points, nearest_points, pattern_codes
from .numpy_pictures import (
    SUMS_AS_X86,
    area_weights,
    is_area_sum,
    overlaps,
    picture_total,
    sign_tiles,
)
from .quantization import MIN_AROUND, RATIO, RATIO_OF, STEPS_PER_LEVEL, Quantization

_INTERFACE = 10
if getattr(_native, "INTERFACE", None) != _INTERFACE:
    raise ImportError("the extension was built from other sources; install tokt again")

DETAIL = f"{_native.INSTRUCTIONS[-1]} instructions"

_LOG2_TABLE = 1 << 16  # counts; larger ones are rare, and their logarithm is taken when needed
_MAX_POINTS_IN_TABLE = 12  # 4 kB of pattern codes; a larger table pushes out what it indexes
_INVERSE_DIFFERENCE = 1.0 / (1.0 + np.arange(256.0) ** 2)
_MAX_REDUCTION = 64.0  # beyond it so many values are near ties that OpenCV is as fast
_MAX_SIDE = 1000  # pixels: of such pictures a share can be under a thousandth of a pixel
# The bits that OpenCV gives on x86, where models are trained; ARM has no others.
_KNOWN_ORDER = SUMS_AS_X86 or platform.machine().lower() in ("aarch64", "arm64")


class _Scratch(threading.local):
    """One thread's memory for intermediate results."""

    def __init__(self) -> None:
        self.of: dict[str, Any] = defaultdict(_native.Scratch)

    @cached_property
    def glcm(self) -> Any:
        """Counters of pairs."""
        return _native.GlcmScratch()


SCRATCH = _Scratch()


def _do_rows(use: str, kernel: Any, rows: int, threads: int, *arguments: Any) -> None:
    """Have a kernel do all rows, in equal parts, one a thread with scratch memory of its own."""
    over_rows(lambda first, last: kernel(*arguments, first, last, SCRATCH.of[use]), rows, threads)


def _by_patch(
    use: str, kernel: Any, picture: NDArray[Any], grid: Grid, threads: int, n: Any, *options: Any
) -> I64:
    """The whole numbers that a kernel has for each patch, `n` of them: a number, or a shape."""
    size = grid.patch_size(*picture.shape)  # first: it refuses what would not fit into memory
    found = np.zeros((grid.n_patches, *np.atleast_1d(n)), np.int64)
    _do_rows(use, kernel, grid.rows, threads, picture, grid.cols, *size, *options, found)
    return found


@lru_cache(maxsize=16)
def _lbp_tables(points: int, radius: float, height: int, width: int) -> Any:
    codes = pattern_codes(points) if points <= _MAX_POINTS_IN_TABLE else None
    return _native.LbpTables(*lbp_points(points, radius, height, width), codes)


def lbp_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_counts`, to the last integer."""
    size, whole = grid.patch_size(*gray.shape), border == "frame"
    count = _lbp_tables(points, radius, *(gray.shape if whole else size)).count_rows
    return _by_patch("lbp", count, gray, grid, threads, points + 2, whole)


@lru_cache(maxsize=4)
def _log2_table(size: int) -> F64:
    table = np.zeros(size)
    table[1:] = np.log2(np.arange(1, size))
    return table


def haralick_features(gray: U8, grid: Grid, ignore_zeros: bool, threads: int = 1) -> F64:
    """`Kernels.haralick_features`, up to rounding."""
    size = grid.patch_size(*gray.shape)
    log2_of = _log2_table(min(2 * size[0] * size[1] + 1, _LOG2_TABLE))
    features = np.empty((grid.n_patches, 13))

    def work(first: int, last: int) -> None:
        tables = log2_of, _INVERSE_DIFFERENCE
        SCRATCH.glcm.describe_rows(
            gray, grid.cols, *size, ignore_zeros, first, last, *tables, features
        )

    over_rows(work, grid.rows, threads)
    return features


_MAX_SUM = (1 << 32) - 1  # of 32 bits


def _sums_fit(frame: U8) -> bool:
    return bool(255 * frame.shape[0] * frame.shape[1] <= _MAX_SUM)


def _is_own_area(frame: U8, height: int, width: int) -> bool:
    """Tell whether whole sums over areas are those of OpenCV up to rounding.

    OpenCV leaves out shares of a pixel that only pictures of `_MAX_SIDE` and more have.
    """
    down = max(frame.shape[0] / height, frame.shape[1] / width)
    small = down <= _MAX_REDUCTION and max(height, width) < _MAX_SIDE and _sums_fit(frame)
    return _KNOWN_ORDER and small and is_area_sum(frame.shape, height, width)


@lru_cache(maxsize=16)
def _exact_table(source: int, target: int) -> tuple[Any, ...]:
    """First pixel, number of whole ones, weights of the first and the last, and of a whole one."""
    pixels, weights = overlaps(source, target)
    counts = np.count_nonzero(weights, axis=0)
    last = np.where(counts > 1, weights[counts - 1, np.arange(target)], 0)
    columns = pixels, np.maximum(counts - 2, 0), weights[0], last
    return *(column.astype(np.int32) for column in columns), target


@lru_cache(maxsize=16)
def _pictures_maker(shape: tuple[int, int], height: int, width: int) -> Any:
    sides = (shape[0], height), (shape[1], width)
    # How far OpenCV's sums can be from ours, in grey levels, and more: a sum of n terms up to 255
    # in single precision is off by at most (n + 1) * 255 * 2**-24, its weights' rounding adds as
    # much as a term, and there are two sums after each other. A scale s has at most ceil(s) + 1
    # terms. Ours leave out one unit.
    unit = 1.0 / (shape[0] * shape[1])
    terms = np.ceil(shape[0] / height) + np.ceil(shape[1] / width) + 2
    return _native.GrayPictures(
        *(table(*side) for table in (_exact_table, area_weights) for side in sides),
        width,
        unit,
        2 * (terms + 2) * 255 * 2.0**-24 + unit,
    )


def _made(frame: U8, gray16: U16 | None, gray: U8 | None, threads: int) -> None:
    """Fill the 16-bit gray picture and the plain one, or one of them, in one pass."""
    height, width = (gray16 if gray is None else gray).shape  # type: ignore[union-attr]
    maker = _pictures_maker(frame.shape[:2], height, width)
    pixels = frame.reshape(*frame.shape[:2], -1)
    _do_rows("area", maker.make_rows, height, threads, pixels, gray16, gray)


def resized_gray(frame: U8, height: int, width: int, threads: int = 1) -> U8:
    """`Kernels.resized_gray` in one pass over the frame, to the last bit."""
    if not _is_own_area(frame, height, width):
        return numpy_pictures.resized_gray(frame, height, width)
    gray = np.empty((height, width), np.uint8)
    _made(frame, None, gray, threads)
    return gray


def resized_gray16(frame: U8, height: int, width: int, threads: int = 1) -> U16:
    """`Kernels.resized_gray16` in one pass over the frame, to the last bit."""
    if not _sums_fit(frame):
        return numpy_pictures.resized_gray16(frame, height, width)
    gray16 = np.empty((height, width), np.uint16)
    _made(frame, gray16, None, threads)
    return gray16


def resized_grays(frame: U8, height: int, width: int, threads: int = 1) -> tuple[U16, U8]:
    """`Kernels.resized_grays` in one pass over the frame."""
    if not _is_own_area(frame, height, width):
        plain = numpy_pictures.resized_gray(frame, height, width)
        return resized_gray16(frame, height, width, threads), plain
    gray16, gray = np.empty((height, width), np.uint16), np.empty((height, width), np.uint8)
    _made(frame, gray16, gray, threads)
    return gray16, gray


@lru_cache(maxsize=16)
def _taps(source: int, target: int) -> tuple[NDArray[np.int32], F32]:
    """From which of `source` pixels on three make up each of `target`, and their weights.

    Those of `area_weights`, for at most a reduction to half; zeros beside them.
    """
    first, begin, weights = area_weights(source, target)
    start, taps = np.minimum(begin, source - 3), np.zeros((target, 3), np.float32)
    of = np.repeat(np.arange(target), np.diff(first))
    taps[of, np.arange(len(weights)) + (begin - start - first[:-1])[of]] = weights
    return start, taps


def area_means(picture: NDArray[Any], height: int, width: int, threads: int = 1) -> F32:
    """`Kernels.area_means`, to the last bit."""
    means, (tall, wide) = np.empty((height, width), np.float32), picture.shape[:2]
    if picture.dtype == np.uint8 and (tall, wide) == (2 * height, 2 * width):
        pixels = picture.reshape(tall, wide, -1)
        _do_rows("halved", _native.halved_gray, height, threads, pixels, means)
        return means
    small = min(tall, wide) >= 3 and max(tall / height, wide / width) <= 2
    own = _KNOWN_ORDER and small and is_area_sum(picture.shape, height, width)
    if picture.dtype == np.uint8 or not own:
        return numpy_pictures.area_means(picture, height, width)
    taps = *_taps(tall, height), *_taps(wide, width)
    _do_rows("means", _native.area_means, height, threads, picture, *taps, means)
    return means


def local_contrast(view: F32, window: int, gain: float, least: float) -> tuple[F32, U8]:
    """`Kernels.local_contrast`, to the last bit."""
    if not 1 < window < min(view.shape):
        return numpy_pictures.local_contrast(view, window, gain, least)
    sigma, even = np.empty(view.shape, np.float32), np.empty(view.shape, np.uint8)
    _native.local_contrast(view, window, gain, least, sigma, even, SCRATCH.of["contrast"])
    return sigma, even


def lbp_nearest_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_nearest_counts`."""
    moves = nearest_points(points, radius)
    options = moves, int(np.abs(moves).max()), border == "frame"
    kernel = _native.nearest_counts
    return _by_patch("nearest", kernel, gray, grid, threads, points + 2, *options)


def structure_sums(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.structure_sums`."""
    return _by_patch("structure", _native.structure_sums, gray, grid, threads, 3)


def gradient_sums(gray16: U16, grid: Grid, box: int, threads: int = 1) -> I64:
    """`Kernels.gradient_sums`."""
    return _by_patch("gradient", _native.gradient_sums, gray16, grid, threads, 3, box)


def difference_sums(frame: U8, rows: I64, cols: int, lags: Sequence[int]) -> I64:
    """`Kernels.difference_sums`."""
    sums = np.empty((len(rows), cols, 2 + 2 * len(lags)), np.int64)
    pixels = frame.reshape(*frame.shape[:2], -1)
    _native.difference_sums(pixels, rows, cols, np.array(lags, np.int32), sums)
    return sums


def curvature_sums(gray16: U16, grid: Grid, lags: Sequence[int], threads: int = 1) -> I64:
    """`Kernels.curvature_sums`."""
    numbers = np.array(lags, np.int32)
    kernel = _native.curvature_sums
    return _by_patch("curvature", kernel, gray16, grid, threads, len(lags), numbers)


def box_sums(frame: U8, rows: I64, columns: I64, threads: int = 1) -> I64:
    """`Kernels.box_sums` in one pass over the rows of each range."""
    pixels = frame.reshape(*frame.shape[:2], -1)
    sums = np.empty((len(rows), len(columns), pixels.shape[2]), np.int64)
    _do_rows("boxes", _native.box_sums, len(rows), threads, pixels, rows, columns, sums)
    return sums


def line_sums(gray: U8, grid: Grid, middle: int, samples: Sequence[int], threads: int = 1) -> I64:
    """`Kernels.line_sums`."""
    numbers = np.array(samples, np.int32)
    shape = len(numbers), 9
    return _by_patch("lines", _native.line_sums, gray, grid, threads, shape, middle, numbers)


@lru_cache(maxsize=16)
def _quantizer(quantization: Quantization) -> Any:
    return _native.Quantizer(
        quantization.smooth,
        quantization.window,
        quantization.by == RATIO,
        RATIO_OF * STEPS_PER_LEVEL,
        MIN_AROUND * STEPS_PER_LEVEL,
        quantization.offset,
        quantization.levels - 1,
    )


def summed_area(gray16: U16) -> U32:
    """`Kernels.summed_area`."""
    sums = np.empty((gray16.shape[0] + 1, gray16.shape[1] + 1), np.uint32)
    _native.summed_area_table(gray16, sums)
    return sums


def quantize(gray16: U16, sums: U32, quantization: Quantization, threads: int = 1) -> U8:
    """`Kernels.quantize`, to the last bit."""
    kernel = _quantizer(quantization)
    scale = quantization.scale(picture_total(sums), gray16.size)
    picture = np.empty(gray16.shape, np.uint8)
    _do_rows("quantize", kernel.rows, len(gray16), threads, sums, scale, picture)
    return picture


def level_counts(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.level_counts`."""
    patch_height, patch_width = grid.patch_size(*gray.shape)
    counts = np.empty((grid.n_patches, 256), np.int64)

    def work(first: int, last: int) -> None:
        _native.level_counts(gray, grid.cols, patch_height, patch_width, first, last, counts)

    over_rows(work, grid.rows, threads)
    return counts


def row_marks(gray: U8, weights: U64, lag: int, largest: int) -> tuple[U64, U64]:
    """`Kernels.row_marks`."""
    hashes = np.empty((len(gray), len(weights)), np.uint64)
    signs = np.empty((2, len(gray), sign_tiles(gray, lag)), np.uint64)
    _native.row_marks(gray, weights, lag, largest, hashes, signs)
    return hashes, signs


def sign_counts(signs: U64, others: U64) -> I64:
    """`Kernels.sign_counts`."""
    counts = np.empty((len(others), 2), np.int64)
    _native.sign_counts(signs, others, counts)
    return counts


def block_disparity(left: U8, right: U8, settings: BlockMatching, wanted: U8) -> I16:
    """`Kernels.block_disparity`: fewer and closer wanted pixels cost less."""
    disparity = np.full(left.shape, settings.unmatched, np.int16)
    if min(left.shape) <= settings.block:
        return disparity
    half, margin = settings.block // 2, settings.margin
    # Where the block lies inside both padded views at every disparity.
    inside = np.zeros_like(wanted)
    inside[half:-half, half - 1 : -half] = wanted[half:-half, half - 1 : -half] != 0
    column, row, width, height = cv2.boundingRect(inside)
    if not width:
        return disparity
    left, right = (
        _gradients(padded(view, settings, PADDING), settings.cap) for view in (left, right)
    )
    area = (row, row + height, column + margin, column + margin + width)
    kernel = _native.MatchKernel(*astuple(settings))
    wide = np.full(left.shape, settings.unmatched, np.int16)
    inside = padded(inside, settings, 0)
    kernel.disparities(left, right, inside, *area, SCRATCH.of["match"], wide)
    return wide[:, margin:]


def _gradients(view: U8, cap: int) -> U8:
    """OpenCV's XSOBEL filter: gradients across, clipped at `cap`, which itself means none."""
    # In bytes: what is below -cap becomes 0.
    raised = cv2.Sobel(view, cv2.CV_8U, 1, 0, delta=cap)
    clipped = np.asarray(cv2.threshold(raised, 2 * cap, 0, cv2.THRESH_TRUNC)[1], np.uint8)
    clipped[:, [0, -1]] = cap
    if len(clipped) % 2:  # it works on pairs of rows, and leaves a last single one without any
        clipped[-1] = cap
    return clipped
