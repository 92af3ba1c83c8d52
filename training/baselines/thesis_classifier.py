"""The classifier of the thesis, as its scikit-learn of 2016 fitted it."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.svm import LinearSVC

PENALTY, SEED = 100.0, 42
"""C and random_state, the two that the thesis's program sets."""


def thesis_classifier(rows: NDArray[np.float64], obstacle: NDArray[np.int64]) -> LinearSVC:
    """A LinearSVC as the thesis fits it: C = 100, seed 42, unscaled features.

    What it leaves to scikit-learn is written out as its release of 2016 had it: the dual problem,
    at most 1000 iterations. Unscaled Haralick features do not converge in these.

    Parameters
    ----------
    rows : array of float64, shape (n, dim)
    obstacle : array of int, shape (n,)
        1 for an obstacle, 0 for ocean.
    """
    classifier = LinearSVC(C=PENALTY, random_state=SEED, dual=True, max_iter=1000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier.fit(rows, obstacle)
    return classifier
