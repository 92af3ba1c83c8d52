"""The libraries used as well as they can be: all patches of a frame counted and predicted at once.

The thesis asks its classifier patch by patch and counts with `numpy.histogram`; who only wants to
know what tokt's own code gains over the libraries has to compare with this.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels import reference
from tokt.inference.verdict import Verdict, verdict_from_mask

from .thesis_texture import GRID, resized_gray

DescribeAll = Callable[[NDArray[np.uint8]], NDArray[np.float64]]


def _lbp(gray: NDArray[np.uint8], points: int, radius: int) -> NDArray[np.float64]:
    counts = reference.lbp_counts(gray, GRID, points, radius, "patch")
    return np.asarray(counts / counts.sum(axis=1, keepdims=True))


def all_lbp_10_5(gray: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Normalised histograms of LBP (10, 5) of a gray picture's patches."""
    return _lbp(gray, 10, 5)


def all_lbp_24_8(gray: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Normalised histograms of LBP (24, 8) of a gray picture's patches."""
    return _lbp(gray, 24, 8)


def all_haralick(gray: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Haralick's 13 features of a gray picture's patches, without grey level 0."""
    return reference.haralick_features(gray, GRID, ignore_zeros=True)


def judge_at_once(frame: NDArray[np.uint8], describe_all: DescribeAll, classifier: Any) -> Verdict:
    """Judge a frame with one prediction for all its patches.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    describe_all : callable
        Features of a gray picture's patches.
    classifier : sklearn.svm.LinearSVC
        Predicts 1 for an obstacle.
    """
    gray = resized_gray(frame)
    obstacle = classifier.predict(describe_all(gray)) == 1
    return verdict_from_mask(GRID.paint(obstacle, *gray.shape), "libraries")
