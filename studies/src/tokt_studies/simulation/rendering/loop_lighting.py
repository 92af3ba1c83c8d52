"""Lighting for the closed loop: surfaces and dust in a frame, as `lighting` does it for missions.

All that never changes for one camera in one water is worked out once (`ViewMaps`).
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64
from tokt_studies.simulation.scene.fish_and_dust import Puffs
from tokt_studies.simulation.scene.rig import Camera, SyntheticRig
from tokt_studies.simulation.scene.surfaces import STALK_MATERIAL, Materials
from tokt_studies.simulation.scene.water import Water

from . import lighting
from .raycast import Hits

_COARSE_PX = 8
_ALBEDO = 0.12
"""Share of the light taken out of a ray that comes back: dust is brighter than water."""
_NEAREST_M = 0.3
_BLUR_PX = 6.0
"""Spread, at the mission camera's width, of what is seen through thick dust."""
_MIN_ATTENUATION = 0.002
"""Attenuation (of 1) below which there is nothing to see."""


class ViewMaps:
    """Maps over the pixels of the left camera (0) or the right one (1).

    In the camera's own coordinates: x right, y down, z ahead. Grey levels are (height, 3 * width).
    """

    def __init__(self, water: Water, rig: SyntheticRig, side: int) -> None:
        response = (water.left, water.right)[side]
        turn, shift = ((np.eye(3), np.zeros(3)), (rig.rotation, rig.translation_m))[side]
        rays = rig.cameras(np.eye(3), np.zeros(3))[side].rays(np.arange(rig.width * rig.height))
        across = (np.arange(rig.width) + 0.5) / rig.width
        down = (np.arange(rig.height) + 0.5) / rig.width
        lens = response.gain * lighting.vignette(across[None, :], down[:, None], rig)
        shape = lighting.illumination(rig, response)[..., None]
        size = (rig.height, 3 * rig.width)

        def single(values: Any) -> F32:
            return np.ascontiguousarray(values, np.float32)

        def over(values: Any) -> F32:
            return single(values * response.gain).reshape(size)

        self.scale = rig.scale  # pixels for one pixel of the mission camera
        self.rays = single(rays)  # (3, pixels), of length one along the optical axis
        self.length = single(np.linalg.norm(rays, axis=0))
        self.lamp = turn @ lighting.LAMP_AT_M + shift
        self.lamp_axis = turn @ lighting.LAMP_TOWARDS / np.linalg.norm(lighting.LAMP_TOWARDS)
        # Each ray times the lamp's place, and times the unit vector that it shines along.
        self.lamp_along = single(self.lamp @ rays)
        self.lamp_beam = single(self.lamp_axis @ rays)
        self.lens = single(lens).ravel()  # gain and fall-off towards the corners
        # Open water's veil where the water is even, what is under it, and a particle's grey levels
        # for each of its brightness.
        self.open_water = over(shape * np.array(water.veil))
        self.floor = over(np.ones_like(shape) * np.array(water.veil_floor))
        self.snow_gain = over(shape * np.array(lighting.SNOW_TINT))


def surface_light(
    water: Water, materials: Materials, maps: ViewMaps, hits: Hits, open_water: F32
) -> F32:
    """(height, width, 3): the surfaces' change of the open water (height, 3 * width).

    In grey levels; it may darken.
    """
    pixels = hits.pixels
    height, width = hits.camera.height, hits.camera.width
    t: F32 = hits.depth.take(pixels)
    distance = t * maps.length.take(pixels)
    lamp_squared = distance * distance - 2 * t * maps.lamp_along.take(pixels)
    lamp_squared += np.float32(maps.lamp @ maps.lamp)
    lamp_distance = np.sqrt(lamp_squared)
    on_axis = t * maps.lamp_beam.take(pixels) - np.float32(maps.lamp @ maps.lamp_axis)
    off_axis = np.arccos((on_axis / lamp_distance).clip(-1, 1)) / np.float32(lighting.LAMP_BEAM_RAD)
    lit = hits.facing.take(pixels) / lamp_distance
    lit = np.float32(lighting.DIM) + np.float32(lighting.FACING) * np.maximum(lit, 0)
    material_number, along = hits.material_number.take(pixels), hits.along.take(pixels)
    pixel_m = t / np.float32(hits.camera.matrix[0, 0])
    bright, rust = materials.look_up(material_number, hits.across.take(pixels), along, pixel_m)
    shade = np.float32(0.35) + np.float32(1.1) * bright
    stalks = np.flatnonzero(material_number == STALK_MATERIAL)
    lit[stalks], shade[stalks], rust[stalks] = lighting.NO_SIDE, along[stalks], 0
    lit *= np.exp(np.float32(-0.5) * off_axis * off_axis) / lamp_squared
    lit *= maps.lens.take(pixels) * shade
    hidden = np.exp(np.float32(-water.veil_growth) * distance)
    path = lamp_distance + distance
    planes = np.zeros((3, height, width), np.float32)
    for colour, plane in enumerate(planes):
        light = np.exp(np.float32(-water.attenuation[colour]) * path)
        light *= materials.paint[colour].take(material_number) + rust * materials.rust[colour].take(
            material_number
        )
        light *= lit
        light *= np.float32(water.lamp[colour])
        light -= open_water.take(3 * pixels + colour) * hidden
        plane.ravel()[pixels] = np.minimum(light, np.float32(lighting.BRIGHTEST))
    change = np.asarray(cv2.merge(list(planes)), np.float32)
    spread = (water.blur_px + water.blur_px_per_m * float(distance.min())) * maps.scale
    columns = np.flatnonzero(np.isfinite(hits.depth.reshape(height, -1)).any(axis=0))
    return lighting.scattered(change, pixels[[0, -1]] // width, columns, spread, water.glow)


def add_dust(
    water: Water, maps: ViewMaps, camera: Camera, clouds: Sequence[Puffs], light: F32,
    depth: F32,
) -> None:  # fmt: skip
    """Put clouds into a frame without snow and noise, in place.

    They hide and blur what is behind them, and shine themselves. Along a ray a Gaussian puff has a
    closed form: its attenuation is that of the whole ray times the error function of how far the
    ray goes. Worked out on a coarse grid, as a cloud has no edges.
    """
    centre = camera.seen(np.concatenate([cloud.centre for cloud in clouds]))
    size = np.concatenate([cloud.size for cloud in clouds])
    density = np.concatenate([cloud.density for cloud in clouds])
    coarse = _along_rays(water, maps, camera, centre, size, density)
    if coarse is None:
        return
    whole = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
    through, middle, spread = (np.array(whole[..., i], np.float32).ravel() for i in range(3))
    pixels = np.flatnonzero(np.isfinite(depth))
    reach = depth.take(pixels) * maps.length.take(pixels)
    # The logistic curve is the normal distribution's within 0.01.
    before = np.exp(np.float32(-1.702) * (reach - middle.take(pixels)) / spread.take(pixels))
    through[pixels] /= 1 + before
    left = np.exp(-through).reshape(camera.height, camera.width)
    front = 1 - np.exp(np.float32(-water.veil_growth) * middle.reshape(left.shape))
    lens = maps.lens.reshape(left.shape)
    picture = light.reshape(camera.height, camera.width, 3)
    blurred = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX * maps.scale)
    veil = maps.open_water.reshape(picture.shape)
    for colour in range(3):
        sharp = picture[..., colour]
        seen = blurred[..., colour] + (sharp - blurred[..., colour]) * left
        shine = veil[..., colour] * front + whole[..., 3 + colour] * lens
        picture[..., colour] = shine + (seen - shine) * left


def _along_rays(
    water: Water, maps: ViewMaps, camera: Camera, centre: F64, size: F64, density: F64
) -> F32 | None:
    """Over a coarse grid: attenuation, mean distance, its spread, and the dust's shine (BGR)."""
    near = centre[:, 2] > -2 * size
    centre, size, density = centre[near], size[near], density[near]
    columns, rows = (round(pixels / _COARSE_PX) for pixels in (camera.width, camera.height))
    u = (np.arange(columns) + 0.5) * camera.width / columns - 0.5
    v = (np.arange(rows) + 0.5) * camera.height / rows - 0.5
    x = (u - camera.matrix[0, 2]) / camera.matrix[0, 0]
    y = (v - camera.matrix[1, 2]) / camera.matrix[1, 1]
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


def _shine(water: Water, maps: ViewMaps, rays: F64, distance: F32, share: F32) -> list[F32]:
    """Grey levels of dust so thick that nothing is seen through it."""
    lamp_squared = np.square(distance) - 2 * distance * (rays @ maps.lamp).astype(np.float32)
    lamp_squared = np.maximum(lamp_squared + maps.lamp @ maps.lamp, _NEAREST_M**2)
    lamp_distance = np.sqrt(lamp_squared)
    on_axis = distance * (rays @ maps.lamp_axis) - maps.lamp @ maps.lamp_axis
    off_axis = np.arccos((on_axis / lamp_distance).clip(-1, 1)) / lighting.LAMP_BEAM_RAD
    lit = share * _ALBEDO * np.exp(-0.5 * np.square(off_axis)) / lamp_squared
    path = distance + lamp_distance
    return [
        np.asarray((lit * np.exp(-attenuation * path)).sum(axis=0) * lamp, np.float32)
        for attenuation, lamp in zip(water.attenuation, water.lamp, strict=True)
    ]
