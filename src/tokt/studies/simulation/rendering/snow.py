"""Marine snow: particles at places both cameras agree on, out of focus and drawn out."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.rig import SyntheticRig
from tokt.studies.simulation.scene.water import Water

from .boxes import pixels_of_boxes
from .raycast import View
from .trajectory import CameraPose

Float = NDArray[np.float64]
Image = NDArray[np.float32]

EXPOSURE_S = 0.03
NEAR_M, FAR_M = 0.25, 3.5
ACROSS, DOWN = (-0.45, 0.65), (-0.33, 0.33)
"""Where particles are, for each metre in front of the left camera: the right one's view too."""
SIZE_SIGMA = 0.6
"""Particles' brightness is log-normal."""
_COARSE = 4
"""Big blobs are drawn this many times smaller."""


def marine_snow(
    water: Water, rig: SyntheticRig, pose: CameraPose, view: View, rng: np.random.Generator
) -> Image:
    """Particles near the cameras: faint discs out of focus, drawn out by the vehicle's motion."""
    count, camera = water.snow_per_frame, view.camera
    depth = np.cbrt(rng.uniform(NEAR_M**3, FAR_M**3, count))
    across, down = rng.uniform(*ACROSS, count), rng.uniform(*DOWN, count)
    size = rng.lognormal(0.0, SIZE_SIGMA, count)
    in_left = np.stack([across * depth, down * depth, depth], axis=1)
    points = pose.centre + in_left @ pose.rotation
    where, z = camera.project(points)
    later, _ = camera.project(points - pose.velocity * EXPOSURE_S)
    streak = later - where
    radius = blur_px(depth, rig.scale)
    amount = water.snow_brightness * rig.scale**2 * size / depth**2
    fine = np.zeros((rig.height, rig.width), np.float32)
    coarse = np.zeros((rig.height // _COARSE + 1, rig.width // _COARSE + 1), np.float32)
    seen = np.flatnonzero((z > NEAR_M / 2) & ~_hidden(view, where, z))
    where, radius, streak, amount = where[seen], radius[seen], streak[seen], amount[seen]
    big = radius + np.hypot(*streak.T) / 4 > 2.5 * _COARSE
    _splat(fine, where[~big], radius[~big], streak[~big], amount[~big])
    _splat(coarse, (where[big] - (_COARSE - 1) / 2) / _COARSE, radius[big] / _COARSE,
           streak[big] / _COARSE, amount[big] / _COARSE**2)  # fmt: skip
    whole = cv2.resize(coarse, None, fx=_COARSE, fy=_COARSE, interpolation=cv2.INTER_LINEAR)
    fine += whole[: rig.height, : rig.width]
    return fine


def blur_px(depth: Float, scale: float) -> Float:
    """Standard deviation of a particle's blob: the cameras are in focus at two metres."""
    return np.asarray(scale * (2.0 + 7.0 * np.abs(1 / depth - 0.5)))


def _hidden(view: View, where: Float, depth: Float) -> NDArray[np.bool_]:
    """Which particles have the tower between them and the camera."""
    camera = view.camera
    last = np.array([camera.width, camera.height]) - 1
    col, row = np.rint(where.clip(0, last)).astype(np.int64).T
    return np.asarray(view.depth[row * camera.width + col] < depth)


def _splat(image: Image, where: Float, radius: Float, streak: Float, amount: Float) -> None:
    """Add Gaussian discs of standard deviation `radius` px and sum `amount`, drawn out."""
    # Covariance ((a, b), (b, c)) of the disc and the streak, and its inverse, written out.
    variance = np.maximum(radius, 0.5) ** 2
    dx, dy = streak.T
    a, b, c = variance + dx * dx / 12, dx * dy / 12, variance + dy * dy / 12
    area = a * c - b * b
    reach = 3 * np.sqrt(np.stack([a, c], axis=1))
    size = np.array(image.shape)[::-1]
    low = np.maximum(np.ceil(where - reach), 0).astype(np.int64)
    high = np.minimum(np.floor(where + reach) + 1, size).astype(np.int64)
    centre = where.astype(np.float32)
    peak = (amount / (2 * math.pi * np.sqrt(area))).astype(np.float32)
    across, down, skew = (
        values.astype(np.float32) for values in (-0.5 * c / area, -0.5 * a / area, b / area)
    )
    for which, col, row in pixels_of_boxes(low, high):
        x = col.astype(np.float32) - centre[which, 0]
        y = row.astype(np.float32) - centre[which, 1]
        exponent = across[which] * x * x + down[which] * y * y
        exponent += skew[which] * x * y
        np.add.at(image, (row, col), peak[which] * np.exp(exponent))
