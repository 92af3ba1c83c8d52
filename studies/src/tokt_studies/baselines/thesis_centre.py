"""Centre, box and message of a mask as the thesis's program computes them, faults included.

Figures 3.22 to 3.24. Read from the published program (``imageTools.py`` and
``simulation_disparity.py`` of AURlabCVsimulator): the mask is dilated once by 5x5 ones; the centre
is the area-weighted mean of the outer contours' rounded centroids, cut to whole pixels; Ypos is
computed from the centre's x; the box's corner is the least x and the least y, but these start from
the frame's height and width in the wrong order, and its size is the *sum* of the contours' widths
and the *sum* of their heights.

::

    corrected box               the thesis's box
    +---------------+           +-----+---------+---------   frame's edge
    |  +--+         |           |  +--+-------+-+----
    |  |a |   +--+  |           |  |a |   +--+| |    its width is a's and b's,
    |  +--+   |b |  |           |  +--+   |b || |    wherever the two are
    |         +--+  |           |  +------+--++ |
    +---------------+           +---------------+

The corrected way is `tokt.inference.verdict`; this one is only for showing the difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8
from tokt.inference.verdict import Box

Contours = Sequence[NDArray[Any]]


@dataclass(frozen=True)
class ThesisCentre:
    """Centre, box and message of a mask, as the thesis's program computes them.

    All in pixels of the mask: the centre (0, 0 of an empty one), its Xpos and Ypos, which is
    computed from cx, and the box, None without contours, which can leave the frame. The contours
    are counted after the dilation.
    """

    cx: int
    cy: int
    x: int
    y: int
    box: Box | None
    contours: int


def dilated(mask: U8) -> U8:
    """The mask as the thesis's program looks for contours in it."""
    return np.asarray(cv2.dilate(mask, np.ones((5, 5), np.uint8)), np.uint8)


def outer_contours(mask: U8) -> Contours:
    """Outer contours of a mask of uint8 0/255, shape (height, width)."""
    return cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]


def thesis_centre(mask: U8) -> ThesisCentre:
    """Centre, box and message of a mask of uint8 0/255, shape (height, width).

    What is dilated encloses an area, so that here nothing is divided by zero.
    """
    height, width = mask.shape
    contours = outer_contours(dilated(mask))
    cx, cy = _centre(contours)
    x, y = -(cx - width // 2), -(cx - height // 2)
    box = _box(contours, height, width) if contours else None
    return ThesisCentre(cx, cy, x, y, box, len(contours))


def _centre(contours: Contours) -> tuple[int, int]:
    if not contours:
        return 0, 0
    areas = np.array([cv2.contourArea(contour) for contour in contours])
    moments = [cv2.moments(contour) for contour in contours]
    places = np.array(
        [(round(one["m10"] / one["m00"]), round(one["m01"] / one["m00"])) for one in moments]
    )
    cx, cy = (areas[:, None] * places / areas.sum()).sum(axis=0)
    return int(cx), int(cy)


def _box(contours: Contours, height: int, width: int) -> Box:
    boxes = np.array([cv2.boundingRect(contour) for contour in contours])
    (x0, y0), (w, h) = boxes[:, :2].min(axis=0), boxes[:, 2:].sum(axis=0)
    return min(int(x0), height), min(int(y0), width), int(w), int(h)


def leaves_frame(box: Box, height: int, width: int) -> bool:
    """Whether a box reaches beyond a frame of `height` x `width` pixels."""
    x0, y0, w, h = box
    return x0 + w > width or y0 + h > height
