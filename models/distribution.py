"""The distribution of a model's training features, and the distance a run's frames may have to it.

The distance of a feature is Kolmogorov and Smirnov's: the largest difference between two
cumulative distributions, here at `BINS` - 1 quantiles of the training patches, which is at most
2 / `BINS` less than over all values. It is chosen as it has no unit, stays between 0 and 1,
asks nothing of a feature's law, and is the same for any monotone rescaling of it. Measured on the
sea trial of 20 April 2016 with three extractors, held-back parts against changed pictures of them:
Wasserstein's distance over the interquartile range had the same false warnings and saw fewer of the
changes (the longest tail sets its limits); the population stability index saw fewer too, had fewer
false warnings with plain LBP, and needs a made-up count where a bin is empty.

How far is too far is measured: windows of consecutive frames are held back from the training
patches, with a gap, and their distances from all others are kept (`typical`, `factor`). A
window's patches are near copies, so tables of the Kolmogorov-Smirnov test would be far too strict.
As the largest of n stretches, a limit would be exceeded by one in n + 1 if stretches had nothing to
do with each other. Neighbours have: simulated dives (8 features, autoregressive of order 1, windows
of 10 frames, 6 or 20 stretches) exceeded it in 0.3 and 0.07 of all stretches of 15 frames where
frames were independent, in 0.5 and 0.12 with a correlation of 0.8 between frames, in 0.8 and 0.23
with one of 0.95.

Reference: A. Kolmogorov (1933), Sulla determinazione empirica di una legge di distribuzione,
Giornale dell'Istituto Italiano degli Attuari 4.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64

BINS = 32
MIN_TYPICAL = 1 / BINS
"""A feature's typical distance counts as at least what `BINS` - 1 quantiles resolve."""
MAX_WINDOW_FRAMES = 60
MIN_STRETCHES = 3
"""With fewer stretches held back, the largest distance seen says next to nothing."""
_MAX_EXACT = 2**53  # counts that a float64 holds exactly
_SAME = 1e-9  # values this close are one value: other kernels may differ in the last digits


@dataclass(frozen=True)
class Distribution:
    """The training distribution of each feature, and the limits that were measured on it.

    Raises ValueError if shapes, types or bounds are not these.
    """

    edges: F64  # (dim, BINS - 1): rising values of each feature, as `quantile_edges` gives them
    counts: I64  # (dim, BINS): training patches in each bin; bin k ends with, and holds, edge k
    typical: F64  # (dim,): mean distance of the held-back windows, at least `MIN_TYPICAL`
    # The largest distance of any feature in any held-back window over that feature's typical one.
    factor: float
    window_frames: int  # frames a window spans
    windows: int  # held back, one from each frame on
    stretches: int  # how many of these have no frame in common

    def __post_init__(self) -> None:
        dim = len(self.edges) if self.edges.ndim == 2 else 0
        shapes = (self.edges.shape, self.counts.shape, self.typical.shape)
        if dim < 1 or shapes != ((dim, BINS - 1), (dim, BINS), (dim,)):
            raise ValueError(f"shapes {shapes} are no distribution of features")
        if {self.edges.dtype, self.typical.dtype} != {np.dtype(np.float64)} or (
            self.counts.dtype != np.int64
        ):
            raise ValueError("a distribution's values are float64, its counts int64")
        if not np.isfinite(self.edges).all() or (self.edges[:, 1:] < self.edges[:, :-1]).any():
            raise ValueError("a distribution's edges are finite and rise")
        if (self.counts < 0).any() or (self.counts > _MAX_EXACT // BINS).any():
            raise ValueError("a distribution's counts are out of their bounds")
        sums = self.counts.sum(axis=1)
        if sums[0] < 1 or (sums != sums[0]).any():
            raise ValueError("a distribution counts the same patches for each feature")
        if not ((self.typical >= MIN_TYPICAL) & (self.typical <= 1)).all():
            raise ValueError(f"typical distances are {MIN_TYPICAL} to 1")
        if not 1 <= self.factor <= BINS:
            raise ValueError(f"the factor of a distribution's limits is 1 to {BINS}")
        if not 1 <= self.window_frames <= MAX_WINDOW_FRAMES:
            raise ValueError(f"a window spans 1 to {MAX_WINDOW_FRAMES} frames")
        if not MIN_STRETCHES <= self.stretches <= self.windows <= _MAX_EXACT:
            raise ValueError("a distribution's windows and stretches are out of their bounds")

    @property
    def dim(self) -> int:
        """Number of features."""
        return len(self.edges)

    @property
    def limits(self) -> F64:
        """The distance of each feature above which it is out of range, shape (dim,)."""
        return self.typical * self.factor

    def out_of_range(self, counts: I64) -> float:
        """The part of the watched features that are out of range in these rows alone, 0 to 1.

        Parameters
        ----------
        counts : array of int64, shape (dim, BINS)
            `bin_counts` of the features of one frame's patches.
        """
        limits = self.limits
        out = self.distances(counts) > limits
        return int(out.sum()) / max(int((limits < 1).sum()), 1)

    @cached_property
    def _shares(self) -> F64:
        return _cumulative(self.counts)

    def distances(self, counts: I64) -> F64:
        """`ks_distances` of counts, shape (dim, BINS), from those of training, (dim,)."""
        return np.asarray(np.abs(_cumulative(counts) - self._shares).max(axis=-1), np.float64)

    def summary(self) -> dict[str, Any]:
        """The figures behind the limits, as plain JSON; `drift_words` says them."""
        return {
            "features": self.dim,
            "watched": int(np.count_nonzero(self.limits < 1)),
            "patches": int(self.counts[0].sum()),
            "window_frames": self.window_frames,
            "windows": self.windows,
            "stretches": self.stretches,
            "factor": self.factor,
            "median_limit": float(np.median(self.limits)),
        }


def quantile_edges(values: F64) -> F64:
    """The bins' edges for one feature: its quantiles at 1 / BINS, 2 / BINS, ...

    A value that fills a whole bin or more gets an edge just below and one just above it, so that
    moving away from it shows to either side.

    Parameters
    ----------
    values : array of float64, shape (n,)

    Returns
    -------
    numpy.ndarray
        float64, shape (BINS - 1,), rising.
    """
    levels = np.arange(1, BINS) / BINS
    edges = np.quantile(values, levels, method="inverted_cdf")
    slack = _SAME * np.maximum(1.0, np.abs(edges))
    again = np.diff(edges) == 0
    first = np.append(again, False) & ~np.append(False, again)
    lower, upper = edges - slack, edges + slack
    edges = np.where(first, lower, np.where(np.append(False, again), upper, edges))
    return np.asarray(np.maximum.accumulate(edges), np.float64)


def bin_counts(features: F64, edges: F64) -> I64:
    """How many values of each feature fall into each bin.

    A binary search over all features at once: `numpy.searchsorted` takes one list of edges only,
    and a call a feature costs three times as much.

    Parameters
    ----------
    features : array of float64, shape (n, dim)
    edges : array of float64, shape (dim, BINS - 1)

    Returns
    -------
    numpy.ndarray
        int64, shape (dim, BINS).
    """
    dim = len(edges)
    at = np.empty(features.shape, np.int64)
    at[:] = np.arange(dim) * (BINS - 1)
    edge, flat, step = np.empty(features.shape), edges.ravel(), BINS // 2
    while step:
        # Never out of bounds; "clip" only spares numpy a copy.
        np.take(flat, at + (step - 1), out=edge, mode="clip")
        at += step * (edge < features)
        step //= 2
    at += np.arange(dim)
    return np.bincount(at.ravel(), minlength=dim * BINS).reshape(dim, BINS)


def ks_distances(counts: I64, others: I64) -> F64:
    """Largest difference of two cumulative distributions over the same bins.

    Parameters
    ----------
    counts, others : array of int64, shape (..., BINS)
        Each with something in it.

    Returns
    -------
    numpy.ndarray
        float64, shape (...), 0 to 1.
    """
    difference = _cumulative(counts) - _cumulative(others)
    return np.asarray(np.abs(difference).max(axis=-1), np.float64)


def _cumulative(counts: I64) -> F64:
    up_to = np.cumsum(counts, axis=-1)
    return np.asarray(up_to / up_to[..., -1:])


def drift_words(summary: Mapping[str, Any] | None) -> str:
    """What is known of a model's training distribution, if it has one, and its limits, in words."""
    if summary is None:
        return (
            "Input drift is not known for this model: it holds no distribution of its training "
            "features."
        )
    stretches = summary["stretches"]
    return (
        f"The runtime compares the last {summary['window_frames']} judged frames with "
        f"{summary['patches']} training patches, feature by feature (Kolmogorov-Smirnov distance, "
        f"0 to 1). It warns when a feature is out of range. A frame that has most features out of "
        f"range by itself is never clear. A limit is {summary['factor']:.2f} times the feature's "
        f"typical distance (median limit {summary['median_limit']:.2f}; {summary['watched']} of "
        f"{summary['features']} are below 1). That factor is the largest that any of "
        f"{summary['windows']} windows of consecutive training frames had from all others while it "
        f"was held back. {stretches} of these windows have no frame in common. So at least one "
        f"stretch of such frames in {stretches + 1} is to be expected out of range as well. In "
        "simulated dives that change slowly, two to six times as many were. Limits hold at the "
        "frame rate of the training missions. A stretch unlike any of them, such as one that comes "
        "closer, is out of range and is meant to be."
    )
