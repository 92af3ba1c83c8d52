"""Haralick's features as mahotas defines them, without rounding: whole numbers and 50 digits."""

from decimal import Decimal, localcontext
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_DIGITS = 50
_STEPS = ((0, 1), (1, 1), (1, 0), (1, -1))
Floats = NDArray[np.float64]
Counts = NDArray[np.int64]


def _counts(patch: NDArray[np.uint8], step: tuple[int, int]) -> Counts:
    """Symmetric co-occurrence counts of grey levels one step apart, 256x256."""
    down, right = step
    height, width = patch.shape
    first = patch[: height - down, max(0, -right) : width - max(0, right)]
    second = patch[down:, max(0, right) : width + min(0, right)]
    counts = np.zeros((256, 256), np.int64)
    np.add.at(counts, (first.ravel(), second.ravel()), 1)
    return counts + counts.T


def matrices(patch: NDArray[np.uint8], ignore_zeros: bool) -> list[Counts]:
    """The four matrices; with the zeros counted where a direction has nothing else."""
    whole = [_counts(patch, step) for step in _STEPS]
    if not ignore_zeros:
        return whole
    kept = [matrix.copy() for matrix in whole]
    for matrix in kept:
        matrix[0] = matrix[:, 0] = 0
    return kept if all(matrix.any() for matrix in kept) else whole


def spreads(matrix: Counts) -> tuple[float, float, float]:
    """Mean grey level, its variance, and the variance of the sum of two neighbours."""
    total, greys = int(matrix.sum()), np.arange(256)
    level, sums = matrix.sum(axis=0), _diagonals(matrix, np.add.outer(greys, greys), 511)
    first, second = int(level @ greys), int(level @ greys**2)
    sums_second = int(sums @ np.arange(511) ** 2)
    variance = (total * second - first**2) / total**2
    return first / total, variance, (total * sums_second - 4 * first**2) / total**2


def _diagonals(matrix: Counts, place: Counts, size: int) -> Counts:
    return np.bincount(place.ravel(), matrix.ravel(), size).astype(np.int64)


@lru_cache(maxsize=100_000)
def _log2(n: int) -> Decimal:
    with localcontext(prec=_DIGITS):
        return Decimal(n).ln() / Decimal(2).ln()


def _entropy(counts: Counts, total: int) -> Decimal:
    values, times = np.unique(counts[counts > 0], return_counts=True)
    if values[0] == total:
        return Decimal()  # not what is left of 50 digits
    weighted = sum(
        (n * k * _log2(n) for n, k in zip(values.tolist(), times.tolist(), strict=True)), Decimal(0)
    )
    return _log2(total) - weighted / total


def _correlation_2(shared: Decimal) -> Decimal:
    return (1 - (-2 * max(shared, Decimal(0))).exp()).sqrt()


def _direction(matrix: Counts, brightest: int, relative: float) -> list[tuple[Decimal, Decimal]]:
    """Each feature of one direction, and the error that `exact_haralick` allows it."""
    total, greys, small = int(matrix.sum()), np.arange(256), Decimal(relative)
    level = matrix.sum(axis=0)
    sums = _diagonals(matrix, np.add.outer(greys, greys), 511)
    differences = _diagonals(matrix, np.abs(np.subtract.outer(greys, greys)), 256)
    first, second = int(level @ greys), int(level @ greys**2)
    contrast = int(differences @ greys**2)
    variance = total * second - first**2  # times total squared
    sum_variance = total * int(sums @ np.arange(511) ** 2) - 4 * first**2  # likewise
    covariance = sum_variance - 2 * variance  # of the two neighbours, twice
    homogeneity = sum((Decimal(int(n)) / (1 + d * d) for d, n in enumerate(differences)), Decimal())
    values, difference_squares = brightest + 1, int((differences**2).sum())
    own, levels = _entropy(matrix, total), _entropy(level, total)
    shared, error = 2 * levels - own, small * (2 * levels + own)
    squared = Decimal(total) ** 2
    plain = {
        0: Decimal(int((matrix**2).sum())) / squared,
        1: Decimal(contrast) / total,
        3: Decimal(variance) / squared,
        4: homogeneity / total,
        5: 2 * Decimal(first) / total,
        7: _entropy(sums, total),
        8: own,
        10: _entropy(differences, total),
    }
    pairs = {index: (value, small * value) for index, value in plain.items()}
    pairs[2] = (Decimal(covariance) / (2 * variance) if variance else Decimal(1), small)
    pairs[6] = Decimal(sum_variance) / squared, 4 * small * plain[3]
    spread = Decimal(values * difference_squares - total**2) / (squared * values**2)
    pairs[9] = spread, small * difference_squares / (squared * values)
    pairs[11] = (-shared / levels, error / levels) if levels else (Decimal(), Decimal())
    reach = _correlation_2(shared + error) - _correlation_2(shared - error)
    pairs[12] = _correlation_2(shared), reach + small
    return [pairs[index] for index in range(13)]


def exact_haralick(patch, ignore_zeros, relative) -> tuple[Floats, Floats]:
    """The 13 features, mean over 4 directions, and how far from them rounding may lead.

    Parameters
    ----------
    patch : array of uint8, shape (height, width)
    ignore_zeros : bool
    relative : float
        Rounding error of a sum, relative to the size of its terms.

    Returns
    -------
    features, allowed : numpy.ndarray
        float64, shape (13,) each. The allowed error is `relative` of the feature itself, except
        where it is a difference: then it is `relative` of what is subtracted. These are the
        correlation (3), the sum variance (7, zero for a checkerboard), the difference variance
        (10), and the information measures (12, 13) where one level tells nothing about the next:
        feature 13 is the square root of nearly 0 there and has half the digits.
    """
    brightest = int(patch.max())
    with localcontext(prec=_DIGITS):
        directions = [
            _direction(matrix, brightest, relative) for matrix in matrices(patch, ignore_zeros)
        ]
        means = [
            [sum((pair[which] for pair in feature), Decimal()) / 4 for which in (0, 1)]
            for feature in zip(*directions, strict=True)
        ]
    features, allowed = np.array(means, dtype=np.float64).T
    return features, allowed
