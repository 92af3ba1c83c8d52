"""How lamp and water turn what an eye's rays hit into light, as `light` does it for missions."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .hits import Hits
from .light import BRIGHTEST, DIM, FACING, LAMP_BEAM_RAD, NO_SIDE, scattered
from .skins import Skins
from .surfaces import STALK_SKIN
from .water import Water

Single = NDArray[np.float32]


def surface_light(water: Water, skins: Skins, hits: Hits, open_water: Single) -> Single:
    """What surfaces change of the open water, in grey levels; it may darken.

    Parameters
    ----------
    open_water : (height, 3 * width) float32

    Returns
    -------
    numpy.ndarray
        float32, (height, width, 3), blue, green, red.
    """
    eye, pixels = hits.eye, hits.pixels
    t = hits.depth.take(pixels)
    distance = t * eye.length.take(pixels)
    lamp_squared = distance * distance - 2 * t * eye.lamp_along.take(pixels)
    lamp_squared += np.float32(eye.lamp @ eye.lamp)
    lamp_distance = np.sqrt(lamp_squared)
    on_axis = t * eye.lamp_beam.take(pixels) - np.float32(eye.lamp @ eye.lamp_axis)
    off_axis = np.arccos((on_axis / lamp_distance).clip(-1, 1)) / np.float32(LAMP_BEAM_RAD)
    lit = hits.facing.take(pixels) / lamp_distance
    lit = np.float32(DIM) + np.float32(FACING) * np.maximum(lit, 0)
    skin, along = hits.skin.take(pixels), hits.along.take(pixels)
    pixel_m = t / np.float32(eye.matrix[0, 0])
    bright, rust = skins.look_up(skin, hits.across.take(pixels), along, pixel_m)
    shade = np.float32(0.35) + np.float32(1.1) * bright
    stalks = np.flatnonzero(skin == STALK_SKIN)
    lit[stalks], shade[stalks], rust[stalks] = NO_SIDE, along[stalks], 0
    lit *= np.exp(np.float32(-0.5) * off_axis * off_axis) / lamp_squared
    lit *= eye.lens.take(pixels) * shade
    hidden = np.exp(np.float32(-water.veil_growth) * distance)
    path = lamp_distance + distance
    planes = np.zeros((3, eye.height, eye.width), np.float32)
    for colour, plane in enumerate(planes):
        light = np.exp(np.float32(-water.attenuation[colour]) * path)
        light *= skins.paint[colour].take(skin) + rust * skins.rust[colour].take(skin)
        light *= lit
        light *= np.float32(water.lamp[colour])
        light -= open_water.take(3 * pixels + colour) * hidden
        plane.ravel()[pixels] = np.minimum(light, np.float32(BRIGHTEST))
    change = np.asarray(cv2.merge(list(planes)), np.float32)
    spread = (water.blur_px + water.blur_px_per_m * float(distance.min())) * eye.scale
    columns = np.flatnonzero(np.isfinite(hits.depth.reshape(eye.height, -1)).any(axis=0))
    return scattered(change, pixels[[0, -1]] // eye.width, columns, spread, water.glow)
