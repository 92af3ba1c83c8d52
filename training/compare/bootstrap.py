"""Is one model better than another, or can the data not tell? A paired test over blocks.

Patches of one block of frames stand or fall together, so whole blocks are drawn, with
replacement, the same ones for both models (a paired block bootstrap).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 5000
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Difference:
    """F1 of one model less F1 of another on the same patches.

    Parameters
    ----------
    f1_first, f1_second, difference : float
        On all patches.
    low, high : float
        Bounds of the difference at `CONFIDENCE`, by percentiles.
    blocks : int
        How many independent blocks that rests on.
    verdict : {"better", "worse", "cannot tell"}
        Of the first against the second.
    """

    f1_first: float
    f1_second: float
    difference: float
    low: float
    high: float
    blocks: int
    verdict: str


def _counts(
    truth: NDArray[np.bool_], said: NDArray[np.bool_], block: NDArray[np.int64], n_blocks: int
) -> NDArray[np.float64]:
    """True positives, false positives and false negatives of each block, shape (n_blocks, 3)."""
    kinds = (said & truth, said & ~truth, ~said & truth)
    return np.stack([np.bincount(block, kind, n_blocks) for kind in kinds], axis=1)


def _f1(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    hit, false, missed = np.moveaxis(counts, -1, 0)
    total = 2 * hit + false + missed
    return np.where(total > 0, 2 * hit / np.maximum(total, 1), np.nan)


def compare_f1(
    truth: NDArray[np.bool_],
    said_first: NDArray[np.bool_],
    said_second: NDArray[np.bool_],
    groups: NDArray[np.object_],
    seed: int = 0,
) -> Difference:
    """Compare two models' obstacle F1 on the same patches.

    Parameters
    ----------
    truth, said_first, said_second : arrays of bool, shape (n_patches,)
        Labels, and what each model said of patches it did not learn from.
    groups : array, shape (n_patches,)
        The block of each patch.
    seed : int
        Of the resampling.

    Returns
    -------
    Difference
        The verdict is "cannot tell" while the interval holds 0.

    References
    ----------
    Efron, Tibshirani (1993), An Introduction to the Bootstrap, chapter 13.
    """
    names, block = np.unique(groups, return_inverse=True)
    first = _counts(truth, said_first, block, len(names))
    second = _counts(truth, said_second, block, len(names))
    draws = np.random.default_rng(seed).integers(0, len(names), (RESAMPLES, len(names)))
    spread = _f1(first[draws].sum(axis=1)) - _f1(second[draws].sum(axis=1))
    tail = 100 * (1 - CONFIDENCE) / 2
    low, high = np.nanpercentile(spread, [tail, 100 - tail])
    whole = _f1(np.stack([first.sum(axis=0), second.sum(axis=0)]))
    verdict = "better" if low > 0 else "worse" if high < 0 else "cannot tell"
    difference = float(whole[0] - whole[1])
    return Difference(
        float(whole[0]), float(whole[1]), difference, float(low), float(high), len(names), verdict
    )
