r"""Disparity: a rectified stereo pair, block matching, and a mask of what was matched.

The picture elements that both cameras see at a plausible distance are white in the mask; open
water gives no match at all. Works at half the camera's resolution. What it cannot see:

::

      left camera  *---------* right camera        z = f * B / d
                   |\       /|
        blind: the | \     / |   nearer than 1.6 m (d > 208 px) nothing is matched;
        left d px  |  \   /  |   farther than 10.6 m (d < 32 px) neither
        of the     |   \ /   |
        left frame |    X    |   (mission cameras: f = 1113.5 px at half size, B = 305.5 mm)

A frame with texture in it of which hardly any is matched is unknown, not clear: a wrong pair, a
wrong calibration, or something nearer than the nearest distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..features.errors import ToktError
from ..features.grid import Grid
from .calibration import StereoCalibration
from .detector import DISPARITY, Detection
from .frame_check import frame_fault
from .sources import Frame
from .verdict import STATUS_MEAN_THRESHOLD

# Settings at half the camera's resolution, in pixels of it. Source: the mission's measurements
# (valid matches on ocean frames 0, 23 % at frame 180). Those from CONTRAST_WINDOW_PX on were set
# here, against the control that another right frame, or the right frame upside down, must leave
# at most 0.3 % at frame 180.
MIN_DISPARITY_PX = 32
N_DISPARITIES_PX = 176
BLOCK_PX = 21
TEXTURE_THRESHOLD = 300
UNIQUENESS_PERCENT = 12
LEFT_RIGHT_PX = 1.5
LOCAL_SIGMA_GREY = 2.0
"""Grey levels of local contrast that a pixel needs in both views."""
BLOB_PX = 150
"""Fewest pixels of a patch of valid matches."""
CONTRAST_WINDOW_PX = 21
CONTRAST_GAIN = 25.0
"""Grey levels that one local standard deviation becomes before matching."""
PREFILTER_CAP = 63
"""The largest that OpenCV allows: clip the x-gradient as little as possible."""
NEAR_PERCENTILE = 5.0
"""Percentile of the depths that is reported as the distance: near, yet not one stray match."""
TEXTURED_FRACTION = 0.01
MATCHED_OF_TEXTURED = 0.10
"""With this much of the frame textured, this part of it must be matched. Measured on the sea
trial: frames whose texture matches nowhere (open water) have at most 0.0032 of it; the 50 pairs
above `TEXTURED_FRACTION` match 0.37 and more of theirs, an exchanged right frame 0.01 or less
(one of the next frames up to 0.36)."""


@dataclass(frozen=True)
class Matches:
    """What block matching found in one pair, at half resolution in the rectified left view.

    Parameters
    ----------
    disparity_px : array of float32, shape (height, width)
    valid : array of bool, shape (height, width)
    textured : array of bool, shape (height, width)
        Where the left view has enough local contrast to be matched.
    """

    disparity_px: NDArray[np.float32]
    valid: NDArray[np.bool_]
    textured: NDArray[np.bool_]


class DisparityDetector:
    """Judge stereo pairs.

    Parameters
    ----------
    calibration : StereoCalibration
    grid : Grid
        Its width is the mask's, so that a texture mask and a disparity mask are of one size.

    Raises
    ------
    ToktError
        If rectifying with the calibration moves most of the left frame out of view.

    Notes
    -----
    The mask is in the *unrectified* left frame resized to the grid's width: positions are those
    of the picture that the texture detector and the pilot see. Blind at the left edge are as many
    pixels as the disparity of what is there, since the right camera does not see them.
    """

    method = DISPARITY

    def __init__(self, calibration: StereoCalibration, grid: Grid) -> None:
        self.calibration = calibration
        width, height = calibration.frame_size
        self._half_size = (width // 2, height // 2)
        self._rectify(calibration)
        self._to_left = self._left_frame_map(calibration, grid)
        self._matcher = cv2.StereoBM.create(N_DISPARITIES_PX, BLOCK_PX)
        self._matcher.setMinDisparity(MIN_DISPARITY_PX)
        self._matcher.setPreFilterType(cv2.StereoBM_PREFILTER_XSOBEL)
        self._matcher.setPreFilterCap(PREFILTER_CAP)
        self._matcher.setTextureThreshold(TEXTURE_THRESHOLD)
        self._matcher.setUniquenessRatio(UNIQUENESS_PERCENT)

    def _rectify(self, calibration: StereoCalibration) -> None:
        """Set the maps from the half-size cameras to the rectified views, and f * B."""
        half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])  # pixel centres stay
        K1, K2 = half @ calibration.K1, half @ calibration.K2
        D1, D2 = calibration.D1, calibration.D2
        R1, R2, P1, P2, *_ = cv2.stereoRectify(
            K1,
            D1,
            K2,
            D2,
            self._half_size,
            calibration.R,
            calibration.T_mm,
            flags=cv2.CALIB_ZERO_DISPARITY,
            alpha=-1,
        )
        kind = cv2.CV_32FC1
        self._left_maps = cv2.initUndistortRectifyMap(K1, D1, R1, P1, self._half_size, kind)
        self._right_maps = cv2.initUndistortRectifyMap(K2, D2, R2, P2, self._half_size, kind)
        self._rotation, self._projection = R1, P1
        self.focal_baseline_px_m = float(-P2[0, 3]) / 1000
        """f * B in half-resolution pixels times metres: depth is this over the disparity."""

    def _left_frame_map(self, calibration: StereoCalibration, grid: Grid) -> NDArray[np.float32]:
        """For each pixel of the mask its place in the rectified left view, shape (h, w, 2)."""
        width, height = calibration.frame_size
        mask_height, mask_width = grid.resized(height, width)
        rows, columns = np.indices((mask_height, mask_width), np.float64)
        x = (columns + 0.5) * width / mask_width - 0.5
        y = (rows + 0.5) * height / mask_height - 0.5
        points = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
        places = cv2.undistortPoints(
            points, calibration.K1, calibration.D1, R=self._rotation, P=self._projection
        ).reshape(mask_height, mask_width, 2)
        half_width, half_height = self._half_size
        inside = (places >= 0).all(axis=2) & (places < (half_width, half_height)).all(axis=2)
        if inside.mean() < 0.5:
            raise ToktError("the calibration moves most of the left frame out of view")
        return np.asarray(places, np.float32)

    def detect(self, frame: Frame) -> Detection:
        """Judge one pair.

        A missing picture or one of another size makes it unknown. In a dark, blank, saturated or
        damaged one, matches still prove an obstacle, while no match proves nothing: unknown too.
        """
        fault = self._pair_fault(frame)
        if frame.left is None or frame.right is None or fault:
            return Detection(None, DISPARITY, fault=fault)
        unfit = _unfit(frame.left, frame.right)
        found = self.match(frame.left, frame.right)
        if found.textured.mean() > TEXTURED_FRACTION and (
            found.valid.sum() < MATCHED_OF_TEXTURED * found.textured.sum()
        ):
            fault = "the left and right frames do not match: another moment, or something too near"
            # An unfit picture explains it; two good ones that do not match are a sign of danger.
            return Detection(None, DISPARITY, fault=unfit or fault, against_clear=not unfit)
        mask = cv2.remap(
            found.valid.astype(np.uint8) * 255,
            self._to_left[..., 0],
            self._to_left[..., 1],
            cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0,
        )
        if unfit and cv2.mean(mask)[0] <= STATUS_MEAN_THRESHOLD:
            return Detection(None, DISPARITY, fault=unfit)
        return Detection(np.asarray(mask, np.uint8), DISPARITY, distance_m=self._distance(found))

    def _pair_fault(self, frame: Frame) -> str:
        """Why a pair cannot be judged, or an empty string."""
        if frame.left is None:
            return frame.left_fault or "there is no left frame"
        if frame.right is None:
            return frame.right_fault or "there is no right frame"
        for side, picture in (("left", frame.left), ("right", frame.right)):
            height, width = picture.shape[:2]
            if (width, height) != self.calibration.frame_size:
                expected = "x".join(map(str, self.calibration.frame_size))
                return f"the {side} frame is {width}x{height}, the calibration is for {expected}"
        return ""

    def match(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Matches:
        """Rectify and match a pair of frames of the calibration's size."""
        left_view, left_sigma = _even_contrast(self._view(left, self._left_maps))
        right_view, right_sigma = _even_contrast(self._view(right, self._right_maps))
        disparity = self._disparity(left_view, right_view)
        mirrored = self._disparity(np.fliplr(right_view), np.fliplr(left_view))
        right_disparity = np.fliplr(mirrored)

        rows, columns = np.indices(disparity.shape)
        there = np.rint(columns - disparity).astype(np.int64)
        valid = (disparity >= MIN_DISPARITY_PX) & (there >= 0)
        there = there.clip(0)
        valid &= np.abs(right_disparity[rows, there] - disparity) <= LEFT_RIGHT_PX
        textured = left_sigma > LOCAL_SIGMA_GREY
        valid &= textured & (right_sigma[rows, there] > LOCAL_SIGMA_GREY)
        return Matches(disparity, _large_blobs(valid), textured)

    def _view(self, frame: NDArray[np.uint8], maps: Sequence[NDArray[Any]]) -> NDArray[np.float32]:
        """Half-size rectified view, in grey levels and fractions of them."""
        gray = frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        # Averaged before rounding: the frames hold only a few grey levels of signal.
        half = cv2.resize(gray.astype(np.float32), self._half_size, interpolation=cv2.INTER_AREA)
        view = cv2.remap(half, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(view, np.float32)

    def _disparity(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Disparity in pixels of the left view; below `MIN_DISPARITY_PX` where there is none."""
        # The matcher leaves out every column that the largest disparity would take outside the
        # right view: a third of the frame. With a gray margin it looks there for what it can.
        margin = MIN_DISPARITY_PX + N_DISPARITIES_PX
        padded = [
            cv2.copyMakeBorder(view, 0, 0, margin, 0, cv2.BORDER_CONSTANT, value=128)
            for view in (np.ascontiguousarray(left), np.ascontiguousarray(right))
        ]
        fixed_point = self._matcher.compute(*padded)[:, margin:]
        return np.asarray(fixed_point, np.float32) / np.float32(16)

    def _distance(self, found: Matches) -> float | None:
        """Near end of the matched depths in metres, or None without matches."""
        if not found.valid.any():
            return None
        depths = self.focal_baseline_px_m / found.disparity_px[found.valid]
        return float(np.percentile(depths, NEAR_PERCENTILE))


def _unfit(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> str:
    """Which picture `frame_fault` finds fault with and why, or an empty string."""
    for side, picture in (("left", left), ("right", right)):
        fault = frame_fault(picture)
        if fault:
            return f"{side}: {fault}"
    return ""


def _even_contrast(
    view: NDArray[np.float32],
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Local contrast normalisation: the even view (8 bit), and the local sigma in grey levels."""
    window = (CONTRAST_WINDOW_PX, CONTRAST_WINDOW_PX)
    mean = cv2.boxFilter(view, -1, window)
    variance = cv2.sqrBoxFilter(view, -1, window) - mean * mean
    sigma = np.sqrt(np.maximum(variance, 0))
    even = 128 + CONTRAST_GAIN * (view - mean) / np.maximum(sigma, 1)
    return even.clip(0, 255).astype(np.uint8), np.asarray(sigma, np.float32)


def _large_blobs(valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Only the connected regions of at least `BLOB_PX` pixels."""
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(
        valid.astype(np.uint8), connectivity=4
    )
    large = statistics[:, cv2.CC_STAT_AREA] >= BLOB_PX
    large[0] = False  # the background
    return np.asarray(large[labels], bool)
