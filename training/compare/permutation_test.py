"""A paired permutation test: two models' verdicts are swapped, block by block.

If the models are alike, it makes no difference which of them judged a block: the difference seen
is then one of many that swapping gives. Whole blocks are swapped, as patches of a block are not
independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EXACT_BLOCKS = 12
_DRAWN = 9999
_ROUNDING = 1e-12


@dataclass(frozen=True)
class PermutationTest:
    """Result of a block permutation test.

    Parameters
    ----------
    p : float
        Share of swaps with a difference at least as large, in either direction.
    swaps : int
        How many were looked at.
    exact : bool
        Whether these were all there are.
    differing : int
        Blocks in which the two models' counts differ; only swapping these changes anything.
    least_p : float
        The smallest p that so many blocks can give, however large the difference.
    """

    p: float
    swaps: int
    exact: bool
    differing: int
    least_p: float


def permutation_test(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    figure: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    seed: int = 0,
) -> PermutationTest:
    """Paired permutation test of a figure that follows from counts summed over blocks.

    Parameters
    ----------
    first, second : arrays of float64, shape (blocks, ...)
        Counts of each block for each model.
    figure : callable
        From counts of shape (n, ...) to n figures.
    seed : int
        Of the swaps drawn where there are too many to look at all of them.

    References
    ----------
    Good (2005), Permutation, Parametric and Bootstrap Tests of Hypotheses, chapter 3.
    """
    change = (second - first).reshape(len(first), -1)
    differing = np.flatnonzero(change.any(axis=1))
    if not len(differing):
        return PermutationTest(1.0, 1, True, 0, 1.0)
    exact = len(differing) <= EXACT_BLOCKS
    swaps = _all_swaps(len(differing)) if exact else _drawn_swaps(len(differing), seed)
    shape = (len(swaps), *first.shape[1:])
    moved = (swaps @ change[differing]).reshape(shape)
    differences = figure(first.sum(axis=0) + moved) - figure(second.sum(axis=0) - moved)
    seen = figure(first.sum(axis=0)[None]) - figure(second.sum(axis=0)[None])
    as_large = int((np.abs(differences) >= abs(float(seen[0])) - _ROUNDING).sum())
    if exact:
        return PermutationTest(
            as_large / len(swaps), len(swaps), True, len(differing), 2 / 2 ** len(differing)
        )
    # The arrangement seen is one of those that could have been drawn.
    p = (as_large + 1) / (len(swaps) + 1)
    return PermutationTest(p, len(swaps), False, len(differing), 1 / (len(swaps) + 1))


def _all_swaps(blocks: int) -> NDArray[np.float64]:
    codes = np.arange(2**blocks)[:, None]
    return np.asarray((codes >> np.arange(blocks)) & 1, np.float64)


def _drawn_swaps(blocks: int, seed: int) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.integers(0, 2, (_DRAWN, blocks)), np.float64)


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values for how many questions were asked at once.

    References
    ----------
    Holm (1979), A Simple Sequentially Rejective Multiple Test Procedure, Scandinavian Journal of
    Statistics 6.
    """
    adjusted = [0.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(np.argsort(p_values, kind="stable").tolist()):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted
