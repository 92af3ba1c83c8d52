"""Keypoints that grow: Mori and Scherer's test for something ahead that comes nearer.

As the thesis tells it: keypoints (SURF) of a frame are matched with those of one before, and by
template matching the picture around each is held against the other at several relative sizes.
What grew comes nearer.

Ours: the sizes tried (`SCALES`), when one fits clearly better than none (`GROWN`, `CLEARLY`), and
how many keypoints make an obstacle; SIFT in place of SURF, which free builds of OpenCV do not have;
the local contrast is made even first, as the frames are nearly black; a frame is held against the
one `BACK` judged frames before, as a slow vehicle's frames change by a few per cent from one to
the next. What keeps its size, or shrinks, is no obstacle to it. A frame with none before is
unknown.

References
----------
T. Mori and S. Scherer, *First results in detecting and avoiding frontal obstacles from a monocular
camera for micro unmanned aerial vehicles*, IEEE International Conference on Robotics and
Automation, 2013.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, unknown_verdict, verdict_from_mask
from tokt.training.rig.calibrate.matching import even_contrast_gaussian, mutual_matches, view_scale

from .mean_disparity import NO_PICTURE
from .thesis_texture import GRID

BACK = 4
MIN_KEYPOINTS = 5
"""Keypoints. In the sea trial's frames of open water one grows by chance in every second frame,
four at the most in 126 frames: this number was chosen on them."""
SCALES = np.arange(1.0, 1.51, 0.1)
GROWN = 1.2
CLEARLY = 0.8
_RATIO = 0.8
"""Lowe's: how much nearer the best match is than the second."""
_MAX_FEATURES = 2000
_MIN_HALF_PX, _MAX_HALF_PX = 6, 40
"""Half the side of the picture around a keypoint, before it is enlarged."""


@dataclass(frozen=True)
class _RememberedFrame:
    """The keypoints remembered of a frame."""

    view: U8
    places: F64
    sizes: F64
    looks: F32


_Grown = tuple[F64, float]
"""A keypoint of an obstacle in the later view: its x and y and the radius of what it stands for,
in pixels."""


class SizeChange:
    """Judge frames by keypoints that grew since `back` judged frames before."""

    name = "size_change"

    def __init__(self, back: int = BACK) -> None:
        self._before: deque[_RememberedFrame] = deque(maxlen=back)
        self._sift = cv2.SIFT.create(_MAX_FEATURES)

    def judge(self, frame: Frame) -> Judgement:
        """Judge the left frame of a run, in their order."""
        if frame.left is None:
            return Judgement(NO_PICTURE)
        now = self._look(frame.left)
        before = self._before[0] if len(self._before) == self._before.maxlen else None
        self._before.append(now)
        if before is None or before.view.shape != now.view.shape:
            fault = Fault(Reason.FRAME_RULE, "no frame to compare with yet")
            return Judgement(unknown_verdict(fault))
        found, picture = _grown(before, now), np.zeros(now.view.shape, np.uint8)
        for (x, y), radius in found:
            cv2.circle(picture, (round(x), round(y)), max(round(radius), 1), 255, cv2.FILLED)
        size = GRID.resized(*frame.left.shape[:2])[::-1]
        mask = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        status = OBSTACLE if len(found) >= MIN_KEYPOINTS else CLEAR
        return Judgement(replace(verdict_from_mask(mask, self.name), status=status), mask=mask)

    def _look(self, frame: U8) -> _RememberedFrame:
        gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        scale = view_scale(frame.shape[1])
        small = cv2.resize(
            gray.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
        )
        view = even_contrast_gaussian(np.asarray(small, np.float32))
        found: tuple[Any, Any] = self._sift.detectAndCompute(view, None)
        keypoints, looks = found
        if looks is None:
            looks = np.zeros((0, 128), np.float32)
        places = np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2)
        sizes = np.array([keypoint.size for keypoint in keypoints], np.float64)
        return _RememberedFrame(view, places, sizes, looks)


def _grown(before: _RememberedFrame, now: _RememberedFrame) -> list[_Grown]:
    """The keypoints of `before` that are in `now` and became clearly larger."""
    found = []
    for earlier, later in mutual_matches(before.looks, now.looks, _RATIO):
        if now.sizes[later] <= before.sizes[earlier]:
            continue
        half = int(np.clip(round(before.sizes[earlier]), _MIN_HALF_PX, _MAX_HALF_PX))
        scale = enlargement(before.view, before.places[earlier], now.view, now.places[later], half)
        if scale >= GROWN:
            found.append((now.places[later], half * scale))
    return found


def enlargement(earlier: U8, earlier_at: F64, later: U8, later_at: F64, half_px: int) -> float:
    """How many times larger the picture around one place (x, y) is around another one, later.

    One of `SCALES`; 1 where no enlargement fits clearly better than none. `half_px` is half the
    side of the square of `earlier` that is compared.
    """
    side = 2 * half_px + 1
    template = cv2.getRectSubPix(earlier, (side, side), tuple(map(float, earlier_at)))
    differences = []
    for scale in SCALES:
        larger = round(side * scale)
        enlarged = cv2.resize(template, (larger, larger), interpolation=cv2.INTER_LINEAR)
        there = cv2.getRectSubPix(later, (larger, larger), tuple(map(float, later_at)))
        differences.append(float(np.mean((enlarged.astype(np.float64) - there) ** 2)))
    best = int(np.argmin(differences))
    clearly = differences[best] < CLEARLY * differences[0]
    return float(SCALES[best]) if clearly else 1.0
