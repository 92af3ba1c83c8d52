"""Marine snow that stays in its water: a vehicle passes it, and both cameras see the same.

The particles fill a cube that repeats in all directions, as densely as `snow.marine_snow` has
them; sizes, focus and brightness are as there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.water import Water

from .snow import ACROSS, DOWN, EXPOSURE_S, FAR_M, NEAR_M, SIZE_SIGMA, blur_px
from .view_maps import Standpoint, ViewMaps

Float = NDArray[np.float64]
Single = NDArray[np.float32]

_PERIOD_M = 5.0
"""Longer than what both cameras see of `NEAR_M` to `FAR_M` is from corner to corner."""
_MIDDLE_M = (0.15, 0.0, 1.9)
"""About the middle of that, in the left camera's coordinates."""
_REACHES = (2, 3, 4, 5, 6, 8, 11, 15, 21, 30, 45, 65, 95, 140, 200)
"""Half sizes of the squares that blobs are drawn in, px."""


@dataclass(frozen=True, eq=False)
class Snow:
    """Particles at a moment, about the left camera.

    Attributes
    ----------
    places : (3, n) float32
        m, within the repeating cube.
    sizes : (n,) float32
        Relative brightness.
    """

    places: Single
    sizes: Single
    brightness: float

    @classmethod
    def draw(cls, rng: np.random.Generator, water: Water) -> Snow:
        """The particles of a world."""
        volume = (ACROSS[1] - ACROSS[0]) * (DOWN[1] - DOWN[0]) * (FAR_M**3 - NEAR_M**3) / 3
        count = round(water.snow_per_frame / volume * _PERIOD_M**3)
        return cls(
            rng.uniform(0.0, _PERIOD_M, (3, count)).astype(np.float32),
            rng.lognormal(0.0, SIZE_SIGMA, count).astype(np.float32),
            water.snow_brightness,
        )

    def near(self, left: Standpoint, carried: Float) -> tuple[Float, Float]:
        """World places (n, 3), relative to the left camera, and sizes of what may be in view.

        Parameters
        ----------
        carried : (3,) array
            How far the current has carried the water since 0 s, m.
        """
        middle = left.rotation.T @ np.array(_MIDDLE_M)
        offset = (left.centre + middle - carried) % _PERIOD_M
        there = self.places - offset.astype(np.float32)[:, None]
        there -= np.float32(_PERIOD_M) * np.rint(there * np.float32(1 / _PERIOD_M))
        ahead = left.rotation[2].astype(np.float32) @ there + np.float32(_MIDDLE_M[2])
        side = left.rotation[0].astype(np.float32) @ there + np.float32(_MIDDLE_M[0])
        use = (ahead >= NEAR_M) & (ahead <= FAR_M)
        use &= (side >= ACROSS[0] * ahead) & (side <= ACROSS[1] * ahead)
        use &= np.abs(there[1]) <= DOWN[1] * ahead
        chosen = np.flatnonzero(use)
        return (there[:, chosen] + middle[:, None]).T, self.sizes[chosen].astype(np.float64)


def snow_light(
    snow: Snow, maps: ViewMaps, left: Standpoint, own: Standpoint, carried: Float,
    through: Float, depth: Single,
) -> Single:  # fmt: skip
    """Grey levels of the snow before lamp and camera's gain, (height, width) float32.

    Parameters
    ----------
    through : (3,) array
        How fast the camera moves through the water, m/s, world axes.
    depth : (pixels,) float32
        Of surfaces, which hide what is behind them.
    """
    places, size = snow.near(left, carried)
    distance = places @ left.rotation[2]
    shift = left.centre - own.centre
    here = (places + shift) @ own.rotation.T
    visible = here[:, 2] > NEAR_M / 2
    here, distance, size = here[visible], distance[visible], size[visible]
    where = maps.project(here)
    streak = maps.project(here - EXPOSURE_S * (own.rotation @ through)) - where
    last = np.array([maps.width, maps.height]) - 1
    column, row = np.rint(where.clip(0, last)).astype(np.int64).T
    radius = blur_px(distance, maps.scale)
    amount = snow.brightness * maps.scale**2 * size / distance**2
    open_to_view = depth[row * maps.width + column] >= here[:, 2]
    use = np.flatnonzero(open_to_view)
    return splat(maps, where[use], radius[use], streak[use], amount[use])


def splat(maps: ViewMaps, where: Float, radius: Float, streak: Float, amount: Float) -> Single:
    """A frame of Gaussian discs of standard deviation `radius` px and sum `amount`, drawn out."""
    variance = np.maximum(radius, 0.5) ** 2
    dx, dy = streak.T
    a, b, c = variance + dx * dx / 12, dx * dy / 12, variance + dy * dy / 12
    area = a * c - b * b
    reach = np.minimum(3 * np.sqrt(np.maximum(a, c)), _REACHES[-1] - 1)
    size = np.array([maps.width, maps.height])
    touches = ((where + reach[:, None] > 0) & (where - reach[:, None] < size - 1)).all(axis=1)
    bucket = np.searchsorted(_REACHES, np.where(touches, np.ceil(reach), 0))
    bucket[~touches] = -1
    margin = 2 * _REACHES[int(bucket.max(initial=0))] + 1
    rows, columns = maps.height + 2 * margin, maps.width + 2 * margin
    whole = np.rint(where).astype(np.int64)
    off = (where - whole).astype(np.float32)
    peak = (amount / (2 * math.pi * np.sqrt(area))).astype(np.float32)
    inverse = np.stack([-0.5 * c / area, -0.5 * a / area, b / area]).astype(np.float32)
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
        return np.zeros((maps.height, maps.width), np.float32)
    total = np.bincount(np.concatenate(places), np.concatenate(lights), rows * columns)
    image = total.reshape(rows, columns)[margin:-margin, margin:-margin]
    return np.ascontiguousarray(image, np.float32)
