"""SLIC superpixels as the thesis's program cut a frame into them.

It asked scikit-image for about 100 superpixels of a frame resized to width 360, after a Gaussian
blur of 5 pixels, everything else left at the library's defaults, and handed the frame over as
OpenCV has it, blue first. The library has changed since: today's stretches every frame to
0..1 before it weighs colour against place, so that the noise of a nearly black frame draws the
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

from .thesis_texture import GRID

N_SEGMENTS = 100
SIGMA_PX = 5.0
"""Blur of the resized frame before it is cut. Both numbers are the thesis's program's."""
COMPACTNESS = 10.0
"""The library's default: the colour difference (in Lab units) that counts as one step of place."""

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels of the resized frame."""


def resized_bgr(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The frame at the grid's width, three channels: uint8, (height, 360, 3)."""
    height, width = GRID.resized(*frame.shape[:2])
    small = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
    if small.ndim == 2:
        small = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    return np.asarray(small, np.uint8)


def superpixels(
    picture: NDArray[np.uint8], n_segments: int = N_SEGMENTS, sigma_px: float = SIGMA_PX
) -> NDArray[np.int64]:
    """Cut a picture into superpixels.

    Parameters
    ----------
    picture : array of uint8, shape (height, width, 3)
        Its first channel is taken for red, as scikit-image does.
    n_segments : int
        About how many.
    sigma_px : float
        Spread of the blur before, in pixels.

    Returns
    -------
    numpy.ndarray
        int64, shape (height, width): the number of each pixel's superpixel, from 1.
    """
    blurred = gaussian(picture.astype(np.float64) / 255, sigma_px, mode="reflect", channel_axis=-1)
    lab: NDArray[Any] = rgb2lab(blurred)
    stretch = float(np.ptp(lab)) or 1.0
    cut = slic(lab, n_segments, COMPACTNESS / stretch, sigma=0, convert2lab=False, channel_axis=-1)
    return np.asarray(cut, np.int64)


def outline_boxes(region: NDArray[np.uint8]) -> list[Box]:
    """Upright rectangles around every outline in a 0/255 picture of one superpixel."""
    outlines, _ = cv2.findContours(region, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in map(cv2.boundingRect, outlines)]
