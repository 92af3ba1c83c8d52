"""Poses of the left camera, frame by frame: of an odometry file, or from the frames themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import Mission
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.odometry import Motion, Odometry
from tokt.inference.stereo.rectify import rectified, rectifying
from tokt.training.rig.calibrate.matching import FrameMatches, match_frame
from tokt.training.rig.calibrate.rig_fit import fit_path
from tokt.training.rig.calibrate.rig_model import Rig

_ROW_PX = 3.0
"""Rows of the full frame by which a match may be off after rectification."""
_MIN_FOLLOWED = 8
"""A pose has 6 degrees of freedom: of fewer points that other frames show too it is not told."""


@dataclass(frozen=True)
class CameraPoses:
    """Poses of the left camera by frame: each takes points from fixed axes to the camera's own."""

    by_frame: Mapping[int, Motion]
    axes: str  # the fixed ones, in words
    residual_px: float | None = None  # of an estimate: the median, in pixels of the frame


def poses_by_odometry(odometry: Odometry) -> CameraPoses:
    """Poses as a file has them."""
    turned = {frame: pose.rotation.T for frame, pose in odometry.items()}
    return CameraPoses(
        {n: Motion(R, -R @ odometry[n].position_m) for n, R in turned.items()},
        "the odometry's axes",
    )


def estimated_poses(
    mission: Mission,
    calibration: StereoCalibration,
    row_trims: Mapping[int, float],
    progress: Callable[..., Any],
) -> CameraPoses:
    """Poses from what both cameras see, followed from frame to frame and adjusted together.

    Errors add up along the way: what far apart frames say of each other is not held together.

    Parameters
    ----------
    row_trims : mapping of int to float
        The frames, and by how many rows each right frame is moved down.

    Raises
    ------
    ToktError
        If too few points can be followed.
    """
    size = calibration.frame_size
    found = [
        match_frame(mission, n, size) for n in progress(list(row_trims), len(row_trims), "poses")
    ]
    matches = [
        _in_views(one, calibration, row_trims[one.frame]) for one in found if one is not None
    ]
    try:
        fit = fit_path(matches, _views_rig(calibration))
    except ToktError as error:
        raise ToktError(f"no poses: {error}, or give --odometry FILE") from None
    shared = fit.tracks.lengths()[fit.tracks.point] > 1
    followed = np.bincount(fit.tracks.frame[shared], minlength=len(fit.tracks.frames))
    turn = rectifying(calibration)[0]
    poses = {}
    for place, frame in enumerate(fit.tracks.frames):
        if followed[place] >= _MIN_FOLLOWED:
            rotation = cv2.Rodrigues(fit.path.rotation_vectors[place])[0]
            poses[frame] = Motion(turn.T @ rotation @ turn, turn.T @ fit.path.shifts_m[place])
    axes = f"the left camera's axes at frame {fit.tracks.frames[fit.path.anchor]}"
    return CameraPoses(poses, axes, float(np.median(fit.residual_px)))


def _views_rig(calibration: StereoCalibration) -> Rig:
    """The two rectified views: a rig without distortion, whatever lenses the cameras have."""
    left, right = rectifying(calibration)[2:]
    baseline_mm = float(-right[0, 3] / right[0, 0])
    rig = Rig.plain(float(left[0, 0]), baseline_mm, calibration.frame_size)
    centres = {
        f"c{axis}_{side}": float(P[row, 2])
        for side, P in (("left", left), ("right", right))
        for row, axis in enumerate("xy")
    }
    return replace(rig, values=rig.values | centres)


def _in_views(found: FrameMatches, calibration: StereoCalibration, trim_px: float) -> FrameMatches:
    """The matches in the rectified views, without those that are in different rows there."""
    c = calibration
    R1, R2, P1, P2 = rectifying(c)
    left = rectified(found.left, c.K1, c.D1, R1, P1)
    right = rectified(found.right, c.K2, c.D2, R2, P2) + np.array([0, trim_px])
    fit = (np.abs(left[:, 1] - right[:, 1]) <= _ROW_PX) & (left[:, 0] > right[:, 0])
    looks = found.left_look[fit], found.right_look[fit]
    return FrameMatches(found.frame, left[fit], right[fit], *looks)
