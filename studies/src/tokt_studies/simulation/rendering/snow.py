"""Marine snow: faint particles near the cameras, out of focus and drawn out by motion.

In a mission each moment has its own, at places that both cameras agree on. In the closed loop they
stay in their water (`Snow`): a vehicle passes them. They fill a cube that repeats in all
directions, as densely as a mission has them; sizes, focus and brightness are as there.
"""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, Bools
from tokt_studies.simulation.scene.rig import FULL_WIDTH, Camera
from tokt_studies.simulation.scene.water import Water

from .raycast import View
from .trajectory import CameraPose

_EXPOSURE_S = 0.03
_NEAR_M, _FAR_M = 0.25, 3.5
_ACROSS, _DOWN = (-0.45, 0.65), (-0.33, 0.33)
"""Where particles are, for each metre in front of the left camera: the right one's view too."""
_SIZE_SIGMA = 0.6
"""Particles' brightness is log-normal."""
_COARSE = 4
"""Big blobs are drawn this many times smaller."""
_PERIOD_M = 5.0
"""Longer than what both cameras see of `NEAR_M` to `FAR_M` is from corner to corner."""
_MIDDLE_M = (0.15, 0.0, 1.9)
"""About the middle of that, in the left camera's coordinates."""
_REACHES = (2, 3, 4, 5, 6, 8, 11, 15, 21, 30, 45, 65, 95, 140, 200)
"""Half sizes of the squares that blobs are drawn in, px."""


def marine_snow(water: Water, pose: CameraPose, view: View, rng: np.random.Generator) -> F32:
    """Particles near the cameras: faint discs out of focus, drawn out by the vehicle's motion."""
    count, camera = water.snow_per_frame, view.camera
    width, height, scale = camera.width, camera.height, camera.width / FULL_WIDTH
    depth = np.cbrt(rng.uniform(_NEAR_M**3, _FAR_M**3, count))
    across, down = rng.uniform(*_ACROSS, count), rng.uniform(*_DOWN, count)
    size = rng.lognormal(0.0, _SIZE_SIGMA, count)
    in_left = np.stack([across * depth, down * depth, depth], axis=1)
    points = pose.centre + in_left @ pose.rotation
    there = camera.seen(points)
    where = camera.place(there)
    streak = camera.place(camera.seen(points - pose.velocity * _EXPOSURE_S)) - where
    radius = _blur_px(depth, scale)
    amount = water.snow_brightness * scale**2 * size / depth**2
    fine = np.zeros((height, width), np.float32)
    coarse = np.zeros((height // _COARSE + 1, width // _COARSE + 1), np.float32)
    seen = there[:, 2] > _NEAR_M / 2
    seen &= ~_hidden(camera, view.depth, where, there[:, 2])
    where, radius, streak, amount = where[seen], radius[seen], streak[seen], amount[seen]
    big = radius + np.hypot(*streak.T) / 4 > 2.5 * _COARSE
    _splat(fine, where[~big], radius[~big], streak[~big], amount[~big])
    _splat(coarse, (where[big] - (_COARSE - 1) / 2) / _COARSE, radius[big] / _COARSE,
           streak[big] / _COARSE, amount[big] / _COARSE**2)  # fmt: skip
    whole = cv2.resize(coarse, None, fx=_COARSE, fy=_COARSE, interpolation=cv2.INTER_LINEAR)
    fine += whole[:height, :width]
    return fine


def _blur_px(depth: F64, scale: float) -> F64:
    """Standard deviation of a particle's blob: the cameras are in focus at two metres."""
    return np.asarray(scale * (2.0 + 7.0 * np.abs(1 / depth - 0.5)))


def _hidden(camera: Camera, surfaces: NDArray[Any], where: F64, depth: F64) -> Bools:
    """Which particles have a surface between them and the camera, by the surfaces' depths."""
    last = np.array([camera.width, camera.height]) - 1
    column, row = np.rint(where.clip(0, last)).astype(np.int64).T
    return np.asarray(surfaces[row * camera.width + column] < depth)


def _blobs(radius: F64, streak: F64, amount: F64) -> tuple[F64, F32, F32]:
    """Gaussian discs of standard deviation `radius` px and sum `amount`, drawn out.

    Three standard deviations across and down (n, 2), the peak (n,), and what x squared, y squared
    and their product count in the exponent (3, n).
    """
    # Covariance ((a, b), (b, c)) of the disc and the streak, and its inverse, written out.
    variance = np.maximum(radius, 0.5) ** 2
    dx, dy = streak.T
    a, b, c = variance + dx * dx / 12, dx * dy / 12, variance + dy * dy / 12
    area = a * c - b * b
    peak = (amount / (2 * math.pi * np.sqrt(area))).astype(np.float32)
    exponent = np.stack([-0.5 * c / area, -0.5 * a / area, b / area]).astype(np.float32)
    return 3 * np.sqrt(np.stack([a, c], axis=1)), peak, exponent


def _splat(image: F32, where: F64, radius: F64, streak: F64, amount: F64) -> None:
    """Add blobs to a picture of a mission."""
    reach, peak, inverse = _blobs(radius, streak, amount)
    low = np.maximum(np.ceil(where - reach), 0).astype(np.int64)
    high = np.minimum(np.floor(where + reach) + 1, image.shape[::-1]).astype(np.int64)
    centre = where.astype(np.float32)
    for blob in np.flatnonzero((high > low).all(axis=1)):
        (left, top), (right, bottom) = low[blob], high[blob]
        x = np.arange(left, right, dtype=np.float32) - centre[blob, 0]
        y = np.arange(top, bottom, dtype=np.float32)[:, None] - centre[blob, 1]
        across, down, skew = inverse[:, blob]
        exponent = across * x * x + down * y * y
        exponent += skew * x * y
        image[top:bottom, left:right] += peak[blob] * np.exp(exponent)


class Snow:
    """Particles in the repeating cube: places (3, n) in metres, and relative brightness (n,)."""

    def __init__(self, rng: np.random.Generator, water: Water) -> None:
        volume = (_ACROSS[1] - _ACROSS[0]) * (_DOWN[1] - _DOWN[0]) * (_FAR_M**3 - _NEAR_M**3) / 3
        count = round(water.snow_per_frame / volume * _PERIOD_M**3)
        self.places = rng.uniform(0.0, _PERIOD_M, (3, count)).astype(np.float32)
        self.sizes = rng.lognormal(0.0, _SIZE_SIGMA, count).astype(np.float32)
        self.brightness = water.snow_brightness

    def near(self, left: Camera, carried: F64) -> tuple[F64, F64]:
        """World places (n, 3), relative to the left camera, and sizes of what may be in view.

        `carried` is how far the current has carried the water since 0 s, m.
        """
        middle = left.rotation.T @ np.array(_MIDDLE_M)
        offset = (left.centre + middle - carried) % _PERIOD_M
        there = self.places - offset.astype(np.float32)[:, None]
        there -= np.float32(_PERIOD_M) * np.rint(there * np.float32(1 / _PERIOD_M))
        ahead = left.rotation[2].astype(np.float32) @ there + np.float32(_MIDDLE_M[2])
        side = left.rotation[0].astype(np.float32) @ there + np.float32(_MIDDLE_M[0])
        use = (ahead >= _NEAR_M) & (ahead <= _FAR_M)
        use &= (side >= _ACROSS[0] * ahead) & (side <= _ACROSS[1] * ahead)
        use &= np.abs(there[1]) <= _DOWN[1] * ahead
        chosen = np.flatnonzero(use)
        return (there[:, chosen] + middle[:, None]).T, self.sizes[chosen].astype(np.float64)


def snow_light(
    snow: Snow, left: Camera, own: Camera, carried: F64, through: F64, depth: F32
) -> F32:
    """Grey levels of the snow before lamp and camera's gain, (height, width) float32.

    The camera moves `through` the water (m/s, world axes); surfaces of this depth hide what is
    behind them.
    """
    places, size = snow.near(left, carried)
    distance = places @ left.rotation[2]
    shift = left.centre - own.centre
    here = (places + shift) @ own.rotation.T
    visible = here[:, 2] > _NEAR_M / 2
    here, distance, size = here[visible], distance[visible], size[visible]
    where = own.place(here)
    streak = own.place(here - _EXPOSURE_S * (own.rotation @ through)) - where
    scale = own.width / FULL_WIDTH
    radius = _blur_px(distance, scale)
    amount = snow.brightness * scale**2 * size / distance**2
    use = ~_hidden(own, depth, where, here[:, 2])
    return _splat_squares(own, where[use], radius[use], streak[use], amount[use])


def _splat_squares(camera: Camera, where: F64, radius: F64, streak: F64, amount: F64) -> F32:
    """A frame of blobs, those of about one size together in squares: faster than one by one."""
    reaches, peak, inverse = _blobs(radius, streak, amount)
    reach = np.minimum(reaches.max(axis=1), _REACHES[-1] - 1)
    size = np.array([camera.width, camera.height])
    touches = ((where + reach[:, None] > 0) & (where - reach[:, None] < size - 1)).all(axis=1)
    bucket = np.searchsorted(_REACHES, np.where(touches, np.ceil(reach), 0))
    bucket[~touches] = -1
    margin = 2 * _REACHES[int(bucket.max(initial=0))] + 1
    rows, columns = camera.height + 2 * margin, camera.width + 2 * margin
    whole = np.rint(where).astype(np.int64)
    off = (where - whole).astype(np.float32)
    places, lights = [], []
    for number in np.unique(bucket[touches]):
        chosen = np.flatnonzero(bucket == number)
        steps = np.arange(-_REACHES[number], _REACHES[number] + 1)
        x = steps.astype(np.float32) - off[chosen, :1]
        y = steps.astype(np.float32) - off[chosen, 1:]
        across, down, skew = inverse[:, chosen, None]
        exponent = (skew * x)[:, None, :] * y[:, :, None]
        exponent += (across * x * x)[:, None, :]
        exponent += (down * y * y)[:, :, None]
        np.exp(exponent, out=exponent)
        exponent *= peak[chosen, None, None]
        lights.append(exponent.ravel())
        corner = (whole[chosen, 1] + margin) * columns + whole[chosen, 0] + margin
        places.append((corner[:, None, None] + (steps * columns)[:, None] + steps).ravel())
    if not places:
        return np.zeros((camera.height, camera.width), np.float32)
    total = np.bincount(np.concatenate(places), np.concatenate(lights), rows * columns)
    image = total.reshape(rows, columns)[margin:-margin, margin:-margin]
    return np.ascontiguousarray(image, np.float32)
