"""The thesis's models, trained as it trains: on one image of ocean, one of anything else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.svm import LinearSVC

from ..baselines.thesis_classifier import thesis_classifier
from ..bench.thesis_way import (
    GRID,
    DescribePatch,
    Judged,
    describe_haralick,
    describe_lbp_10_5,
    describe_lbp_24_8,
    judge,
    resized_gray,
)

DESCRIBE: dict[str, DescribePatch] = {
    "lbp_10_5": describe_lbp_10_5,
    "lbp_24_8": describe_lbp_24_8,
    "haralick": describe_haralick,
}
TITLES = {"lbp_10_5": "LBP (10, 5)", "lbp_24_8": "LBP (24, 8)", "haralick": "Haralick"}


@dataclass(frozen=True)
class TrainingImage:
    """One of the two images that the thesis's models learn from.

    Parameters
    ----------
    image : array of uint8, shape (height, width) or (height, width, 3)
        As decoded.
    words : str
        Which it is, for people.
    frame : int or None
        The mission's left frame it is, which is then not scored; None for another picture.
    """

    image: NDArray[np.uint8]
    words: str
    frame: int | None = None


@dataclass(frozen=True)
class ThesisModel:
    """One of the thesis's texture models.

    Parameters
    ----------
    name, title : str
    describe : callable
        Features of one gray patch.
    classifier : sklearn.svm.LinearSVC
        Predicts 1 for an obstacle.
    converged : bool
        Whether the solver stopped before its iteration limit.
    """

    name: str
    title: str
    describe: DescribePatch
    classifier: LinearSVC
    converged: bool

    def judge(self, frame: NDArray[np.uint8]) -> Judged:
        """Judge a decoded frame as the thesis does, patch by patch."""
        return judge(frame, self.describe, self.classifier)


def thesis_model(name: str, ocean: TrainingImage, other: TrainingImage) -> ThesisModel:
    """Train one of the thesis's models on the patches of the two images.

    Parameters
    ----------
    name : str
        One of `DESCRIBE`.
    ocean, other : TrainingImage
    """
    describe = DESCRIBE[name]
    rows = [
        [describe(np.ascontiguousarray(patch)) for patch in GRID.cells(resized_gray(part.image))]
        for part in (ocean, other)
    ]
    targets = np.repeat([0, 1], GRID.n_patches)
    classifier = thesis_classifier(np.vstack(rows), targets)
    converged = bool(np.max(classifier.n_iter_) < classifier.max_iter)
    return ThesisModel(name, TITLES[name], describe, classifier, converged)
