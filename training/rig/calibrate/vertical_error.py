"""Vertical error of a calibration: matched points must lie in the same row of both views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, Bools
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.rectify import rectified, rectifying

from .matching import FramePoints

GOOD, SHIFTED, UNUSABLE = "good", "shifted", "unusable"
GOOD_MEDIAN_PX, GOOD_P90_PX = 1.0, 4.0
"""Vertical error at full resolution up to which block matching at half resolution works."""
MAX_SHIFT_PX = 6.0
"""The row offset that the detector's own trim can mend."""
CHECKED_FRAMES = 40
"""So many frames, spread over the dive, are enough to judge a calibration by."""
_MAX_BEHIND = 0.05
_REGIONS = 3


@dataclass(frozen=True)
class VerticalError:
    """Row differences of matched points after rectification, in pixels of the full frame."""

    row_px: F64  # (n,): how much lower a point lies in the left view than in the right one
    disparity_px: F64  # (n,)
    at: F64  # (n, 2): where it is in the left frame
    frame_size: tuple[int, int]

    @property
    def median_px(self) -> float:
        """Median of the absolute row difference."""
        return float(np.median(np.abs(self.row_px)))

    @property
    def p90_px(self) -> float:
        """Its 90th percentile."""
        return float(np.percentile(np.abs(self.row_px), 90))

    def figures(self) -> dict[str, Any]:
        """Median, p90 and number of matches."""
        return {
            "median": round(self.median_px, 3),
            "p90": round(self.p90_px, 3),
            "matches": len(self.row_px),
        }

    def by_region(self) -> list[list[dict[str, Any] | None]]:
        """The same figures in 3x3 regions of the left frame; None without a match."""
        width, height = self.frame_size
        column = np.clip(self.at[:, 0] * _REGIONS // width, 0, _REGIONS - 1)
        row = np.clip(self.at[:, 1] * _REGIONS // height, 0, _REGIONS - 1)
        return [
            [self._only((row == r) & (column == c)) for c in range(_REGIONS)]
            for r in range(_REGIONS)
        ]

    def _only(self, chosen: Bools) -> dict[str, Any] | None:
        if not chosen.any():
            return None
        return replace(self, row_px=self.row_px[chosen]).figures()


def _pixels(matches: Sequence[FramePoints]) -> tuple[F64, F64]:
    left = np.concatenate([one.left for one in matches])
    return left, np.concatenate([one.right for one in matches])


def vertical_error(calibration: StereoCalibration, matches: Sequence[FramePoints]) -> VerticalError:
    """Rectify matched points and compare their rows.

    Nothing is thrown away here: which matches there are was decided without any calibration.
    """
    left, right = _pixels(matches)
    c = calibration
    R1, R2, P1, P2 = rectifying(c)
    difference = rectified(left, c.K1, c.D1, R1, P1) - rectified(right, c.K2, c.D2, R2, P2)
    difference *= c.K1[0, 0] / P1[0, 0]
    return VerticalError(difference[:, 1], difference[:, 0], left, c.frame_size)


def raw_error(matches: Sequence[FramePoints], frame_size: tuple[int, int]) -> VerticalError:
    """The same of the frames as they are, without any calibration."""
    left, right = _pixels(matches)
    return VerticalError(left[:, 1] - right[:, 1], left[:, 0] - right[:, 0], left, frame_size)


@dataclass(frozen=True)
class CalibrationCheck:
    """A verdict on a calibration, from the frames themselves."""

    state: str  # `GOOD`, `SHIFTED` or `UNUSABLE`
    reason: str
    trim_px: float  # by how much the right view has to be moved down
    error: VerticalError
    after_trim: VerticalError  # with that trim

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            "state": self.state,
            "reason": self.reason,
            "trim_px": round(self.trim_px, 3),
            "vertical_error": self.error.figures(),
            "after_trim": self.after_trim.figures(),
            "by_region": self.error.by_region(),
        }


def measurable(calibration: StereoCalibration) -> bool:
    """Whether a calibration, usable or not, turns two frames side by side at all."""
    c = calibration
    cameras = all(K[0, 0] > 0 and K[1, 1] > 0 for K in (c.K1, c.K2))
    turned = np.allclose(c.R @ c.R.T, np.eye(3), atol=1e-3) and np.linalg.det(c.R) > 0
    return bool(cameras and turned and abs(c.T_mm[0, 0]) > np.abs(c.T_mm[1:]).max())


def check_calibration(
    calibration: StereoCalibration, matches: Sequence[FramePoints]
) -> CalibrationCheck:
    """Say whether a calibration is good, shifted by some rows, or unusable for these frames."""
    error = vertical_error(calibration, matches)
    trim = float(np.median(error.row_px))
    trimmed = replace(error, row_px=error.row_px - trim)
    behind = float((error.disparity_px < 0).mean())
    if behind > _MAX_BEHIND:
        state, reason = UNUSABLE, (
            f"{100 * behind:.0f} % of the points would lie behind the cameras: left and right are "
            "exchanged, or the rotation is wrong"
        )  # fmt: skip
    elif _fits(error):
        state, reason = GOOD, f"rows agree within {error.median_px:.2f} px (median)"
    elif _fits(trimmed) and abs(trim) <= MAX_SHIFT_PX:
        state, reason = SHIFTED, (
            f"a constant row offset: a trim of {trim:+.1f} px mends it (the right view moved "
            f"{'down' if trim > 0 else 'up'})"
        )  # fmt: skip
    else:
        state, reason = UNUSABLE, (
            f"rows differ by {error.median_px:.1f} px (median), and by {trimmed.median_px:.1f} px "
            "with the best constant offset"
        )  # fmt: skip
    return CalibrationCheck(state, reason, trim, error, trimmed)


def _fits(error: VerticalError) -> bool:
    return error.median_px <= GOOD_MEDIAN_PX and error.p90_px <= GOOD_P90_PX
