"""Lighting of `fast_raycast`'s hits for the closed loop, as `lighting` does it for missions."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.materials import Materials
from tokt.studies.simulation.scene.surfaces import STALK_MATERIAL
from tokt.studies.simulation.scene.water import Water

from .fast_raycast import Hits
from .lighting import BRIGHTEST, DIM, FACING, LAMP_BEAM_RAD, NO_SIDE, scattered

Single = NDArray[np.float32]


def surface_light(water: Water, materials: Materials, hits: Hits, open_water: Single) -> Single:
    """The surfaces' change of the open water, in grey levels; it may darken.

    Parameters
    ----------
    open_water : (height, 3 * width) float32

    Returns
    -------
    numpy.ndarray
        float32, (height, width, 3), blue, green, red.
    """
    maps, pixels = hits.maps, hits.pixels
    t = hits.depth.take(pixels)
    distance = t * maps.length.take(pixels)
    lamp_squared = distance * distance - 2 * t * maps.lamp_along.take(pixels)
    lamp_squared += np.float32(maps.lamp @ maps.lamp)
    lamp_distance = np.sqrt(lamp_squared)
    on_axis = t * maps.lamp_beam.take(pixels) - np.float32(maps.lamp @ maps.lamp_axis)
    off_axis = np.arccos((on_axis / lamp_distance).clip(-1, 1)) / np.float32(LAMP_BEAM_RAD)
    lit = hits.facing.take(pixels) / lamp_distance
    lit = np.float32(DIM) + np.float32(FACING) * np.maximum(lit, 0)
    material_number, along = hits.material_number.take(pixels), hits.along.take(pixels)
    pixel_m = t / np.float32(maps.matrix[0, 0])
    bright, rust = materials.look_up(material_number, hits.across.take(pixels), along, pixel_m)
    shade = np.float32(0.35) + np.float32(1.1) * bright
    stalks = np.flatnonzero(material_number == STALK_MATERIAL)
    lit[stalks], shade[stalks], rust[stalks] = NO_SIDE, along[stalks], 0
    lit *= np.exp(np.float32(-0.5) * off_axis * off_axis) / lamp_squared
    lit *= maps.lens.take(pixels) * shade
    hidden = np.exp(np.float32(-water.veil_growth) * distance)
    path = lamp_distance + distance
    planes = np.zeros((3, maps.height, maps.width), np.float32)
    for colour, plane in enumerate(planes):
        light = np.exp(np.float32(-water.attenuation[colour]) * path)
        light *= materials.paint[colour].take(material_number) + rust * materials.rust[colour].take(
            material_number
        )
        light *= lit
        light *= np.float32(water.lamp[colour])
        light -= open_water.take(3 * pixels + colour) * hidden
        plane.ravel()[pixels] = np.minimum(light, np.float32(BRIGHTEST))
    change = np.asarray(cv2.merge(list(planes)), np.float32)
    spread = (water.blur_px + water.blur_px_per_m * float(distance.min())) * maps.scale
    columns = np.flatnonzero(np.isfinite(hits.depth.reshape(maps.height, -1)).any(axis=0))
    return scattered(change, pixels[[0, -1]] // maps.width, columns, spread, water.glow)
