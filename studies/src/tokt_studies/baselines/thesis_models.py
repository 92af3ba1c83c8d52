"""The thesis's models, trained as it trains: on one image of ocean, one of anything else."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from sklearn.exceptions import ConvergenceWarning
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import U8

from .thesis_texture import DESCRIBE, GRID, DescribePatch, ThesisTextureResult, judge, resized_gray

TITLES = {"lbp_10_5": "LBP (10, 5)", "lbp_24_8": "LBP (24, 8)", "haralick": "Haralick"}


@dataclass(frozen=True)
class TrainingImage:
    """One of the two decoded images that the thesis's models learn from, and which it is.

    `frame` is the mission's left frame it is, which is then not scored; None for another picture.
    """

    image: U8
    words: str
    frame: int | None = None


@dataclass(frozen=True)
class ThesisModel:
    """One of the thesis's texture models; its classifier predicts 1 for an obstacle."""

    name: str
    title: str
    describe: DescribePatch
    classifier: LinearSVC

    def judge(self, frame: U8) -> ThesisTextureResult:
        """Judge a decoded frame as the thesis does, patch by patch."""
        return judge(frame, self.describe, self.classifier)


def thesis_model(name: str, ocean: TrainingImage, other: TrainingImage) -> ThesisModel:
    """Train one of the thesis's models, by its name in `DESCRIBE`, on the two images' patches."""
    describe = DESCRIBE[name]
    rows = [
        [describe(np.ascontiguousarray(patch)) for patch in GRID.cells(resized_gray(part.image))]
        for part in (ocean, other)
    ]
    return ThesisModel(name, TITLES[name], describe, thesis_classifier(*rows))


def thesis_classifier(ocean: ArrayLike, other: ArrayLike) -> LinearSVC:
    """A LinearSVC as the thesis fits it: C = 100, seed 42, unscaled features.

    What it leaves to scikit-learn is written out as its release of 2016 had it: the dual problem,
    at most 1000 iterations. Unscaled Haralick features do not converge in these. The rows are
    (n, dim); what is other than ocean is 1.
    """
    obstacle = np.repeat([0, 1], [len(np.asarray(rows)) for rows in (ocean, other)])
    classifier = LinearSVC(C=100.0, random_state=42, dual=True, max_iter=1000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier.fit(np.concatenate([ocean, other]), obstacle)
    return classifier
