"""Marine snow: particles at places both cameras agree on, out of focus and drawn out."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from .raycast import View
from .rig import Rig
from .story import Pose
from .water import Water

Float = NDArray[np.float64]
Image = NDArray[np.float32]

_EXPOSURE_S = 0.03
_NEAR_M, _FAR_M = 0.25, 3.5
_COARSE = 4
"""Big blobs are drawn this many times smaller."""


def marine_snow(water: Water, rig: Rig, pose: Pose, view: View, rng: np.random.Generator) -> Image:
    """Particles near the cameras: faint discs out of focus, drawn out by the vehicle's motion."""
    count, camera = water.snow_per_frame, view.camera
    depth = np.cbrt(rng.uniform(_NEAR_M**3, _FAR_M**3, count))
    # Wide enough to fill the right camera's view as well.
    across, down = rng.uniform(-0.45, 0.65, count), rng.uniform(-0.33, 0.33, count)
    size = rng.lognormal(0.0, 0.6, count)
    in_left = np.stack([across * depth, down * depth, depth], axis=1)
    points = pose.centre + in_left @ pose.rotation
    where, z = camera.project(points)
    later, _ = camera.project(points - pose.velocity * _EXPOSURE_S)
    streak = later - where
    radius = rig.scale * (2.0 + 7.0 * np.abs(1 / depth - 0.5))
    amount = water.snow_brightness * rig.scale**2 * size / depth**2
    fine = np.zeros((rig.height, rig.width), np.float32)
    coarse = np.zeros((rig.height // _COARSE + 1, rig.width // _COARSE + 1), np.float32)
    for i in np.flatnonzero((z > _NEAR_M / 2) & ~_hidden(view, where, z)):
        length = np.hypot(*streak[i])
        if radius[i] + length / 4 > 2.5 * _COARSE:
            _splat(coarse, (where[i] - (_COARSE - 1) / 2) / _COARSE, radius[i] / _COARSE,
                   streak[i] / _COARSE, amount[i] / _COARSE**2)  # fmt: skip
        else:
            _splat(fine, where[i], radius[i], streak[i], amount[i])
    whole = cv2.resize(coarse, None, fx=_COARSE, fy=_COARSE, interpolation=cv2.INTER_LINEAR)
    fine += whole[: rig.height, : rig.width]
    return fine


def _hidden(view: View, where: Float, depth: Float) -> NDArray[np.bool_]:
    """Which particles have the tower between them and the camera."""
    camera = view.camera
    last = np.array([camera.width, camera.height]) - 1
    col, row = np.rint(where.clip(0, last)).astype(np.int64).T
    return np.asarray(view.depth[row * camera.width + col] < depth)


def _splat(image: Image, where: Float, radius: float, streak: Float, amount: float) -> None:
    """Add a Gaussian disc of standard deviation `radius` px and sum `amount`, drawn out."""
    # Covariance ((a, b), (b, c)) of the disc and the streak, and its inverse, written out: numpy's
    # own for 2x2 matrices would take most of a frame's time.
    variance = max(radius, 0.5) ** 2
    dx, dy = float(streak[0]), float(streak[1])
    a, b, c = variance + dx * dx / 12, dx * dy / 12, variance + dy * dy / 12
    area = a * c - b * b
    x_reach, y_reach = 3 * math.sqrt(a), 3 * math.sqrt(c)
    left, right = max(math.ceil(where[0] - x_reach), 0), math.floor(where[0] + x_reach) + 1
    top, bottom = max(math.ceil(where[1] - y_reach), 0), math.floor(where[1] + y_reach) + 1
    right, bottom = min(right, image.shape[1]), min(bottom, image.shape[0])
    if right <= left or bottom <= top:
        return
    x = np.arange(left, right, dtype=np.float32) - np.float32(where[0])
    y = (np.arange(top, bottom, dtype=np.float32) - np.float32(where[1]))[:, None]
    peak = amount / (2 * math.pi * math.sqrt(area))
    exponent = np.float32(-0.5 * c / area) * x * x + np.float32(-0.5 * a / area) * y * y
    exponent += np.float32(b / area) * x * y
    image[top:bottom, left:right] += np.float32(peak) * np.exp(exponent)
