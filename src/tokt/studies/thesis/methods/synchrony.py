r"""Synchrony of the two cameras, measured from the frames themselves.

A rectified pair has a thing in one row of both views, unless the right camera saw it earlier or
later and the vehicle heaved, pitched or rolled in between:

::

    row in the left view                 L(n), L(n-1), L(n+1): where a point is in the left view
       |            L(n+1)               of this frame, the one before and the one after
       |        R .                      R: where it is in the right view of frame n
       |   L(n) .                        offset d: R = L(n + d), L between frames by the parabola
       | .                               through its three places
       +----+--------+---- frame
        n-1 n       n+1

One offset is fitted to the points of many frames, with what a calibration leaves: rows that differ
by a constant, and by a share of the place in the view. No distance is needed, and a vehicle that
stands still tells nothing. The uncertainty is the delete-one jackknife over frames, since the
points of one frame err together.

References
----------
B. Efron, *The Jackknife, the Bootstrap and Other Resampling Plans*, SIAM 1982, chapter 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.rectify import rectified, rectifying
from tokt.training.rig.calibrate.matching import (
    even_contrast_gaussian,
    gray_view,
    match_frame,
    view_scale,
)

Float = NDArray[np.float64]

FARTHEST_FRAMES = 1.5
"""Offsets up to this are looked for: the parabola holds between the three frames."""
MIN_FRAMES = 4
"""Fewest frames with points that give an offset with an uncertainty."""
_POINTS_A_FRAME = 80
"""At most so many points of a frame: more of them err together, and one frame must not decide."""
_MIN_POINTS = 8
_ROW_NOISE_PX = 0.5
"""Residuals well above this count for less (soft L1). Source: the median row difference of matched
points after rectification is 0.4 px at full resolution."""
_WINDOW_PX, _LEVELS, _RETURN_PX = 21, 4, 0.5
_CONFIDENCE = 0.95


class Rows(NamedTuple):
    """Rows of matched points, in pixels of the full resolution, and the frame of each.

    Parameters
    ----------
    frame : array of int, shape (n,)
    left : array of float, shape (n, 3)
        Rows in the left view of the frame before, the frame, and the frame after.
    right : array of float, shape (n,)
        Row in the right view of the frame.
    place : array of float, shape (n, 2)
        Column and row in the left view less its middle, as parts of its width.
    """

    frame: NDArray[np.int64]
    left: Float
    right: Float
    place: Float

    def only(self, chosen: NDArray[np.bool_]) -> Rows:
        """Some of the points."""
        return Rows(self.frame[chosen], self.left[chosen], self.right[chosen], self.place[chosen])

    def moved_px(self, frames: float) -> Float:
        """Rows a frame by which each point moves over an offset, by its parabola."""
        before, here, after = self.left.T
        return np.asarray((after - before) / 2 + frames * ((after + before) / 2 - here))


@dataclass(frozen=True)
class Offset:
    """By how many frames the right camera is later than the left one.

    Parameters
    ----------
    frames : float
    error : float
        Standard error, by the jackknife over frames.
    half_width : float
        Of the 95 % confidence interval (Student's t).
    n_frames, n_points : int
    by_frame : array of float, shape (n_frames, 3)
        Frame number, median rows a frame that its points move over the offset, and median rows by
        which they differ between the views, less what the calibration leaves.
    """

    frames: float
    error: float
    half_width: float
    n_frames: int
    n_points: int
    by_frame: Float

    @property
    def at_the_end(self) -> bool:
        """Whether the offset is at the end of what is looked for, and may be larger."""
        return abs(self.frames) > FARTHEST_FRAMES - 0.01


class LateRight:
    """A mission whose right frames are those of `by` frames later, on purpose.

    Parameters
    ----------
    mission : Mission
    by : int
    """

    def __init__(self, mission: Mission, by: int) -> None:
        self._mission, self._by = mission, by
        self.name = mission.name
        self.path: Path = mission.path
        self.cameras = mission.cameras

    def frames(self, camera: str = LEFT) -> list[int]:
        """Frame numbers of one camera; of the right one those that have a later frame."""
        if camera == LEFT:
            return self._mission.frames(LEFT)
        later = {number - self._by for number in self._mission.frames(RIGHT)}
        return sorted(later & set(self._mission.frames(LEFT)))

    def read(self, frame: int, camera: str = LEFT) -> NDArray[np.uint8]:
        """A left frame, or the right frame of `by` frames later."""
        return self._mission.read(frame if camera == LEFT else frame + self._by, camera)

    def encoded(self, frame: int, camera: str = LEFT) -> tuple[bytes, str]:
        """The same as a file."""
        return self._mission.encoded(frame if camera == LEFT else frame + self._by, camera)


def rows_of(mission: Mission, calibration: StereoCalibration, frames: Sequence[int]) -> Rows:
    """Match and follow the points of some frames.

    Parameters
    ----------
    mission : Mission
    calibration : StereoCalibration
    frames : sequence of int
        Numbers that both cameras have. A frame without points that both cameras and both
        neighbours see, or without neighbours, is left out.
    """
    parts = [Rows(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0), np.empty((0, 2)))]
    for number in frames:
        part = _rows_of_frame(mission, calibration, number)
        if part is not None:
            parts.append(part)
    return Rows(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _rows_of_frame(mission: Mission, calibration: StereoCalibration, number: int) -> Rows | None:
    matched = match_frame(mission, number, calibration.frame_size)
    if matched is None:
        return None
    step = max(1, -(-len(matched) // _POINTS_A_FRAME))
    left, right = matched.left[::step], matched.right[::step]
    try:
        before, after = (_followed(mission, number, number + by, left) for by in (-1, 1))
    except FrameError:
        return None
    good = np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])
    if good.sum() < _MIN_POINTS:
        return None
    c = calibration
    R1, R2, P1, P2 = rectifying(c)
    focal_ratio = c.K1[0, 0] / P1[0, 0]
    seen = [rectified(p[good], c.K1, c.D1, R1, P1) for p in (before, left, after)]
    theirs = rectified(right[good], c.K2, c.D2, R2, P2)
    width, height = c.frame_size
    place = (seen[1] - np.array([width, height]) / 2) / width
    rows = np.column_stack([points[:, 1] for points in seen]) * focal_ratio
    return Rows(np.full(len(rows), number), rows, theirs[:, 1] * focal_ratio, place)


def _followed(mission: Mission, number: int, other: int, places: Float) -> Float:
    """Where points of a left frame are in another left frame; nan where they are lost."""
    (here, (width, _)), (there, _) = (gray_view(mission, n, LEFT) for n in (number, other))
    scale = view_scale(width)
    views = even_contrast_gaussian(here), even_contrast_gaussian(there)
    start = ((places + 0.5) * scale - 0.5).astype(np.float32)[:, None]
    found, seen = _flow(*views, start)
    back, again = _flow(*views[::-1], found)
    returned = np.linalg.norm((back - start)[:, 0], axis=1) / scale <= _RETURN_PX
    good = (seen.ravel() > 0) & (again.ravel() > 0) & returned
    exact = (found[:, 0].astype(np.float64) + 0.5) / scale - 0.5
    return np.where(good[:, None], exact, np.nan)


def _flow(
    here: NDArray[np.uint8], there: NDArray[np.uint8], start: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Where points go, and whether they are found there."""
    found, seen, _ = cv2.calcOpticalFlowPyrLK(
        here, there, start, start.copy(), winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=_LEVELS
    )
    return np.asarray(found, np.float32), np.asarray(seen, np.uint8)


def offset_of(rows: Rows) -> Offset:
    """Fit the offset to points.

    Raises
    ------
    ToktError
        If fewer than `MIN_FRAMES` frames have points.
    """
    numbers = np.unique(rows.frame)
    if len(numbers) < MIN_FRAMES:
        raise ToktError(
            f"{len(numbers)} frames have points that both cameras see and that can be followed; "
            f"the moments of the cameras are compared over {MIN_FRAMES} and more"
        )
    whole = _fitted(rows, None)
    without = [_fitted(rows.only(rows.frame != number), whole)[0] for number in numbers]
    n = len(numbers)
    error = float(np.sqrt((n - 1) / n * np.square(without - np.mean(without)).sum()))
    left_by_calibration = _left(rows, whole)
    difference = rows.right - rows.left[:, 1] - left_by_calibration
    moved = rows.moved_px(float(whole[0]))
    by_frame = [
        (number, np.median(moved[at]), np.median(difference[at]))
        for number in numbers
        for at in [rows.frame == number]
    ]
    half_width = float(student_t.ppf((1 + _CONFIDENCE) / 2, n - 1) * error)
    return Offset(float(whole[0]), error, half_width, n, len(rows.frame), np.array(by_frame))


def _fitted(rows: Rows, start: Float | None) -> Float:
    """Offset, constant, and the shares of column and row, of all points at once."""
    starts = [start] if start is not None else [np.array([d, 0.0, 0, 0]) for d in (-1.0, 0.0, 1.0)]
    limits = np.array([FARTHEST_FRAMES, np.inf, np.inf, np.inf])
    found = [
        least_squares(
            lambda x: _residuals(rows, x), one, bounds=(-limits, limits),
            loss="soft_l1", f_scale=_ROW_NOISE_PX,
        )
        for one in starts
    ]  # fmt: skip
    best = min(found, key=lambda one: float(one.cost))
    return np.asarray(best.x, np.float64)


def _residuals(rows: Rows, fit: Float) -> Float:
    expected = rows.left[:, 1] + fit[0] * rows.moved_px(fit[0])
    return np.asarray(rows.right - expected - _left(rows, fit))


def _left(rows: Rows, fit: Float) -> Float:
    """Rows by which the calibration leaves the views apart."""
    return np.asarray(fit[1] + rows.place @ fit[2:])
