"""The texture features as scikit-image, mahotas and OpenCV compute them.

These are the definition that the fast kernels are held against; ``TOKT_KERNELS=library`` runs
them. They know no threads. What is taken and given stands with `dispatch.Kernels`.
"""

from collections.abc import Sequence
from importlib.metadata import version
from itertools import product
from typing import Any

import cv2
import mahotas.features
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.feature import local_binary_pattern

from tokt.features.common.arrays import F64, I64, U8, U16, U32, U64
from tokt.features.frames.grid import Grid

from .block_matching import block_disparity as block_disparity
from .numpy_pictures import area_means as area_means
from .numpy_pictures import curvature_sums as curvature_sums
from .numpy_pictures import difference_sums as difference_sums
from .numpy_pictures import local_contrast as local_contrast
from .numpy_pictures import resized_gray as resized_gray
from .quantization import Quantization

DETAIL = ", ".join(f"{name} {version(name)}" for name in ("scikit-image", "mahotas"))


def _histograms(patches: NDArray[Any], bins: int) -> I64:
    whole = patches.astype(np.int64)
    return np.stack([np.bincount(patch.ravel(), minlength=bins) for patch in whole])


def lbp_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_counts`."""
    if border == "frame":
        codes = grid.cells(local_binary_pattern(gray, points, radius, method="uniform"))
    else:
        patches = grid.cells(gray)
        codes = np.stack(
            [local_binary_pattern(patch, points, radius, method="uniform") for patch in patches]
        )
    return _histograms(codes, points + 2)


def haralick_features(gray: U8, grid: Grid, ignore_zeros: bool, threads: int = 1) -> F64:
    """`Kernels.haralick_features`."""
    return np.stack([_haralick(patch, ignore_zeros) for patch in grid.cells(gray)])


def _haralick(patch: U8, ignore_zeros: bool) -> F64:
    try:
        directions = mahotas.features.haralick(patch, ignore_zeros=ignore_zeros)
    except ValueError:  # without the zeros there is no pair in one of the directions
        directions = mahotas.features.haralick(patch)
    mean: F64 = directions.mean(axis=0)
    return mean


def _covered(source: int, target: int) -> F64:
    """Matrix (target, source) of what each of `target` pixels covers of each of `source`."""
    begin = np.arange(target)[:, None] * source, np.arange(source) * target
    end = np.minimum(begin[0] + source, begin[1] + target)
    return np.asarray((end - np.maximum(*begin)).clip(0), np.float64)


def resized_gray16(frame: U8, height: int, width: int, threads: int = 1) -> U16:
    """`Kernels.resized_gray16`: two matrix products of whole numbers below 2**53, so exact."""
    rows, columns = _covered(frame.shape[0], height), _covered(frame.shape[1], width)
    if frame.ndim == 2:
        gray = 16384.0 * frame
    else:
        gray = 1868.0 * frame[:, :, 0] + 9617.0 * frame[:, :, 1] + 4899.0 * frame[:, :, 2]
    step = 256.0 / (16384 * frame.shape[0] * frame.shape[1])
    return np.asarray(np.floor(rows @ gray @ columns.T * step + 0.5), np.uint16)


def _around(length: int, side: int) -> F64:
    """Matrix that adds up the `side` values around each of `length`."""
    at = np.arange(length)
    return np.asarray(np.abs(at[:, None] - at) <= side // 2, np.float64)


def _mean_around(gray16: U16, side: int) -> F64:
    down, across = _around(len(gray16), side), _around(gray16.shape[1], side)
    return np.asarray(
        down @ gray16 @ across * (1 / across.sum(axis=0)) * (1 / down.sum(axis=1))[:, None]
    )


def summed_area(gray16: U16) -> U32:
    """`Kernels.summed_area`."""
    whole = cv2.integral(gray16, sdepth=cv2.CV_64F)
    return np.asarray(whole % 2.0**32, np.uint32)


def quantize(gray16: U16, sums: U32, quantization: Quantization, threads: int = 1) -> U8:
    """`Kernels.quantize`; the means' sums are matrix products, exact in double precision."""
    x, middle = _mean_around(gray16, quantization.smooth), 0.0
    if quantization.window:
        around = _mean_around(gray16, quantization.window)
        x, middle = x - around, quantization.levels / 2
        if quantization.by == "ratio":
            x = x * (32 * 256) / np.where(around < 4 * 256, 4 * 256, around)
    scale = quantization.gain * quantization.levels / 65536
    if quantization.window and quantization.by == "frame":
        scale *= 20 * 256 / max(sum(map(int, gray16.ravel())) / gray16.size, 256)
    level = np.floor(x * scale + (middle + 0.5))
    return np.where(
        level < 0, 0, np.where(level >= quantization.levels, quantization.levels - 1, level)
    ).astype(np.uint8)


def level_counts(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.level_counts`."""
    return _histograms(grid.cells(gray), 256)


def lbp_nearest_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_nearest_counts`, pattern by pattern."""
    views = [gray] if border == "frame" else list(grid.cells(gray))
    angles = 2 * np.pi * np.arange(points) / points
    codes = []
    for view in views:
        patterns = []
        for angle in angles:
            # Five decimals as scikit-image has them, so that 90 degrees are 0 pixels across.
            move = np.round(np.round([radius * np.sin(angle), -radius * np.cos(angle)], 5))
            there = ndimage.shift(view, move, order=0, mode="grid-constant", cval=0)
            patterns.append(there >= view)
        uniform = np.diff(patterns, axis=0).sum(axis=0) <= 2 if points > 1 else True
        codes.append(np.where(uniform, np.sum(patterns, axis=0), points + 1))
    cells = grid.cells(codes[0]) if border == "frame" else np.stack(codes)
    return _histograms(cells, points + 2)


def structure_sums(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.structure_sums`."""
    slopes = []
    for axis in (1, 0):
        slope = ndimage.correlate1d(gray.astype(np.int64), [-1, 0, 1], axis, mode="mirror")
        slopes.append(grid.cells(slope).reshape(grid.n_patches, -1))
    pairs = ((0, 0), (1, 1), (0, 1))
    return np.stack([(slopes[one] * slopes[two]).sum(axis=1) for one, two in pairs], axis=1)


def gradient_sums(gray16: U16, grid: Grid, box: int, threads: int = 1) -> I64:
    """`Kernels.gradient_sums`."""
    near = np.ones((box, box), np.int64)
    sums = ndimage.correlate(gray16.astype(np.int64), near, mode="nearest")
    means = (sums + near.size // 2) // near.size
    gx, gy = (ndimage.correlate1d(means, [-1, 0, 1], axis, mode="mirror") for axis in (1, 0))
    out = []
    for across, down in zip(grid.cells(gx * gx), grid.cells(gy * gy), strict=True):
        both = sorted((across + down).ravel().tolist())
        strong = both[-(-19 * len(both) // 20) - 1]
        digits = max(strong.bit_length() - 4, 0)
        out.append((across.sum(), down.sum(), strong >> digits << digits))
    return np.array(out, np.int64)


def box_sums(frame: U8, rows: I64, columns: I64, threads: int = 1) -> I64:
    """`Kernels.box_sums`, box by box."""
    deep = frame.reshape(*frame.shape[:2], -1)
    sums = [
        deep[top:bottom, left:right].sum(axis=(0, 1), dtype=np.int64)
        for (top, bottom), (left, right) in product(rows, columns)
    ]
    return np.array(sums).reshape(len(rows), len(columns), -1)


def line_sums(gray: U8, grid: Grid, middle: int, samples: Sequence[int], threads: int = 1) -> I64:
    """`Kernels.line_sums`, sample by sample."""
    height, width = gray.shape
    out = []
    for n in samples:
        signed = np.pad(gray.astype(np.int64) - middle, n)
        sums = np.zeros((8, height, width), np.int64)
        moves = ((0, 2), (1, 2), (1, 1), (2, 1), (2, 0), (2, -1), (1, -1), (1, -2))
        for line, (down, right) in zip(sums, moves, strict=True):
            for step in range(-(n // 2), n // 2):
                y, x = n + step * down, n + step * right
                line += signed[y : y + height, x : x + width]
        stack = np.stack([grid.cells(line) for line in sums]).reshape(8, grid.n_patches, -1)
        ridge = (8 * stack.max(axis=0) - stack.sum(axis=0)).sum(axis=1)
        out.append(np.concatenate([ridge[None], (stack * stack).sum(axis=2)]).T)
    return np.stack(out, axis=1)


def row_marks(gray: U8, weights: U64, lag: int, largest: int) -> tuple[U64, U64]:
    """`Kernels.row_marks`, number by number."""
    pieces, words = weights.shape
    hashes = np.empty((len(gray), pieces), np.uint64)
    for place in np.ndindex(*hashes.shape):
        start = 8 * words * place[1]
        values = np.frombuffer(gray[place[0], start : start + 8 * words].tobytes(), np.uint64)
        numbers = zip(values.tolist(), weights[place[1]].tolist(), strict=True)
        hashes[place] = sum(value * weight for value, weight in numbers) % 2**64
    steps = gray[:, lag:].astype(int) - gray[:, : max(gray.shape[1] - lag, 0)]
    steps = steps[:, : max(steps.shape[1], 0) // 64 * 64].reshape(len(gray), -1, 64)
    bits = np.uint64(1) << np.arange(64, dtype=np.uint64)
    signs = [np.sum(((s > 0) & (s <= largest)) * bits, axis=2) for s in (steps, -steps)]
    return hashes, np.array(signs, np.uint64)


def sign_counts(signs: U64, others: U64) -> I64:
    """`Kernels.sign_counts`, word by word."""
    counts = [
        sum(int(word).bit_count() for word in (signs & each).ravel())
        for other in others
        for each in (other, other[::-1])
    ]
    return np.array(counts, np.int64).reshape(-1, 2)


def resized_grays(frame: U8, height: int, width: int, threads: int = 1) -> tuple[U16, U8]:
    """`Kernels.resized_grays`."""
    return resized_gray16(frame, height, width), resized_gray(frame, height, width)
