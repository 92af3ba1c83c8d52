"""SLIC superpixels, the texture of each, and a LinearSVC: the thesis's first texture method.

A superpixel has an outline, and texture features want a rectangle. The thesis's program took the
upright *rectangle around the outline*, with whatever of the neighbouring superpixels lies in it;
nothing is masked out. It trained on the rectangles of superpixels that had been eroded twice and
dilated four times, and judged those of superpixels as they are. The mask is painted rectangle by
rectangle, white for an obstacle and black for ocean, so that a later rectangle paints over an
earlier one where they overlap. All of that is so here. Two differences are the libraries': OpenCV
of that time left the outermost pixel of a picture out of its outlines, and the classifier was
given the classes by name.

References
----------
L. S. Brusletto, *Computer Vision Based Obstacle Avoidance for a Remotely Operated Vehicle*,
NTNU 2016, and its program AURlabCVsimulator.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.svm import LinearSVC

from tokt.features.common.errors import ToktError
from tokt.inference.verdict import verdict_from_mask

from .baseline import BaselineResult
from .superpixels import Box, outline_boxes, resized_bgr, superpixels
from .thesis_models import thesis_classifier
from .thesis_texture import DescribePatch

_ERODED, _DILATED = 2, 4
SOURCE = "Brusletto 2016"


class SlicTexture:
    """Judge frames superpixel by superpixel.

    Parameters
    ----------
    describe : callable
        Features of one gray rectangle, as in `tokt.studies.baselines.thesis_texture`.
    classifier : sklearn.svm.LinearSVC
        Predicts 1 for an obstacle.
    name : str
        Of the features, such as ``lbp_10_5``.
    """

    source = SOURCE

    def __init__(self, describe: DescribePatch, classifier: LinearSVC, name: str) -> None:
        self.describe, self.classifier = describe, classifier
        self.name = f"slic_{name}"
        self.title = f"SLIC superpixels, {name.replace('_', ' ')}"

    @classmethod
    def train(
        cls, ocean: NDArray[np.uint8], other: NDArray[np.uint8], describe: DescribePatch, name: str
    ) -> SlicTexture:
        """Train as the thesis's program does: on all superpixels of two images.

        Parameters
        ----------
        ocean, other : array of uint8, shape (height, width) or (height, width, 3)
            Open ocean, and anything else.
        describe, name
            As in `SlicTexture`.

        Raises
        ------
        ToktError
            If one of them leaves no superpixel with features.
        """
        rows: list[NDArray[np.float64]] = []
        labels: list[int] = []
        for label, image in enumerate((ocean, other)):
            described = [
                row
                for row in (_features(patch, describe) for patch in _training_patches(image))
                if row is not None
            ]
            if not described:
                which = ("ocean", "other")[label]
                raise ToktError(f"no superpixel of the {which} image has features to learn from")
            rows += described
            labels += [label] * len(described)
        classifier = thesis_classifier(np.array(rows), np.array(labels))
        return cls(describe, classifier, name)

    def segments(self, frame: NDArray[np.uint8]) -> NDArray[np.int64]:
        """The frame's superpixels: int64, shape (height, 360), numbered from 1."""
        return superpixels(resized_bgr(frame))

    def judge(
        self, left: NDArray[np.uint8], right: NDArray[np.uint8] | None, t_s: float
    ) -> BaselineResult:
        """Judge the left frame; see `Baseline.judge`."""
        picture = resized_bgr(left)
        mask = np.zeros(picture.shape[:2], np.uint8)
        seen = obstacles = 0
        cut = superpixels(picture)
        for number in np.unique(cut):
            for box in outline_boxes(np.where(cut == number, 255, 0).astype(np.uint8)):
                obstacle = self._is_obstacle(_gray(picture, box))
                seen, obstacles = seen + 1, obstacles + obstacle
                x, y, width, height = box
                mask[y : y + height, x : x + width] = 255 * obstacle
        words = f"{obstacles} of {seen} superpixels are not ocean"
        return BaselineResult(verdict_from_mask(mask, self.name), mask, words)

    def reset(self) -> None:
        """Nothing is kept from frame to frame."""

    def _is_obstacle(self, patch: NDArray[np.uint8]) -> bool:
        """What has no features is ocean, as in the thesis's program."""
        row = _features(patch, self.describe)
        if row is None:
            return False
        answer: Any = self.classifier.predict(row.reshape(1, -1))
        return bool(answer[0] == 1)


def _training_patches(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Gray rectangles around the superpixels of an image, these eroded and dilated before."""
    picture = resized_bgr(image)
    cut = superpixels(picture)
    patches = []
    for number in np.unique(cut):
        region = np.where(cut == number, 255, 0).astype(np.uint8)
        cleaned = cv2.dilate(cv2.erode(region, None, iterations=_ERODED), None, iterations=_DILATED)  # type: ignore[call-overload]
        patches += [_gray(picture, box) for box in outline_boxes(cleaned)]
    return patches


def _gray(picture: NDArray[np.uint8], box: Box) -> NDArray[np.uint8]:
    x, y, width, height = box
    cut_out = picture[y : y + height, x : x + width]
    return np.asarray(cv2.cvtColor(cut_out, cv2.COLOR_BGR2GRAY), np.uint8)


def _features(patch: NDArray[np.uint8], describe: DescribePatch) -> NDArray[np.float64] | None:
    """A rectangle's features; None where it is too small for them, or they are not finite."""
    try:
        row = describe(patch)
    except ValueError:  # mahotas finds no pair of pixels in it
        return None
    return row if np.isfinite(row).all() else None
