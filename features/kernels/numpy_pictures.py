"""Gray pictures and their quantization in numpy and OpenCV, exact up to the last steps."""

import platform
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64, U8, U16, U32, U64
from tokt.features.frames.grid import Grid

from .quantization import (
    BGR_WEIGHTS,
    MIN_AROUND,
    RATIO,
    RATIO_OF,
    STEPS_PER_LEVEL,
    WHOLE_WEIGHT,
    Quantization,
    gray16_step,
)


@lru_cache(maxsize=16)
def overlaps(source: int, target: int) -> tuple[I64, I64]:
    """Which of `source` pixels a pixel of `target` lies over, and how much of each it covers.

    With each source pixel `target` units long and each target pixel `source` units, both lengths
    are the same whole number, and so is every overlap. Gives the first source pixel, and the units
    of that and the following ones, shape (most, target): a column sums to `source`, 0 beyond the
    last.
    """
    start = np.arange(target, dtype=np.int64) * source
    first = start // target
    most = int(((start + source - 1) // target - first).max()) + 1
    begin = (first + np.arange(most)[:, None]) * target
    covered = np.minimum(begin + target, start + source) - np.maximum(begin, start)
    return first, np.maximum(covered, 0)


def _shrunk(rows: F64, target: int) -> F64:
    """Sums of the rows that each of `target` rows lies over, times the overlap."""
    first, weight = overlaps(len(rows), target)
    sums = np.zeros((target, rows.shape[1]))
    for step, part in enumerate(weight):
        sums += part[:, None] * rows[np.minimum(first + step, len(rows) - 1)]
    return sums


def resized_gray16(frame: U8, height: int, width: int, threads: int = 1) -> U16:
    """`Kernels.resized_gray16`."""
    # Up to 2**22, so single precision is exact.
    if frame.ndim == 3:
        gray = frame.astype(np.float32) @ np.array(BGR_WEIGHTS, np.float32)
    else:
        gray = frame * np.float32(WHOLE_WEIGHT)
    sums = _shrunk(_shrunk(gray.astype(np.float64), height).T, width).T
    return np.ascontiguousarray(np.floor(sums * gray16_step(frame.shape) + 0.5), np.uint16)


def summed_area(gray16: U16) -> U32:
    """`Kernels.summed_area`."""
    up_to = gray16.cumsum(axis=0, dtype=np.uint32).cumsum(axis=1, dtype=np.uint32)
    return np.pad(up_to, ((1, 0), (1, 0)))


def picture_total(sums: U32) -> int:
    """The sum of all pixels, which the last of the sums may have run over: rows never do."""
    return int((sums[1:, -1] - sums[:-1, -1]).sum(dtype=np.int64))


def _box_mean(sums: U32, side: int) -> F64:
    """Mean of the pixels of a box that lie in the picture, by the picture's summed area."""
    ends = [np.arange(length - 1)[:, None] + (-(side // 2), side // 2 + 1) for length in sums.shape]
    (top, bottom), (left, right) = (
        end.clip(0, length - 1).T for end, length in zip(ends, sums.shape, strict=True)
    )
    strips = sums[bottom] - sums[top]
    whole = strips[:, right] - strips[:, left]
    return np.asarray(whole * (1.0 / (right - left)) * (1.0 / (bottom - top))[:, None])


def quantize(gray16: U16, sums: U32, quantization: Quantization, threads: int = 1) -> U8:
    """`Kernels.quantize`."""
    value = _box_mean(sums, quantization.smooth)
    if quantization.window:
        around = _box_mean(sums, quantization.window)
        value -= around
        if quantization.by == RATIO:
            value *= RATIO_OF * STEPS_PER_LEVEL
            value /= np.maximum(around, MIN_AROUND * STEPS_PER_LEVEL)
    value *= quantization.scale(picture_total(sums), gray16.size)
    value += quantization.offset
    return np.floor(value).clip(0, quantization.levels - 1).astype(np.uint8)


def level_counts(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.level_counts`."""
    return histograms(grid.cells(gray).reshape(grid.n_patches, -1), 256)


def histograms(codes: U8, bins: int) -> I64:
    """One histogram a row of codes."""
    flat = codes + (bins * np.arange(len(codes)))[:, None]
    return np.bincount(flat.ravel(), minlength=len(codes) * bins).reshape(-1, bins)


@lru_cache(maxsize=16)
def area_weights(
    source: int, target: int
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32]]:
    """Which of `source` pixels make up each of `target`, and with what weight.

    Rounded as OpenCV rounds: positions in double precision, weights in single, and a share under
    a thousandth of a pixel is left out. Gives where a target's weights begin, shape (target + 1,),
    its first source pixel, shape (target,), and all weights.
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
    return np.array(first, np.int32), np.array(sources, np.int32), np.array(weights, np.float32)


def is_area_sum(shape: tuple[int, ...], height: int, width: int) -> bool:
    """Whether this is a reduction by area that OpenCV has no shorter way for."""
    down = shape[0] / height, shape[1] / width
    return min(down) >= 1 and not all(scale.is_integer() for scale in down)


def summed_as_x86(frame: NDArray[Any], height: int, width: int) -> F32:
    """A reduction by area in the order of OpenCV on x86: along rows, then down, single precision.

    OpenCV's own on other processors adds up in other orders, and some pixels differ.
    """
    sums = frame.astype(np.float32)
    for axis, length in ((1, width), (0, height)):
        first, sources, weights = area_weights(frame.shape[axis], length)
        counts, taken = np.diff(first), np.moveaxis(sums, axis, 0)
        added = np.zeros((length, *taken.shape[1:]), np.float32)
        for step in range(counts.max()):
            has = np.flatnonzero(counts > step)
            weight = weights[first[has] + step].reshape(-1, *[1] * (taken.ndim - 1))
            added[has] += weight * taken[sources[has] + step]
        sums = np.moveaxis(added, 0, axis)
    return sums


SUMS_AS_X86 = platform.machine().lower() in ("x86_64", "amd64")
"""Whether this machine's OpenCV adds up as on x86."""


def resized_gray(frame: U8, height: int, width: int, threads: int = 1) -> U8:
    """`Kernels.resized_gray`; OpenCV has threads of its own."""
    if (height, width) != frame.shape[:2]:
        if SUMS_AS_X86 or not is_area_sum(frame.shape, height, width):
            frame = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA))
        else:
            frame = np.rint(summed_as_x86(frame, height, width)).astype(np.uint8)
    if frame.ndim == 3:
        frame = np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))
    return frame.astype(np.uint8, copy=False)


def area_means(picture: NDArray[Any], height: int, width: int, threads: int = 1) -> F32:
    """`Kernels.area_means`."""
    if picture.ndim == 3:
        picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    if not SUMS_AS_X86 and is_area_sum(picture.shape, height, width):
        return summed_as_x86(picture, height, width)
    levels = picture.astype(np.float32, copy=False)
    means = cv2.resize(levels, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(means, np.float32)


_MIDDLE = 128.0


def local_contrast(view: F32, window: int, gain: float, least: float) -> tuple[F32, U8]:
    """`Kernels.local_contrast`."""
    around = (window, window)
    mean = cv2.boxFilter(view, cv2.CV_32F, around)
    variance = cv2.sqrBoxFilter(view, cv2.CV_32F, around)
    cv2.subtract(variance, cv2.multiply(mean, mean), dst=variance)
    cv2.threshold(variance, 0, 0, cv2.THRESH_TOZERO, dst=variance)
    sigma = cv2.sqrt(variance, dst=variance)
    even = cv2.subtract(view, mean)
    cv2.divide(even, np.maximum(sigma, np.float32(least)), dst=even, scale=gain)
    raised = cv2.addWeighted(even, 1.0, even, 0.0, _MIDDLE, dtype=cv2.CV_8U)
    return np.asarray(sigma, np.float32), np.asarray(raised, np.uint8)


def box_sums(frame: U8, rows: I64, columns: I64, threads: int = 1) -> I64:
    """`Kernels.box_sums`, in double precision, which whole sums of pixels fit."""
    channels = 1 if frame.ndim == 2 else frame.shape[2]
    up_to = np.zeros((len(rows), frame.shape[1] + 1, channels))
    for row, (first, last) in zip(up_to, rows.tolist(), strict=True):
        sums = cv2.reduce(frame[first:last], 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F)
        np.cumsum(sums.reshape(-1, channels), axis=0, out=row[1:])
    return (up_to[:, columns[:, 1]] - up_to[:, columns[:, 0]]).astype(np.int64)


BRIGHT_LEVEL = 250
"""Grey level that counts as bright."""
MOST_CURVED = 16 * 256
"""Of a second difference as much counts at most, in 1/256 grey level."""


def difference_sums(frame: U8, rows: I64, cols: int, lags: Sequence[int]) -> I64:
    """`Kernels.difference_sums`."""
    pixels = frame.reshape(*frame.shape[:2], -1)
    here, wide = pixels[rows], pixels.shape[1] // cols * cols
    values = [here, (here >= BRIGHT_LEVEL).astype(np.uint8)]
    for lag in lags:
        across = np.zeros_like(here)
        if lag < here.shape[1]:
            across[:, :-lag] = cv2.absdiff(here[:, lag:], here[:, :-lag]).reshape(
                len(rows), -1, here.shape[2]
            )
        values.append(across)
    below = (np.asarray(cv2.absdiff(pixels[rows + lag], here), np.uint8) for lag in lags)
    values += [values_below.reshape(here.shape) for values_below in below]
    patches = np.stack(values)[:, :, :wide].reshape(len(values), len(rows), cols, -1)
    return np.moveaxis(patches.sum(axis=3, dtype=np.int64), 0, -1)


def curvature_sums(gray16: U16, grid: Grid, lags: Sequence[int], threads: int = 1) -> I64:
    """`Kernels.curvature_sums`."""
    levels = gray16.astype(np.int32)
    found = []
    for lag in lags:
        squares = np.zeros(gray16.shape, np.int64)
        for values, out in ((levels, squares), (levels.T, squares.T)):
            if 2 * lag < len(values):
                bend = values[: -2 * lag] - 2 * values[lag:-lag] + values[2 * lag :]
                out[lag:-lag] += bend.clip(-MOST_CURVED, MOST_CURVED) ** 2
        found.append([int(patch.sum()) for patch in grid.cells(squares)])
    return np.array(found, np.int64).T


_TILE = 64  # signs in a word


def sign_tiles(gray: U8, lag: int) -> int:
    """How many words of signs a row has."""
    return int(max(gray.shape[1] - lag, 0) // _TILE)


def row_marks(gray: U8, weights: U64, lag: int, largest: int) -> tuple[U64, U64]:
    """`Kernels.row_marks`."""
    pieces, words = weights.shape
    values = np.ascontiguousarray(gray[:, : 8 * weights.size]).view(np.uint64)
    hashes = np.einsum("rpw,pw->rp", values.reshape(len(gray), pieces, words), weights)
    wide = _TILE * sign_tiles(gray, lag)
    earlier, later = gray[:, :wide], gray[:, lag : wide + lag]
    highest = np.maximum(later, earlier)
    steps = np.stack([highest - earlier, highest - later])
    steps -= np.uint8(1)  # 0 becomes 255
    return hashes, np.packbits(steps < largest, axis=2, bitorder="little").view(np.uint64)


def sign_counts(signs: U64, others: U64) -> I64:
    """`Kernels.sign_counts`."""
    counts = (np.bitwise_count(signs & each) for each in (others, others[:, ::-1]))
    return np.stack([each.sum(axis=(1, 2, 3), dtype=np.int64) for each in counts], axis=1)


def resized_grays(frame: U8, height: int, width: int, threads: int = 1) -> tuple[U16, U8]:
    """`Kernels.resized_grays`."""
    return resized_gray16(frame, height, width), resized_gray(frame, height, width)
