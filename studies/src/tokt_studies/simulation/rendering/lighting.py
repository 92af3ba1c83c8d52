"""Image formation of simulated missions: dark water, a lamp and a camera's response.

Light from the lamp reaches a surface at distance r_l and returns to the camera over r, so a
surface shows ``albedo * lamp * beam / r_l**2 * exp(-c (r_l + r))`` (Beer-Lambert) in front of a
veil of back-scattered light ``veil * (1 - exp(-b r))``, as in Jaffe (1990), "Computer modeling
and the design of optimal underwater imaging systems". Light scattered forward on the way blurs
it. Marine snow, the sensor's noise and 8 bits come on top. Grey levels are those of the mission.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32
from tokt_studies.simulation.scene.rig import FULL_WIDTH, Camera, SyntheticRig
from tokt_studies.simulation.scene.water import CameraResponse, Water

from .raycast import View
from .snow import marine_snow
from .trajectory import CameraPose

LAMP_AT_M = (-0.45, -0.35, 0.0)
LAMP_TOWARDS = (0.10, 0.03, 1.0)
LAMP_BEAM_RAD = 0.45
"""The lamp beside the left camera: place and axis in camera coordinates, width of its beam."""
SNOW_TINT = (1.0, 0.85, 0.75)
"""Blue, green and red of a particle."""
DIM, FACING, NO_SIDE = 0.18, 0.82, 0.5
"""Light on a side that faces away, what facing the lamp adds to it, and light on a stalk."""
BRIGHTEST = 400.0
"""Grey levels above which a surface is not drawn brighter: 8 bits end before."""
UNEVEN = 0.006
"""Standard deviation of the water's own clouds, relative to the veil."""


@dataclass(frozen=True)
class Exposure:
    """One camera's frame before the sensor: linear grey levels, (height, width, 3) float32 BGR."""

    open_water: F32
    tower: F32
    snow: F32

    @property
    def clean(self) -> F32:
        """Water and tower without snow or noise."""
        return self.open_water + self.tower


def expose(
    water: Water, pose: CameraPose, view: View, response: CameraResponse, rng: np.random.Generator
) -> Exposure:
    """Image formation of one camera.

    `rng` is of the water at this moment: give both cameras the same, so that they see the same
    snow.
    """
    shape = illumination(view.camera, response)
    drift = rng.uniform(0.97, 1.03)
    clouds = rng.standard_normal((9, 12)).astype(np.float32)
    uneven = 1 + UNEVEN * cv2.resize(clouds, shape.shape[::-1], interpolation=cv2.INTER_CUBIC)
    veil = np.array(water.veil, np.float32) * (shape * uneven * np.float32(drift))[..., None]
    open_water = (veil + np.array(water.veil_floor, np.float32)) * np.float32(response.gain)
    tower = tower_light(water, pose, view, open_water, response.gain)
    snow = marine_snow(water, pose, view, rng)
    tint = np.array(SNOW_TINT, np.float32) * np.float32(response.gain)
    return Exposure(open_water, tower, (snow * shape)[..., None] * tint)


def illumination(rig: SyntheticRig | Camera, response: CameraResponse) -> F32:
    """Back-scattered light over the picture, 1 at its brightest: beam and vignette together."""
    x = (np.arange(rig.width, dtype=np.float32) + 0.5) / rig.width
    y = (np.arange(rig.height, dtype=np.float32) + 0.5) / rig.width
    across = np.exp(-0.5 * ((x - response.centre[0]) / response.spread[0]) ** 2)
    down = np.exp(-0.5 * ((y - response.centre[1]) / response.spread[1]) ** 2)
    return np.asarray(np.outer(down, across) * vignette(x[None, :], y[:, None], rig), np.float32)


def vignette(x: NDArray[Any], y: NDArray[Any], rig: SyntheticRig | Camera) -> NDArray[Any]:
    """Fall-off of the lens towards the corners; x, y in frame widths."""
    radius_squared = (x - 0.5) ** 2 + (y - rig.height / rig.width / 2) ** 2
    return np.asarray(1 - 0.25 * (radius_squared / 0.39) ** 6)


def tower_light(water: Water, pose: CameraPose, view: View, open_water: F32, gain: float) -> F32:
    """The tower's change of the open water, in grey levels; it may darken."""
    change = np.zeros_like(open_water)
    pixels = view.pixels
    if not len(pixels):
        return change
    camera, depth = view.camera, view.depth[pixels]
    ray = camera.rotation.T @ camera.rays(pixels)
    to_surface = depth * ray
    distance = np.sqrt(np.square(to_surface).sum(axis=0))
    from_lamp = to_surface + (
        camera.centre - pose.centre - pose.rotation.T @ np.array(LAMP_AT_M)
    )[:, None]  # fmt: skip
    lamp_distance = np.sqrt(np.square(from_lamp).sum(axis=0))
    axis = pose.rotation.T @ np.array(LAMP_TOWARDS) / np.linalg.norm(LAMP_TOWARDS)
    off_axis = np.arccos((axis @ from_lamp / lamp_distance).clip(-1, 1))
    normal = view.normal[:, pixels]
    facing = -(from_lamp * normal).sum(axis=0) / lamp_distance
    # Water scatters light round corners: a side that faces away is dim, not black.
    lit = np.where(np.abs(normal).sum(axis=0) > 0, DIM + FACING * facing.clip(0), NO_SIDE)
    v, u = np.divmod(pixels, camera.width)
    lit *= np.exp(-0.5 * (off_axis / LAMP_BEAM_RAD) ** 2) / lamp_distance**2
    lit *= gain * vignette((u + 0.5) / camera.width, (v + 0.5) / camera.width, camera)
    path = (lamp_distance + distance).astype(np.float32)
    flat = change.reshape(-1, 3)
    behind = open_water.reshape(-1, 3)[pixels]
    seen = np.exp(-path[:, None] * np.array(water.attenuation, np.float32)) * view.albedo[pixels]
    seen *= np.array(water.lamp, np.float32) * lit[:, None].astype(np.float32)
    seen -= behind * np.exp(-water.veil_growth * distance)[:, None].astype(np.float32)
    flat[pixels] = np.minimum(seen, np.float32(BRIGHTEST))
    spread = water.blur_px + water.blur_px_per_m * float(distance.min())
    return scattered(change, v, u, spread * (camera.width / FULL_WIDTH), water.glow)


def scattered(change: F32, v: Any, u: Any, spread_px: float, glow: float) -> F32:
    """Blur the tower's light, and let a share of it glow around it."""
    rim = int(np.ceil(4 * spread_px)) + 1
    top, bottom = max(int(v.min()) - rim, 0), int(v.max()) + rim + 1
    left, right = max(int(u.min()) - rim, 0), int(u.max()) + rim + 1
    box = change[top:bottom, left:right]
    box[:] = cv2.GaussianBlur(box, (0, 0), spread_px)
    height, width = change.shape[:2]
    small = cv2.resize(change, (85, 64), interpolation=cv2.INTER_AREA)
    halo = cv2.GaussianBlur(np.maximum(small, 0), (0, 0), 5.0)
    change += np.float32(glow) * cv2.resize(halo, (width, height), interpolation=cv2.INTER_LINEAR)
    return change
