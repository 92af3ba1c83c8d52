"""The kernels in numpy alone, for machines without a compiler.

The same arithmetic as in ``features/kernels/native``, a whole row of patches at a time: identical
LBP counts, Haralick features equal to rounding. What is taken and given stands with
`dispatch.Kernels`.
"""

import threading
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, I64, U8, U16, Bools
from tokt.features.frames.grid import Grid

from .block_matching import block_disparity as block_disparity
from .checks import over_rows
from .lbp_points import lbp_points, nearest_points
from .numpy_pictures import area_means as area_means
from .numpy_pictures import box_sums as box_sums
from .numpy_pictures import curvature_sums as curvature_sums
from .numpy_pictures import difference_sums as difference_sums
from .numpy_pictures import histograms
from .numpy_pictures import level_counts as level_counts
from .numpy_pictures import local_contrast as local_contrast
from .numpy_pictures import quantize as quantize
from .numpy_pictures import resized_gray as resized_gray
from .numpy_pictures import resized_gray16 as resized_gray16
from .numpy_pictures import resized_grays as resized_grays
from .numpy_pictures import row_marks as row_marks
from .numpy_pictures import sign_counts as sign_counts
from .numpy_pictures import summed_area as summed_area

DETAIL = f"numpy {np.__version__}"

_DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1))
_GREYS = 256
_KEPT_VALUES = 200_000  # pixels; about 100 bytes each stay allocated
_CACHED_VALUES = 30_000  # float64 values that a few arrays of fit a core's cache


def lbp_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_counts`, to the last integer."""
    if border == "frame":
        codes = _sampler(points, radius, len(gray), 1, gray.shape[1]).codes(gray[:, None, :])
        return histograms(grid.cells(codes[:, 0]).reshape(grid.n_patches, -1), points + 2)
    patches = grid.cells(gray)
    counts = np.empty((grid.n_patches, points + 2), np.int64)
    at_once = max(1, _CACHED_VALUES // patches[0].size)

    def work(first: int, last: int) -> None:
        end = last * grid.cols
        for begin in range(first * grid.cols, end, at_once):
            some = patches[begin : min(begin + at_once, end)].swapaxes(0, 1)
            codes = _sampler(points, radius, *some.shape).codes(some).swapaxes(0, 1)
            flat = codes.reshape(len(codes), -1)
            counts[begin : begin + len(codes)] = histograms(flat, points + 2)

    over_rows(work, grid.rows, threads)
    return counts


_WHOLE_PIXEL: list[tuple[int, int, float]] = []


def _runs(fractions: F64) -> list[tuple[int, int, float]]:
    """Where equal fractions follow each other: first, last + 1 and the fraction.

    A position's fraction changes in its last bits where the position passes a power of two, so
    there are few runs, and one weight goes with a whole block of pixels. Fractions of whole
    pixels are all zero.
    """
    if not fractions.any():
        return _WHOLE_PIXEL
    ends = np.flatnonzero(np.append(fractions[1:] != fractions[:-1], True)) + 1
    starts = np.concatenate([[0], ends[:-1]])
    return list(zip(starts.tolist(), ends.tolist(), fractions[starts].tolist(), strict=True))


class _Sampler:
    """Local binary patterns of n views of one size, each with zeros around it.

    The views' rows lie side by side, so that a row's weight goes with many pixels. Its arrays are
    used again for the next views. P sampling points lie on a circle of R pixels.
    """

    def __init__(self, points: int, radius: float, height: int, n: int, width: int) -> None:
        self.points = lbp_points(points, radius, height, width)
        self.column_runs = [_runs(fraction) for fraction in self.points.column_fraction]
        self.row_runs = [_runs(fraction) for fraction in self.points.row_fraction]
        reach = self.points.reach
        self.padded = np.zeros((height, n, width + 2 * reach), np.uint8)
        self.inside = self.padded[:, :, reach : reach + width]
        self.centre, self.between, self.value, self.part, *spare = np.empty((6, height, n, width))
        self.spare: list[F64] = spare
        self.moved: dict[int, F64] = {}
        self.is_set = np.empty((points, height, n, width), bool)
        self.ones, self.changes, self.change = np.empty((3, height, n, width), np.uint8)

    def codes(self, views: U8) -> U8:
        """Each pixel's pattern, a uniform one by its number of ones, any other P + 1.

        Takes and returns uint8, shape (height, n, width); what it returned last is overwritten.
        """
        self.inside[:] = views
        self.centre[:] = views
        self.spare += self.moved.values()
        self.moved.clear()
        points = self.points
        for offset in range(len(points.column_floor)):
            across = self._interpolate(offset)
            for point in points.point[points.first[offset] : points.first[offset + 1]].tolist():
                self._compare(across, point)
        patterns = self.is_set.view(np.uint8)
        self.ones[:] = patterns[0]
        self.changes[:] = 0
        for before, now in pairwise(patterns):
            self.ones += now
            self.changes += np.bitwise_xor(before, now, out=self.change)
        np.copyto(self.ones, len(points.point) + 1, where=self.changes > 2)
        return self.ones

    def _moved(self, shift: int) -> F64:
        """The views moved sideways by whole pixels, zeros following; two are kept."""
        if shift not in self.moved:
            # Offsets come in order: the lowest shift is not needed again.
            kept = self.spare.pop() if self.spare else self.moved.pop(min(self.moved))
            begin = self.points.reach + shift
            kept[:] = self.padded[:, :, begin : begin + kept.shape[2]]
            self.moved[shift] = kept
        return self.moved[shift]

    def _interpolate(self, offset: int) -> F64:
        """Every row interpolated at one column offset."""
        floor = int(self.points.column_floor[offset])
        near = self._moved(floor)
        runs = self.column_runs[offset]
        if runs == _WHOLE_PIXEL:
            return near
        far = self._moved(floor + 1)
        np.multiply(near, 1 - runs[-1][2], out=self.between)
        np.multiply(far, runs[-1][2], out=self.part)
        for first, last, right in runs[:-1]:
            columns = np.s_[:, :, first:last]
            np.multiply(near[columns], 1 - right, out=self.between[columns])
            np.multiply(far[columns], right, out=self.part[columns])
        return np.add(self.between, self.part, out=self.between)

    def _compare(self, across: F64, point: int) -> None:
        """Set `is_set` where one sampling point's value is not below the centre."""
        floor, runs = int(self.points.row_floor[point]), self.row_runs[point]
        out = self.is_set[point]
        if runs == _WHOLE_PIXEL:
            first, last = _overlap(len(out), floor)
            np.equal(self.centre[:first], 0, out=out[:first])
            np.equal(self.centre[last:], 0, out=out[last:])
            rows = across[first + floor : last + floor]
            np.greater_equal(rows, self.centre[first:last], out=out[first:last])
            return
        value = self.value
        _weigh(across, floor, [(first, last, 1 - below) for first, last, below in runs], value)
        _weigh(across, floor + 1, runs, self.part)
        np.add(value, self.part, out=value)
        np.greater_equal(value, self.centre, out=out)


def _overlap(height: int, down: int) -> tuple[int, int]:
    """Rows of a view that still lie in it `down` rows lower: first, last + 1."""
    first = min(max(0, -down), height)
    return first, max(first, min(height, height - down))


def _weigh(across: F64, down: int, runs: list[tuple[int, int, float]], out: F64) -> None:
    """Write the rows that lie `down` rows lower times their weight, zero beyond the view."""
    first, last = _overlap(len(out), down)
    out[:first] = 0
    out[last:] = 0
    for begin, end, weight in runs:
        begin, end = max(begin, first), min(end, last)
        if begin < end:
            np.multiply(across[begin + down : end + down], weight, out=out[begin:end])


class _SamplerCache(threading.local):
    """One thread's arrays: asked for anew with every frame they would cost page faults."""

    def __init__(self) -> None:
        self.get = lru_cache(maxsize=4)(_Sampler)


_samplers = _SamplerCache()


def _sampler(points: int, radius: float, height: int, n: int, width: int) -> _Sampler:
    """One with arrays that are there already, unless they are too large to be kept."""
    make = _samplers.get if height * n * width <= _KEPT_VALUES else _Sampler
    return make(points, radius, height, n, width)


def haralick_features(gray: U8, grid: Grid, ignore_zeros: bool, threads: int = 1) -> F64:
    """`Kernels.haralick_features`, up to rounding."""
    patches = grid.cells(gray).reshape(grid.rows, grid.cols, *grid.patch_size(*gray.shape))
    features = np.empty((grid.rows, grid.cols, 13))

    def work(first: int, last: int) -> None:
        for row in range(first, last):
            features[row] = _describe(patches[row], ignore_zeros)

    over_rows(work, grid.rows, threads)
    return features.reshape(-1, 13)


def _describe(patches: U8, ignore_zeros: bool) -> F64:
    """Features of n patches, shape (n, 13), from one list of the cells of all their matrices."""
    keys = _pair_keys(patches)
    keys.sort()
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    cells, counts = keys[starts].astype(np.int64), np.diff(starts, append=len(keys))
    if ignore_zeros:
        cells, counts = _without_zeros(cells, counts, 4 * len(patches))
    brightest = patches.max(axis=(1, 2)).astype(np.int64).repeat(4)
    matrices = _Matrices(cells, counts, 4 * len(patches))
    return np.asarray(matrices.features(brightest).reshape(len(patches), 4, 13).mean(axis=1))


def _pair_keys(patches: U8) -> NDArray[np.integer]:
    """Each pair of neighbours as matrix number * 65536 + darker level * 256 + brighter level."""
    height, width = patches.shape[1:]
    key: type = np.int32 if len(patches) < 1 << 13 else np.int64  # narrow ones are sorted faster
    parts = []
    for direction, (down, right) in enumerate(_DIRECTIONS):
        first = patches[:, : height - down, max(0, -right) : width - max(0, right)]
        second = patches[:, down:, max(0, right) : width - max(0, -right)]
        pairs = np.minimum(first, second).astype(key) << 8
        pairs |= np.maximum(first, second)
        matrix = np.arange(direction, 4 * len(patches), 4, dtype=pairs.dtype)
        pairs |= matrix[:, None, None] << 16
        parts.append(pairs.ravel())
    return np.concatenate(parts)


def _without_zeros(cells: I64, counts: I64, n_matrices: int) -> tuple[I64, I64]:
    """Leave out cells of grey level 0, except in patches where a direction has no others."""
    kept = cells & 0xFFFF >= _GREYS
    cells_left = np.bincount(cells[kept] >> 16, minlength=n_matrices).reshape(-1, 4)
    whole = (cells_left == 0).any(axis=1).repeat(4)
    kept |= whole[cells >> 16]
    return cells[kept], counts[kept]


def _surprise(n: I64, total: I64) -> F64:
    """``n * log2(total / n)`` without loss where n is nearly the total."""
    part = n / total
    most = 2 * n > total
    surprise = -np.log2(part)
    surprise[most] = -np.log1p((n[most] - total[most]) / total[most]) / np.log(2)
    return np.asarray(n * surprise)


class _Matrices:
    """Symmetric co-occurrence matrices as one list of their cells that are not zero.

    The cells are matrix number * 65536 + darker level * 256 + brighter level, sorted, with the
    pairs of neighbours in each of them.
    """

    def __init__(self, cells: I64, counts: I64, n: int) -> None:
        self.n = n
        self.matrix = cells >> 16
        self.darker, self.brighter = cells >> 8 & 255, cells & 255
        self.pairs = counts
        self.total = 2 * self._sum(self.matrix, counts)

    def _sum(self, where: I64, what: NDArray[np.number], size: int = 0) -> I64:
        return np.bincount(where, what, size or self.n).astype(np.int64)

    def _entropy(self, histogram: I64) -> F64:
        """Entropy in bits of each row of counts."""
        row, column = np.nonzero(histogram)
        surprise = _surprise(histogram[row, column], self.total[row])
        return np.bincount(row, surprise, self.n) / self.total

    def _histogram(self, value: I64, pairs: I64, size: int) -> I64:
        return self._sum(self.matrix * size + value, pairs, self.n * size).reshape(self.n, size)

    def _own_entropy(self) -> F64:
        diagonal = self.darker == self.brighter
        n = np.where(diagonal, 2 * self.pairs, self.pairs)
        surprise = _surprise(n, self.total[self.matrix])
        return np.bincount(self.matrix, np.where(diagonal, 1, 2) * surprise, self.n) / self.total

    def features(self, brightest: I64) -> F64:
        """The 13 features of each matrix, shape (n, 13)."""
        total = self.total
        level = self._histogram(self.darker, self.pairs, _GREYS)
        level += self._histogram(self.brighter, self.pairs, _GREYS)
        difference = self._histogram(self.brighter - self.darker, 2 * self.pairs, _GREYS)
        sums = self._histogram(self.brighter + self.darker, 2 * self.pairs, 2 * _GREYS)
        squares = np.where(self.darker == self.brighter, 4, 2) * self.pairs**2
        entropy, level_entropy = self._own_entropy(), self._entropy(level)
        shared = 2 * level_entropy - entropy
        out = np.empty((self.n, 13))
        out[:, 0] = self._sum(self.matrix, squares) / total / total
        self._moments(level, difference, sums, out)
        out[:, 7] = self._entropy(sums)
        out[:, 8] = entropy
        out[:, 9] = _difference_variance(difference, total, brightest)
        out[:, 10] = self._entropy(difference)
        out[:, 11] = -shared / np.where(level_entropy == 0, 1, level_entropy)
        out[:, 12] = np.sqrt(-np.expm1(-2 * np.maximum(shared, 0)))
        return out

    def _moments(self, level: I64, difference: I64, sums: I64, out: F64) -> None:
        """Features 2 to 7, from whole numbers around one next to the mean."""
        total, greys = self.total, np.arange(_GREYS)
        first = level @ greys
        middle = (first + total // 2) // total
        spread = (level * (greys - middle[:, None]) ** 2).sum(axis=1)
        sum_spread = (sums * (np.arange(2 * _GREYS) - 2 * middle[:, None]) ** 2).sum(axis=1)
        contrast = difference @ greys**2
        shift = (first - middle * total) / total
        variance = spread / total - shift**2
        covariance = (sum_spread - contrast) / (4 * total) - shift**2
        constant = variance == 0
        out[:, 1] = contrast / total
        out[:, 2] = np.where(constant, 1, covariance / np.where(constant, 1, variance))
        out[:, 3] = variance
        out[:, 4] = difference @ (1 / (1 + greys**2)) / total
        out[:, 5] = 2 * first / total
        out[:, 6] = sum_spread / total - 4 * shift**2


def _difference_variance(difference: I64, total: I64, brightest: I64) -> F64:
    """Variance of P(|i-j|) over all differences that the patch's brightest level allows."""
    values = (brightest + 1)[:, None]
    possible = np.arange(_GREYS) < values
    excess = np.where(possible, difference / total[:, None] - 1 / values, 0)
    return np.asarray((excess**2).sum(axis=1) / values[:, 0])


LINE_STEPS = ((0, 2), (1, 2), (1, 1), (2, 1), (2, 0), (2, -1), (1, -1), (1, -2))
"""Rows and columns from one sample of a line to the next, for each direction."""


def _patch_sums(values: NDArray[np.integer], grid: Grid) -> I64:
    return np.asarray(grid.cells(values).sum(axis=(1, 2), dtype=np.int64))


def lbp_nearest_counts(
    gray: U8, grid: Grid, points: int, radius: float, border: str, threads: int = 1
) -> I64:
    """`Kernels.lbp_nearest_counts`."""
    views = gray[None] if border == "frame" else grid.cells(gray)
    reach = int(np.ceil(radius))
    padded = np.pad(views, ((0, 0), (reach, reach), (reach, reach)))
    height, width = views.shape[1:]
    ones, changes = np.zeros((2, *views.shape), np.uint8)
    before: Bools | None = None
    for down, right in nearest_points(points, radius).tolist():
        top, left = reach + down, reach + right
        now = padded[:, top : top + height, left : left + width] >= views
        ones += now
        if before is not None:
            changes += before != now
        before = now
    np.copyto(ones, points + 1, where=changes > 2)
    codes = grid.cells(ones[0]) if border == "frame" else ones
    return histograms(codes.reshape(grid.n_patches, -1), points + 2)


def structure_sums(gray: U8, grid: Grid, threads: int = 1) -> I64:
    """`Kernels.structure_sums`."""
    grid.patch_size(*gray.shape)
    # This border rule mirrors a neighbour into the other's place: their difference is 0.
    gx, gy = (
        cv2.Sobel(gray, cv2.CV_16S, *axis, ksize=1, borderType=cv2.BORDER_REFLECT_101).astype(
            np.int32
        )
        for axis in ((1, 0), (0, 1))
    )
    return np.stack([_patch_sums(product, grid) for product in (gx * gx, gy * gy, gx * gy)], axis=1)


def gradient_sums(gray16: U16, grid: Grid, box: int, threads: int = 1) -> I64:
    """`Kernels.gradient_sums`; squares are below 2**53, up to which double precision is exact."""
    whole, border = gray16.astype(np.float64), cv2.BORDER_REPLICATE
    sums = cv2.boxFilter(whole, cv2.CV_64F, (box, box), normalize=False, borderType=border)
    means = np.floor((sums + box * box // 2) / (box * box))
    gx2, gy2 = (
        cv2.Sobel(means, cv2.CV_64F, *axis, ksize=1, borderType=cv2.BORDER_REFLECT_101) ** 2
        for axis in ((1, 0), (0, 1))
    )
    # A double's exponent and first 3 digits behind the leading one; it keeps the order.
    digits = grid.cells(gx2 + gy2).reshape(grid.n_patches, -1).view(np.int64) >> 49
    place = -(-19 * digits.shape[1] // 20) - 1
    strong = (np.partition(digits, place, axis=1)[:, place] << 49).view(np.float64)
    totals = (_patch_sums(squares.astype(np.int64), grid) for squares in (gx2, gy2))
    return np.stack([*totals, strong.astype(np.int64)], axis=1)


def line_sums(gray: U8, grid: Grid, middle: int, samples: Sequence[int], threads: int = 1) -> I64:
    """`Kernels.line_sums`."""
    height, width = gray.shape
    grid.patch_size(height, width)
    reach = samples[-1]
    signed = np.zeros((height + 2 * reach, width + 2 * reach), np.int32)
    signed[reach:-reach, reach:-reach] = gray.astype(np.int32) - middle
    inside = np.s_[reach:-reach, reach:-reach]
    largest = np.full((len(samples), height, width), -(1 << 20), np.int32)
    out = np.zeros((grid.n_patches, len(samples), 9), np.int64)
    for direction, (down, right) in enumerate(LINE_STEPS):
        line, n = signed, 1
        while n < samples[-1]:
            # What is rolled in at the other end is never looked at: `reach` is wide enough.
            line = line + np.roll(line, (-n * down, -n * right), (0, 1))
            n *= 2
            if n in samples:
                place = samples.index(n)
                centred = np.roll(line, (n * down // 2, n * right // 2), (0, 1))[inside]
                np.maximum(largest[place], centred, out=largest[place])
                out[:, place, 0] -= _patch_sums(centred, grid)
                out[:, place, 1 + direction] = _patch_sums(centred * centred, grid)
    for place, most in enumerate(largest):
        out[:, place, 0] += 8 * _patch_sums(most, grid)
    return out
