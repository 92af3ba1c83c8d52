"""Metrics from counts that add up over blocks of frames, and intervals by a block bootstrap.

Patches of one block stand or fall together, so blocks are what is independent, and drawn. A figure
of a draw follows from its blocks' counts; with two models the same blocks are drawn for both (a
paired block bootstrap).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from tokt.features.common.arrays import F64, I64, Bools

RESAMPLES = 2000
CONFIDENCE = 0.95
MAX_BLOCKS = 1000
_MAX_THRESHOLDS = 4096


@dataclass(frozen=True)
class Difference:
    """Difference of two models' F1 on the same patches, first less second."""

    f1_first: float
    f1_second: float
    difference: float
    low: float  # bounds of the difference at `CONFIDENCE`
    high: float
    blocks: int  # how many independent blocks that rests on
    verdict: str  # of the first against the second: better, worse or cannot tell


def block_numbers(groups: NDArray[np.object_]) -> tuple[list[str], I64]:
    """Names of the blocks in order, and the number of each patch's block.

    Beyond `MAX_BLOCKS` neighbours are joined: a thousand blocks say all there is to say about
    the spread, and each further one costs.
    """
    names, block = np.unique(groups, return_inverse=True)
    if len(names) > MAX_BLOCKS:
        joined = np.arange(len(names)) * MAX_BLOCKS // len(names)
        first = np.flatnonzero(np.diff(joined, prepend=-1))
        names, block = names[first], joined[block]
    return [str(name) for name in names], np.asarray(block, np.int64)


def obstacle_counts(truth: Bools, said: Bools, block: I64, blocks: int) -> F64:
    """True positives, false positives and false negatives of each block, shape (blocks, 3)."""
    kinds = (said & truth, said & ~truth, ~said & truth)
    return np.stack([np.bincount(block, kind, blocks) for kind in kinds], axis=1)


def f1(counts: F64) -> F64:
    """F1 from true positives, false positives, false negatives in the last axis; NaN of none."""
    hit, false, missed = np.moveaxis(counts, -1, 0)
    total = 2 * hit + false + missed
    return np.where(total > 0, 2 * hit / np.maximum(total, 1), np.nan)


def macro_f1(counts: F64) -> F64:
    """Mean F1 of the classes that are there, each with its `obstacle_counts` in the last axis."""
    present = counts[..., 0] + counts[..., 2] > 0
    per_class = np.where(present, np.nan_to_num(f1(counts)), 0.0)
    return np.asarray(per_class.sum(axis=-1) / np.maximum(present.sum(axis=-1), 1))


def ranked_counts(truth: Bools, score: F64, block: I64, blocks: int) -> F64:
    """Obstacle and clear patches between thresholds, best first, shape (blocks, thresholds, 2).

    The thresholds are the scores of the obstacle patches, at which alone precision counts for
    average precision; of more than a few thousand, quantiles of them.
    """
    thresholds = np.unique(score[truth])
    if len(thresholds) > _MAX_THRESHOLDS:
        thresholds = np.unique(
            np.quantile(thresholds, np.linspace(0, 1, _MAX_THRESHOLDS), method="lower")
        )
    # The best threshold comes first; what is below them all adds to no precision.
    place = len(thresholds) - np.searchsorted(thresholds, score, side="right")
    bins = len(thresholds) + 1
    flat = block * bins + place
    kinds = [
        np.bincount(flat, kind, blocks * bins).reshape(blocks, bins) for kind in (truth, ~truth)
    ]
    return np.stack(kinds, axis=2)[:, :-1].astype(np.float64)


def average_precision(counts: F64) -> F64:
    """Average precision from `ranked_counts` summed over blocks, shape (..., thresholds, 2)."""
    hit, false = counts[..., 0], counts[..., 1]
    hits = hit.cumsum(axis=-1)
    precision = hits / np.maximum(hits + false.cumsum(axis=-1), 1)
    total = hits[..., -1]
    return np.where(total > 0, (hit * precision).sum(axis=-1) / np.maximum(total, 1), np.nan)


def drawn_blocks(blocks: int, seed: int = 0, resamples: int = RESAMPLES) -> F64:
    """Counts of each block in each resample, shape (resamples, blocks)."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.multinomial(blocks, np.full(blocks, 1 / blocks), resamples), np.float64)


def summed(draws: F64, counts: F64) -> F64:
    """Counts of each resample, from counts of each block in the first axis."""
    return np.tensordot(draws, counts, axes=1)


def spread_of_ap(draws: F64, counts: F64) -> F64:
    """Average precision of each resample; a few at a time, as the counts are many."""
    parts = [average_precision(summed(part, counts)) for part in np.array_split(draws, 20)]
    return np.concatenate(parts)


def interval(spread: F64, blocks: int) -> dict[str, float] | None:
    """Low and high bound at `CONFIDENCE` from a figure's resampled values.

    None of too few blocks, or where most resamples have no value. Percentiles, further out the
    fewer blocks there are, as few blocks vary too little: Hesterberg (2015), What Teachers Should
    Know About the Bootstrap, The American Statistician 69, section 4.5.
    """
    found = spread[np.isfinite(spread)]
    if blocks < 2 or len(found) < len(spread) / 2:
        return None
    quantile = t.ppf((1 - CONFIDENCE) / 2, blocks - 1)
    tail = 100 * norm.cdf(quantile * np.sqrt(blocks / (blocks - 1)))
    low, high = np.percentile(found, [tail, 100 - tail])
    return {"low": float(low), "high": float(high)}


def compare_f1(
    truth: Bools, said_first: Bools, said_second: Bools, groups: NDArray[np.object_]
) -> Difference:
    """Compare two models' obstacle F1 on the same patches, (n_patches,) each, with their blocks.

    The verdict is "cannot tell" while the interval holds 0 (Efron and Tibshirani 1993, An
    Introduction to the Bootstrap, chapter 13).
    """
    names, block = block_numbers(groups)
    first = obstacle_counts(truth, said_first, block, len(names))
    second = obstacle_counts(truth, said_second, block, len(names))
    draws = drawn_blocks(len(names))
    bounds = interval(f1(summed(draws, first)) - f1(summed(draws, second)), len(names))
    low, high = (-1.0, 1.0) if bounds is None else bounds.values()
    whole = f1(np.stack([first.sum(axis=0), second.sum(axis=0)]))
    verdict = "better" if low > 0 else "worse" if high < 0 else "cannot tell"
    difference = float(whole[0] - whole[1])
    return Difference(float(whole[0]), float(whole[1]), difference, low, high, len(names), verdict)


@dataclass(frozen=True)
class ComparisonMetric:
    """F1 of the obstacles, or the mean F1 of several classes."""

    classes: int = 0  # macro-F1 of so many classes; 0 for F1 of the obstacles

    @classmethod
    def of(cls, obstacle: Sequence[bool]) -> ComparisonMetric:
        """Of classes, each an obstacle or not: F1 has a meaning for two on two sides alone."""
        return cls(
            0 if len(obstacle) == 2 and any(obstacle) and not all(obstacle) else len(obstacle)
        )

    @property
    def name(self) -> str:
        """As figures of merit are called in JSON."""
        return "macro_f1" if self.classes else "f1"

    @property
    def title(self) -> str:
        """As people call it."""
        return "macro-F1" if self.classes else "F1"

    def counts(
        self, targets: I64, predicted: I64, truth: Bools, said: Bools, block: I64, blocks: int
    ) -> F64:
        """Counts of each block, (blocks, 3) or (blocks, classes, 3).

        Of each patch the class that is labelled, the one that the model says, and whether these
        are obstacles.
        """
        if not self.classes:
            return obstacle_counts(truth, said, block, blocks)
        parts = [
            obstacle_counts(targets == index, predicted == index, block, blocks)
            for index in range(self.classes)
        ]
        return np.stack(parts, axis=1)

    def figure(self, counts: F64) -> F64:
        """The figure, from summed counts."""
        return macro_f1(counts) if self.classes else f1(counts)
