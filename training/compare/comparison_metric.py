"""The metric that models are compared by, from counts that add up over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bootstrap import class_counts, f1, macro_f1, obstacle_counts


@dataclass(frozen=True)
class ComparisonMetric:
    """F1 of the obstacles, or the mean F1 of several classes.

    Parameters
    ----------
    classes : int
        Macro-F1 of so many classes; 0 for F1 of the obstacles.
    """

    classes: int = 0

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
        self,
        targets: NDArray[np.int64],
        predicted: NDArray[np.int64],
        truth: NDArray[np.bool_],
        said: NDArray[np.bool_],
        block: NDArray[np.int64],
        blocks: int,
    ) -> NDArray[np.float64]:
        """Counts of each block.

        Parameters
        ----------
        targets, predicted : arrays of int, shape (n_patches,)
            Index of the class that is labelled, and that the model says.
        truth, said : arrays of bool, shape (n_patches,)
            Whether these classes are obstacles.
        block : array of int, shape (n_patches,)
        blocks : int
        """
        if self.classes:
            return class_counts(targets, predicted, self.classes, block, blocks)
        return obstacle_counts(truth, said, block, blocks)

    def figure(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """The figure, from summed counts."""
        return macro_f1(counts) if self.classes else f1(counts)
