"""Poses of the left camera, estimated from the frames themselves."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from tokt.features.frames.mission import Mission
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.odometry import Odometry, Pose
from tokt.inference.stereo.rectify import rectified
from tokt.training.rig.calibrate.matching import build_tracks, match_frame
from tokt.training.rig.calibrate.rig_fit import fit_path
from tokt.training.rig.calibrate.rig_model import POSE, Rig


def estimated_poses(
    mission: Mission,
    calibration: StereoCalibration,
    row_trims: Mapping[int, float],
    progress: Callable[..., Any],
) -> tuple[Odometry, str]:
    """Poses by what both cameras see, followed from frame to frame and adjusted together.

    Errors add up along the way: what far apart frames say of each other is not held together.

    Parameters
    ----------
    row_trims : mapping of int to float
        The frames, and by how many rows each right frame is moved down.

    Returns
    -------
    odometry, axes
        Poses without times, and their axes in words; or none, and why.
    """
    c, matches = calibration, []
    for frame in progress(list(row_trims), len(row_trims), "poses"):
        found = match_frame(mission, frame, c.frame_size)
        if found is not None:
            left = rectified(found.left, c.K1, c.D1, np.eye(3), c.K1)
            right = rectified(found.right, c.K2, c.D2, np.eye(3), c.K2)
            right[:, 1] += row_trims[frame]
            matches.append(replace(found, left=left, right=right))
    # No distortion is left in the matches, whatever lenses the cameras have.
    none, (x, y, z), size = np.zeros(5), c.T_mm.ravel(), c.frame_size
    rig = Rig.from_cameras((c.K1, c.K2), (none, none), float(np.linalg.norm(c.T_mm)), size)
    rig = rig.moved(POSE[:5], np.append(cv2.Rodrigues(c.R)[0], [y / x, z / x]))
    fit = fit_path(build_tracks(matches), rig, ()) if matches else "no frame has enough points"
    if isinstance(fit, str):
        return {}, f"no poses: {fit}; give --odometry FILE"
    tracks, adjusted = fit
    poses, path = {}, adjusted.path
    for place, frame in enumerate(tracks.frames):
        turn = np.asarray(cv2.Rodrigues(path.rotation_vectors[place])[0].T, np.float64)
        poses[frame] = Pose(math.nan, -turn @ path.shifts_m[place], turn)
    within = f"{np.median(adjusted.residual_px):.2f} px (median)"
    anchor = tracks.frames[path.anchor]
    return poses, f"the left camera's axes at frame {anchor}; poses estimated, within {within}"
