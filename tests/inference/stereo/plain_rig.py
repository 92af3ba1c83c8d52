"""A rig whose frames are rectified already: two equal cameras side by side."""

from __future__ import annotations

import numpy as np

from tokt.inference.stereo.calibration import StereoCalibration

WIDTH, HEIGHT = 1360, 1024
FOCAL_PX, BASELINE_M = 2200.0, 0.3
CENTRE = np.array([679.5, 511.5])
CAMERA = np.array([[FOCAL_PX, 0, CENTRE[0]], [0, FOCAL_PX, CENTRE[1]], [0, 0, 1]])
PLAIN = StereoCalibration(
    CAMERA,
    np.zeros(5),
    CAMERA,
    np.zeros(5),
    np.eye(3),
    np.array([[-1000 * BASELINE_M], [0.0], [0.0]]),
    (WIDTH, HEIGHT),
)
