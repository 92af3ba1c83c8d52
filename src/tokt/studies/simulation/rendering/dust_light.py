"""Clouds of dust in a frame: they hide and blur what is behind them, and shine themselves.

Along a ray a Gaussian puff has a closed form: its attenuation is that of the whole ray times the
error function of how far the ray goes. Worked out on a coarse grid, as a cloud has no edges.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.dust import Puffs
from tokt.studies.simulation.scene.water import Water

from .lighting import LAMP_BEAM_RAD
from .view_maps import Standpoint, ViewMaps

Float = NDArray[np.float64]
Single = NDArray[np.float32]

_COARSE_PX = 8
_ALBEDO = 0.12
"""Share of the light taken out of a ray that comes back: dust is brighter than water."""
_NEAREST_M = 0.3
_BLUR_PX = 6.0
"""Spread, at the mission camera's width, of what is seen through thick dust."""
_MIN_ATTENUATION = 0.002
"""Attenuation (of 1) below which there is nothing to see."""


def add_dust(
    water: Water,
    maps: ViewMaps,
    own: Standpoint,
    clouds: Sequence[Puffs],
    light: Single,
    depth: Single,
) -> None:
    """Put clouds into a frame without snow and noise, in place.

    Parameters
    ----------
    light : (height, 3 * width) float32
        Grey levels.
    depth : (pixels,) float32
        Of surfaces along the optical axis, m; infinite in open water.
    """
    centre = own.seen(np.concatenate([cloud.centre for cloud in clouds]))
    size = np.concatenate([cloud.size for cloud in clouds])
    density = np.concatenate([cloud.density for cloud in clouds])
    coarse = _along_rays(water, maps, centre, size, density)
    if coarse is None:
        return
    whole = cv2.resize(coarse, (maps.width, maps.height), interpolation=cv2.INTER_LINEAR)
    through, middle, spread = (np.array(whole[..., i], np.float32).ravel() for i in range(3))
    pixels = np.flatnonzero(np.isfinite(depth))
    reach = depth.take(pixels) * maps.length.take(pixels)
    # The logistic curve is the normal distribution's within 0.01.
    before = np.exp(np.float32(-1.702) * (reach - middle.take(pixels)) / spread.take(pixels))
    through[pixels] /= 1 + before
    left = np.exp(-through).reshape(maps.height, maps.width)
    front = 1 - np.exp(np.float32(-water.veil_growth) * middle.reshape(left.shape))
    lens = maps.lens.reshape(left.shape)
    picture = light.reshape(maps.height, maps.width, 3)
    blurred = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX * maps.scale)
    veil = maps.open_water.reshape(picture.shape)
    for colour in range(3):
        sharp = picture[..., colour]
        seen = blurred[..., colour] + (sharp - blurred[..., colour]) * left
        shine = veil[..., colour] * front + whole[..., 3 + colour] * lens
        picture[..., colour] = shine + (seen - shine) * left


def _along_rays(
    water: Water, maps: ViewMaps, centre: Float, size: Float, density: Float
) -> Single | None:
    """Over a coarse grid: attenuation, mean distance, its spread, and the dust's shine (BGR)."""
    near = centre[:, 2] > -2 * size
    centre, size, density = centre[near], size[near], density[near]
    columns, rows = (round(pixels / _COARSE_PX) for pixels in (maps.width, maps.height))
    u = (np.arange(columns) + 0.5) * maps.width / columns - 0.5
    v = (np.arange(rows) + 0.5) * maps.height / rows - 0.5
    x = (u - maps.matrix[0, 2]) / maps.matrix[0, 0]
    y = (v - maps.matrix[1, 2]) / maps.matrix[1, 1]
    rays = np.stack([*np.meshgrid(x, y), np.ones((rows, columns))], axis=-1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    nearest = (centre @ rays.T).astype(np.float32)
    squared = np.square(centre).sum(axis=1, keepdims=True).astype(np.float32)
    off_squared = np.maximum(squared - nearest * nearest, 0)
    wide = size[:, None].astype(np.float32)
    weight = np.exp(off_squared / (-2 * wide * wide)) * wide * np.float32(np.sqrt(2 * np.pi))
    weight *= density[:, None].astype(np.float32)
    weight /= 1 + np.exp(np.float32(-1.702) * nearest / wide)
    total = weight.sum(axis=0)
    if total.max(initial=0.0) < _MIN_ATTENUATION:
        return None
    share = weight / np.maximum(total, 1e-9)
    distance = np.maximum(nearest, np.float32(_NEAREST_M))
    middle = (share * distance).sum(axis=0)
    spread = np.sqrt((share * (wide * wide + np.square(distance - middle))).sum(axis=0))
    shine = _shine(water, maps, rays, distance, share)
    values = np.stack([total, middle, np.maximum(spread, 1e-3), *shine], axis=-1)
    return np.asarray(values.reshape(rows, columns, 6), np.float32)


def _shine(
    water: Water, maps: ViewMaps, rays: Float, distance: Single, share: Single
) -> list[Single]:
    """Grey levels of dust so thick that nothing is seen through it."""
    lamp_squared = np.square(distance) - 2 * distance * (rays @ maps.lamp).astype(np.float32)
    lamp_squared = np.maximum(lamp_squared + maps.lamp @ maps.lamp, _NEAREST_M**2)
    lamp_distance = np.sqrt(lamp_squared)
    on_axis = distance * (rays @ maps.lamp_axis) - maps.lamp @ maps.lamp_axis
    off_axis = np.arccos((on_axis / lamp_distance).clip(-1, 1)) / LAMP_BEAM_RAD
    lit = share * _ALBEDO * np.exp(-0.5 * np.square(off_axis)) / lamp_squared
    path = distance + lamp_distance
    return [
        np.asarray((lit * np.exp(-attenuation * path)).sum(axis=0) * lamp, np.float32)
        for attenuation, lamp in zip(water.attenuation, water.lamp, strict=True)
    ]
