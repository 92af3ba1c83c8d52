"""The thesis's features of a picture: kinds of the bins of LBP histograms, distances of them.

A uniform pattern of P points on a circle is one run of k brighter points::

    k = 0 or P          k about P/2          k about P/4 or 3P/4
     . . .               . o o                . . o
    .     .             .     o              .     o
     . . .               . . o                . . .
    flat: a spot        edge: half of        corner: a quarter of the
    or an even area     the circle           circle, or all but a quarter

The bin after the P + 1 uniform ones counts all patterns of several runs. Noise makes these.
"""

from __future__ import annotations

from enum import StrEnum
from fractions import Fraction

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.speed.models import FEATURE_SETS

Rows = NDArray[np.float64]

LBP_KEYS = ("lbp_10_5", "lbp_24_8")
EXTRACTORS = {one.name: one.extractor for one in FEATURE_SETS}
"""The thesis's features by tokt's kernels: the same integers, and the same figures to 12 digits,
in a tenth of the time."""

_TOLERANCE = Fraction(1, 12)
"""Of the circle. Two points of 24, as in scikit-image's example of edge, flat and corner bins."""


class BinKind(StrEnum):
    """The kind of place that gives a pattern."""

    FLAT = "flat"
    EDGE = "edge"
    CORNER = "corner"
    BETWEEN = "between"
    NOT_UNIFORM = "not uniform"


_PLACES = {
    BinKind.FLAT: (Fraction(0), Fraction(1)),
    BinKind.EDGE: (Fraction(1, 2),),
    BinKind.CORNER: (Fraction(1, 4), Fraction(3, 4)),
}
"""By kind, the shares of the circle that are brighter."""


def bin_kinds(points: int) -> tuple[BinKind, ...]:
    """What each bin of a uniform LBP histogram stands for, of `points` + 2 bins.

    Examples
    --------
    >>> [str(kind) for kind in bin_kinds(8)][:5]
    ['flat', 'between', 'corner', 'between', 'edge']
    """
    return (*(_kind(Fraction(run, points)) for run in range(points + 1)), BinKind.NOT_UNIFORM)


def _kind(share: Fraction) -> BinKind:
    for kind, places in _PLACES.items():
        if any(abs(share - place) <= _TOLERANCE for place in places):
            return kind
    return BinKind.BETWEEN


def share_by_kind(histogram: Rows) -> dict[BinKind, float]:
    """How much of a normalised histogram, shape (points + 2,), falls into bins of each kind."""
    kinds = bin_kinds(len(histogram) - 2)
    return {
        kind: float(sum(value for value, its in zip(histogram, kinds, strict=True) if its == kind))
        for kind in BinKind
    }


def described(picture: NDArray[np.uint8]) -> dict[str, Rows]:
    """The thesis's features of each patch of a picture, by extractor."""
    return {key: texture.describe(picture, GRID) for key, texture in EXTRACTORS.items()}


def hellinger(first: Rows, second: Rows) -> Rows:
    """Hellinger distances between histograms: float64, shape (n, m).

    0 between equal ones and 1 between those with no bin in common:
    ``sqrt(1 - sum(sqrt(p q)))``.

    Parameters
    ----------
    first, second : arrays of float64, shapes (n, bins) and (m, bins)
        Rows sum to 1.
    """
    return np.asarray(cdist(np.sqrt(first), np.sqrt(second)) / np.sqrt(2.0), np.float64)


def chi_square(first: Rows, second: Rows) -> float:
    """Symmetric chi-square distance of two histograms, 0 to 1: ``sum((p-q)^2 / (p+q)) / 2``."""
    pair = first.astype(np.float32), second.astype(np.float32)
    return float(cv2.compareHist(*pair, cv2.HISTCMP_CHISQR_ALT)) / 4.0


def confused(first: Rows, second: Rows) -> float:
    """Share of the patches of two images that are nearer to the other image's mean histogram.

    0 where the two separate cleanly; about 0.5 where their patches look alike. A tie is
    confused.

    Parameters
    ----------
    first, second : arrays of float64, shapes (n, bins) and (m, bins)
    """
    means = np.stack([first.mean(axis=0), second.mean(axis=0)])
    to_first, to_second = hellinger(first, means), hellinger(second, means)
    wrong = (to_first[:, 0] >= to_first[:, 1]).sum() + (to_second[:, 1] >= to_second[:, 0]).sum()
    return float(wrong / (len(first) + len(second)))
