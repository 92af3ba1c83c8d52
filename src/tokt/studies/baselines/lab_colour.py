"""The colour of superpixels and the nearest example: Rodriguez-Teiles and others on water.

As the method is known: the frame is cut into SLIC superpixels, each is described by its colour in
the Lab space, and a nearest-neighbour classifier that was given examples of water and of anything
else says which it is.

Ours, because the paper's text is not at hand: the colour is a histogram of each of the three
channels (`BINS` bins over all a channel can be, each summing to 1), examples and superpixels are
compared by the sum of squared differences, and the superpixels are cut as for the thesis's
method (`superpixels`) rather than with the paper's own changed SLIC. What follows in the paper,
joining superpixels of water to a way that is free, is left out: the status is that of the mask.

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

from tokt.features.common.arrays import F64, I64, U8, Bools
from tokt.features.common.errors import ToktError

from .slic import resized_bgr, superpixels
from .thesis_texture import GRID

BINS = 32
"""Bins a channel: 8 steps of Lab in OpenCV's 0..255."""
_LEVELS = 256
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
    """Judge frames by the colour of their superpixels; `classifier` predicts 1 for an obstacle."""

    name = "lab_colour"
    title = "SLIC superpixels, Lab colour"
    source = "Rodriguez-Teiles and others 2014"

    def __init__(self, classifier: KNeighborsClassifier) -> None:
        self._classifier = classifier

    @classmethod
    def train(cls, examples: Iterable[Example]) -> LabColour:
        """Learn the superpixels of frames whose obstacles are known.

        A superpixel of which half or more is not known is left out. Raises ToktError if the
        examples do not show both obstacles and clear water.
        """
        rows: list[F64] = []
        flags: list[Bools] = []
        for frame, truth in examples:
            picture = resized_bgr(frame)
            cut = _counted(superpixels(picture))
            size = cut.shape[1], cut.shape[0]
            small = cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST)
            known = _means(small >= 0, cut) > _MOSTLY
            rows.append(_colours(picture, cut)[known])
            flags.append((_means(small == 1, cut) >= _MOSTLY)[known])
        targets = np.concatenate(flags) if flags else np.zeros(0, bool)
        if targets.all() or not targets.any():
            raise ToktError("the colour examples do not show both obstacles and clear water")
        classifier = KNeighborsClassifier(n_neighbors=1, algorithm="brute")
        classifier.fit(np.concatenate(rows), targets.astype(int))
        return cls(classifier)

    @classmethod
    def train_on_two(cls, ocean: U8, other: U8) -> LabColour:
        """Learn as the thesis's methods do: one image of open ocean, one of anything else."""
        return cls.train(
            (image, np.full(image.shape[:2], obstacle, np.int8))
            for image, obstacle in ((ocean, 0), (other, 1))
        )

    def mask(self, frame: U8) -> U8:
        """255 where a decoded frame shows an obstacle, at the grid's width."""
        picture = resized_bgr(frame)
        cut = _counted(superpixels(picture))
        obstacle = self._classifier.predict(_colours(picture, cut)) == 1
        return np.where(obstacle[cut], 255, 0).astype(np.uint8)


def _counted(cut: I64) -> I64:
    """The superpixels counted from 0 without gaps."""
    return np.unique(cut, return_inverse=True)[1].reshape(cut.shape)


def _means(values: Bools, cut: I64) -> F64:
    """Part of each superpixel that is true, (n,)."""
    total = np.bincount(cut.ravel(), values.ravel())
    return np.asarray(total / np.bincount(cut.ravel()), np.float64)


def _colours(picture: U8, cut: I64) -> F64:
    """Histograms of the channels of Lab over each superpixel, (n, 3 * `BINS`)."""
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)
    places = cut.ravel()
    n = int(places.max()) + 1
    sizes = np.bincount(places)[:, None]
    channels = []
    for channel in range(3):
        levels = lab[..., channel].ravel().astype(np.int64) * BINS // _LEVELS
        counts = np.bincount(places * BINS + levels, minlength=n * BINS).reshape(n, BINS)
        channels.append(counts / sizes)
    return np.concatenate(channels, axis=1)
