"""Rectification: views of two cameras in which a thing stands in the same row of both.

Everything that depends on the calibration alone is worked out once: the maps of both views, and
where each pixel of the left frame lies in the left view.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.frame_pictures import scaled_gray
from tokt.inference.config import DEFAULT_SCALE

from .calibration import StereoCalibration

_MIN_IN_VIEW = 0.5  # part of the left frame that has to lie inside its rectified view


def rectifying(calibration: StereoCalibration) -> tuple[F64, ...]:
    """Both rectifying rotations (3, 3) and projections (3, 4): R1, R2, P1, P2."""
    known = calibration
    cameras = known.K1, known.D1, known.K2, known.D2, known.frame_size, known.R, known.T_mm
    found = cv2.stereoRectify(*cameras, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1)
    return tuple(np.asarray(one, np.float64) for one in found[:4])


def rectified(points: NDArray[Any], K: F64, D: F64, R: F64, P: F64) -> F64:
    """Where points (n, 2) of a camera's frame lie in its rectified view, both in pixels."""
    seen = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
    if not len(seen):
        return np.empty((0, 2))
    # By default it stops after 5 steps, which strong distortion at the edge outlasts.
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    places = cv2.undistortPoints(seen, K, D, None, R, P, criteria)
    return np.asarray(places, np.float64).reshape(-1, 2)


class Rectifier:
    """Rectified gray views of pairs of frames.

    Parameters
    ----------
    calibration : StereoCalibration
    scale : float
        Width of the views over the frames' width, above 0 and at most 1.

    Attributes
    ----------
    size : (width, height) of int
        Of the views, in pixels.
    focal_px : float
        Focal length of both views in their pixels.
    principal : (float, float)
        Principal point of the views in pixels.
    focal_baseline_px_m : float
        Depth in metres along the views' axis is this over the disparity in pixels.
    left_inside, right_inside : array of bool, shape (height, width) of `size`
        Where a view shows its frame, and not what lies beyond the frame's edge.

    Raises
    ------
    ToktError
        If the calibration moves most of the left frame out of view, or has the cameras exchanged.
    """

    def __init__(self, calibration: StereoCalibration, scale: float = DEFAULT_SCALE) -> None:
        if not 0 < scale <= 1:
            raise ToktError(f"views are scaled by more than 0 and at most 1, not {scale}")
        self.calibration = calibration
        self.scale = scale
        width, height = calibration.frame_size
        self.size = (max(round(width * scale), 1), max(round(height * scale), 1))
        # Odd frames: the two sides are scaled by slightly different ratios.
        self._ratio = np.array([self.size[0] / width, self.size[1] / height])
        self._rectify()
        if not self.focal_baseline_px_m > 0:
            raise ToktError("by the calibration the right camera is not right of the left one")
        self._places: dict[tuple[int, int], F32] = {}
        if self._inside(self._frame_places(9, 9)).mean() < _MIN_IN_VIEW:
            raise ToktError("the calibration moves most of the left frame out of view")

    def _rectify(self) -> None:
        """The maps from frames scaled to `size` to the views, and what describes the views."""
        known = self.calibration
        wide, high = self._ratio  # pixel centres have whole-number coordinates at either scale
        to_view = np.array([[wide, 0, (wide - 1) / 2], [0, high, (high - 1) / 2], [0, 0, 1]])
        K1, K2 = to_view @ known.K1, to_view @ known.K2
        R1, R2, P1, P2 = rectifying(replace(known, K1=K1, K2=K2, frame_size=self.size))
        self.rotations, self.projections = (R1, R2), (P1, P2)
        self.focal_px = float(P1[0, 0])
        self.principal = (float(P1[0, 2]), float(P1[1, 2]))
        self.focal_baseline_px_m = float(-P2[0, 3]) / 1000
        sides = ((K1, known.D1, R1, P1), (K2, known.D2, R2, P2))
        maps = [
            cv2.initUndistortRectifyMap(K, D, R, P, self.size, cv2.CV_32FC1) for K, D, R, P in sides
        ]
        self.left_inside, self.right_inside = (self._inside(places) for places in maps)
        self._left_map = [_within(*places) for places in zip(maps[0], self.size, strict=True)]
        self._right_x, self._right_y = _within(maps[1][0], self.size[0]), maps[1][1]
        self._moved_down = math.nan, self._right_y

    def left(self, frame: U8) -> F32:
        """The left view, float32, of `size`; beyond the frame's edge its last pixel."""
        return self.left_of(scaled_gray(frame, self.size))

    def right(self, frame: U8, row_shift_px: float = 0.0) -> F32:
        """The right view, moved down by `row_shift_px` pixels of the full resolution."""
        return self.right_of(scaled_gray(frame, self.size), row_shift_px)

    def left_of(self, scaled: F32) -> F32:
        """The left view of a picture that is gray and of the views' size (`scaled_gray`)."""
        return _moved(scaled, *self._left_map)

    def right_of(self, scaled: F32, row_shift_px: float = 0.0) -> F32:
        """The right view of such a picture."""
        if row_shift_px != self._moved_down[0]:
            y = self._right_y - np.float32(row_shift_px * self._ratio[1])
            self._moved_down = row_shift_px, _within(y, self.size[1])
        return _moved(scaled, self._right_x, self._moved_down[1])

    def from_frame(self, points: NDArray[Any]) -> F64:
        """Where points of the left frame lie in the left view, both in pixels, shape (n, 2)."""
        known = self.calibration
        return rectified(points, known.K1, known.D1, self.rotations[0], self.projections[0])

    def to_frame(self, points: NDArray[Any]) -> F64:
        """Where points of the left view lie in the left frame, both in pixels, shape (n, 2)."""
        ray = (np.asarray(points, np.float64).reshape(-1, 2) - self.principal) / self.focal_px
        rays = np.column_stack([ray, np.ones(len(ray))]) @ self.rotations[0]
        if not len(rays):
            return np.empty((0, 2))
        none = np.zeros(3)
        seen, _ = cv2.projectPoints(rays, none, none, self.calibration.K1, self.calibration.D1)
        return np.asarray(seen, np.float64).reshape(-1, 2)

    def points_m(self, disparity_px: NDArray[Any], valid: Bools) -> F64:
        """The points seen, in the left camera's own axes.

        Parameters
        ----------
        disparity_px : array of float, shape (height, width) of `size`
        valid : array of bool, same shape
            Which pixels to take.

        Returns
        -------
        array of float64, shape (n, 3)
            Metres: x right, y down, z along the left camera's axis; row by row of `valid`.
        """
        row, column = np.nonzero(valid)
        depth = self.focal_baseline_px_m / disparity_px[row, column].astype(np.float64)
        x = (column - self.principal[0]) / self.focal_px * depth
        y = (row - self.principal[1]) / self.focal_px * depth
        return np.asarray(np.column_stack([x, y, depth]) @ self.rotations[0], np.float64)

    def to_left(self, view: NDArray[Any], height: int, width: int) -> U8:
        """A mask of the left view as it looks in the left frame resized to `height` x `width`.

        Parameters
        ----------
        view : array of uint8 or bool, shape (height, width) of `size`

        Returns
        -------
        array of uint8, shape (height, width)
            The nearest pixel's value, or 0 outside the view.
        """
        key = (height, width)
        if key not in self._places:
            places = self._frame_places(height, width)
            self._places[key] = np.ascontiguousarray(places, np.float32)
        x, y = self._places[key]
        mask = cv2.remap(np.asarray(view, np.uint8), x, y, cv2.INTER_NEAREST)  # beyond the edge 0
        return np.asarray(mask, np.uint8)

    def _frame_places(self, height: int, width: int) -> F64:
        """For each pixel of the left frame resized so, its place in the view: (2, h, w)."""
        frame_width, frame_height = self.calibration.frame_size
        rows, columns = np.indices((height, width), np.float64)
        x = (columns + 0.5) * frame_width / width - 0.5
        y = (rows + 0.5) * frame_height / height - 0.5
        return self.from_frame(np.stack([x, y], axis=-1)).T.reshape(2, height, width)

    def _inside(self, places: Iterable[NDArray[Any]]) -> Bools:
        """Which places (x and y) lie in a picture of `size`."""
        x, y = places
        return np.asarray((x >= 0) & (x <= self.size[0] - 1) & (y >= 0) & (y <= self.size[1] - 1))


def _within(places: NDArray[Any], end: int) -> NDArray[Any]:
    """What lies beyond the picture's edge moved to it; OpenCV's own border takes a third longer."""
    return np.asarray(places.clip(0, end - 1), np.float32)


def _moved(picture: F32, x: NDArray[Any], y: NDArray[Any]) -> F32:
    view = cv2.remap(picture, x, y, cv2.INTER_LINEAR)
    return np.asarray(view, np.float32)
