"""SLIC superpixels, the texture of each, and a LinearSVC: the thesis's first texture method.

A superpixel has an outline, and texture features want a rectangle. The thesis's program took the
upright *rectangle around the outline*, with whatever of the neighbouring superpixels lies in it;
nothing is masked out. It trained on the rectangles of superpixels that had been eroded twice and
dilated four times, and judged those of superpixels as they are. The mask is painted rectangle by
rectangle, white for an obstacle and black for ocean, so that a later rectangle paints over an
earlier one where they overlap. All of that is so here. Two differences are the libraries': OpenCV
of that time left the outermost pixel of a picture out of its outlines, and the classifier was
given the classes by name.

The program asked scikit-image for about 100 superpixels of a frame resized to width 360, after a
Gaussian blur of 5 pixels, everything else left at the library's defaults, and handed the frame over
as OpenCV has it, blue first. The library has changed since: today's stretches every frame to 0..1
before it weighs colour against place, so that the noise of a nearly black frame draws the
outlines, and it blurs after the change to Lab. In the releases of that time it did neither. Here
both are undone: the blur and the change to Lab are done first, and the compactness is divided by
what today's library will divide the colours by. Which release the thesis used is not known; that
small superpixels are joined to their neighbours (``enforce_connectivity``) is the default of
today and of the later ones of that time.

References
----------
R. Achanta, A. Shaji, K. Smith, A. Lucchi, P. Fua and S. Suesstrunk, *SLIC superpixels compared to
state-of-the-art superpixel methods*, IEEE TPAMI 34(11), 2012.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2lab
from skimage.filters import gaussian
from skimage.segmentation import slic
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import F64, I64, U8
from tokt.features.common.errors import ToktError

from .thesis_models import TITLES, thesis_classifier
from .thesis_texture import GRID, DescribePatch

N_SEGMENTS = 100
SIGMA_PX = 5.0
"""Blur of the resized frame before it is cut. Both numbers are the thesis's program's."""
COMPACTNESS = 10.0
"""The library's default: the colour difference (in Lab units) that counts as one step of place."""

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels of the resized frame."""


def resized_bgr(frame: U8) -> U8:
    """The frame at the grid's width, three channels: uint8, (height, 360, 3)."""
    height, width = GRID.resized(*frame.shape[:2])
    small = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
    if small.ndim == 2:
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    return np.asarray(small, np.uint8)


def superpixels(picture: U8) -> I64:
    """The number of each pixel's superpixel, int64 (height, width), from 1, of some `N_SEGMENTS`.

    The first of the picture's three channels is taken for red, as scikit-image does.
    """
    blurred = gaussian(picture.astype(np.float64) / 255, SIGMA_PX, mode="reflect", channel_axis=-1)
    lab: NDArray[Any] = rgb2lab(blurred)
    stretch = float(np.ptp(lab)) or 1.0
    cut = slic(lab, N_SEGMENTS, COMPACTNESS / stretch, sigma=0, convert2lab=False, channel_axis=-1)
    return np.asarray(cut, np.int64)


def outline_boxes(region: U8) -> list[Box]:
    """Upright rectangles around every outline in a 0/255 picture of one superpixel."""
    outlines, _ = cv2.findContours(region, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in map(cv2.boundingRect, outlines)]


class SlicTexture:
    """Judge frames superpixel by superpixel.

    `describe` gives the features of one gray rectangle, `name` is theirs, such as ``lbp_10_5``;
    `classifier` predicts 1 for an obstacle.
    """

    source = "Brusletto 2016"

    def __init__(self, describe: DescribePatch, classifier: LinearSVC, name: str) -> None:
        self.describe, self.classifier = describe, classifier
        self.name = f"slic_{name}"
        self.title = f"SLIC + {TITLES.get(name, name)}"

    @classmethod
    def train(cls, ocean: U8, other: U8, describe: DescribePatch, name: str) -> SlicTexture:
        """Train as the thesis's program does: on all superpixels of two images.

        Raises ToktError if one of them leaves no superpixel with features.
        """
        rows = {}
        for which, image in (("ocean", ocean), ("other", other)):
            described = (_features(patch, describe) for patch in _training_patches(image))
            rows[which] = [row for row in described if row is not None]
            if not rows[which]:
                raise ToktError(f"no superpixel of the {which} image has features to learn from")
        return cls(describe, thesis_classifier(**rows), name)

    def mask(self, frame: U8) -> U8:
        """255 where a decoded frame shows an obstacle, at the grid's width."""
        picture = resized_bgr(frame)
        mask = np.zeros(picture.shape[:2], np.uint8)
        cut = superpixels(picture)
        for number in np.unique(cut):
            for box in outline_boxes(np.where(cut == number, 255, 0).astype(np.uint8)):
                row = _features(_gray(picture, box), self.describe)
                # What has no features is ocean, as in the thesis's program.
                obstacle = row is not None and self.classifier.predict(row.reshape(1, -1))[0] == 1
                x, y, width, height = box
                mask[y : y + height, x : x + width] = 255 * obstacle
        return mask


def _training_patches(image: U8) -> list[U8]:
    """Gray rectangles around the superpixels of an image, these eroded and dilated before."""
    picture = resized_bgr(image)
    cut = superpixels(picture)
    patches = []
    for number in np.unique(cut):
        region = np.where(cut == number, 255, 0).astype(np.uint8)
        cleaned = cv2.dilate(cv2.erode(region, None, iterations=2), None, iterations=4)  # type: ignore[call-overload]
        patches += [_gray(picture, box) for box in outline_boxes(cleaned)]
    return patches


def _gray(picture: U8, box: Box) -> U8:
    x, y, width, height = box
    cut_out = picture[y : y + height, x : x + width]
    return np.asarray(cv2.cvtColor(cut_out, cv2.COLOR_BGR2GRAY), np.uint8)


def _features(patch: U8, describe: DescribePatch) -> F64 | None:
    """A rectangle's features; None where it is too small for them, or they are not finite."""
    try:
        row = describe(patch)
    except ValueError:  # mahotas finds no pair of pixels in it
        return None
    return row if np.isfinite(row).all() else None
