"""The colour of superpixels and the nearest example: Rodriguez-Teiles and others on water.

As the thesis tells it (section 2.11): the frame is cut into SLIC superpixels, each is described by
two feature vectors of the channels a and b of Lab, their standard deviation and their normalised
sum of squared differences (SSD), and Euclidean distance to examples says which class it is.

Ours, because that is all it tells: the SSD is against the mean colour of the examples' water and
divided by the root of both sums of squares, all four numbers are scaled to the examples' spread,
and the nearest example decides. The superpixels are those of the thesis's own method.

References
----------
A. Rodriguez-Teiles and others, *Vision-based reactive autonomous navigation with obstacle
avoidance: towards a non-invasive and cautious exploration of marine habitat*, IEEE International
Conference on Robotics and Automation, 2014.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.errors import ToktError

from .slic import resized_bgr, superpixels
from .thesis_texture import GRID

_MOSTLY = 0.5
"""Part of a superpixel that must be obstacle for an example to be one."""

Example = tuple[U8, NDArray[np.int8]]
"""A frame, and of each of its pixels 1 where there is an obstacle, 0 where there is none, -1 where
nobody knows."""


def labelled_example(frame: U8, patches: NDArray[np.int8]) -> Example:
    """A frame with labels of its patches: int8, (n_patches,), by pixel."""
    truth = np.full(frame.shape[:2], -1, np.int8)
    for label, (y0, y1, x0, x1) in zip(patches, GRID.boxes(*frame.shape[:2]), strict=True):
        truth[y0:y1, x0:x1] = label
    return frame, truth


class LabColour:
    """Judge frames by the colour of their superpixels.

    `water` is the mean a and b of open water; `classifier` predicts 1 for an obstacle.
    """

    name = "lab_colour"
    title = "SLIC superpixels, Lab colour"
    source = "Rodriguez-Teiles and others 2014"

    def __init__(self, classifier: Pipeline, water: F64) -> None:
        self._classifier, self._water = classifier, water

    @classmethod
    def train(cls, examples: Iterable[Example]) -> LabColour:
        """Learn the superpixels of frames whose obstacles are known.

        A superpixel of which half or more is not known is left out. Raises ToktError if the
        examples do not show both obstacles and clear water.
        """
        cuts: list[tuple[F64, I64]] = []
        flags: list[I64] = []
        for frame, truth in examples:
            colours, cut = _cut(frame)
            size = cut.shape[1], cut.shape[0]
            small = cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST)
            obstacle = _means(small == 1, cut) >= _MOSTLY
            cuts.append((colours, cut))
            flags.append(np.where(_means(small >= 0, cut) > _MOSTLY, obstacle, -1))
        targets = np.concatenate(flags) if flags else np.zeros(0, np.int64)
        if not {0, 1} <= set(targets.tolist()):
            raise ToktError("the colour examples do not show both obstacles and clear water")
        clear = [
            colours[(flag == 0)[cut]] for (colours, cut), flag in zip(cuts, flags, strict=True)
        ]
        water = np.concatenate(clear).mean(axis=0)
        rows = np.concatenate([_features(*one, water) for one in cuts])
        nearest = KNeighborsClassifier(n_neighbors=1, algorithm="brute")
        classifier = make_pipeline(StandardScaler(), nearest)
        classifier.fit(rows[targets >= 0], targets[targets >= 0])
        return cls(classifier, water)

    @classmethod
    def train_on_two(cls, ocean: U8, other: U8) -> LabColour:
        """Learn as the thesis's methods do: one image of open ocean, one of anything else."""
        return cls.train(
            (image, np.full(image.shape[:2], obstacle, np.int8))
            for image, obstacle in ((ocean, 0), (other, 1))
        )

    def mask(self, frame: U8) -> U8:
        """255 where a decoded frame shows an obstacle, at the grid's width."""
        colours, cut = _cut(frame)
        obstacle = self._classifier.predict(_features(colours, cut, self._water)) == 1
        return np.where(obstacle[cut], 255, 0).astype(np.uint8)


def _cut(frame: U8) -> tuple[F64, I64]:
    """A frame's a and b, (height, width, 2), and its superpixels, counted without gaps."""
    picture = resized_bgr(frame)
    cut = superpixels(picture)
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)[..., 1:].astype(np.float64)
    return lab, np.unique(cut, return_inverse=True)[1].reshape(cut.shape)


def _means(values: F64 | Bools, cut: I64) -> F64:
    """Mean of the values, (height, width), over each superpixel, (n,)."""
    total = np.bincount(cut.ravel(), values.ravel())
    return np.asarray(total / np.bincount(cut.ravel()), np.float64)


def _features(colours: F64, cut: I64, water: F64) -> F64:
    """Standard deviation and normalised SSD of a and b over each superpixel, (n, 4)."""
    columns = []
    for channel, level in zip(np.moveaxis(colours, -1, 0), water, strict=True):
        squares = _means(channel * channel, cut)
        spread = np.sqrt(np.maximum(squares - _means(channel, cut) ** 2, 0.0))
        differences = _means((channel - level) ** 2, cut)
        columns += [spread, differences / np.sqrt(np.maximum(squares, 1.0) * level**2)]
    return np.stack(columns, axis=1)
