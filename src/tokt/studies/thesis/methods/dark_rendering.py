"""A badly lit picture of the tower, rendered, with its exact mask: it stands in for the thesis's.

The lamp is turned down: what the tower, the water and its snow send back falls by one factor, and
the sensor's read noise stays. At 1 the picture is as bright as a rendered mission's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tokt.inference.stereo.calibration import StereoCalibration
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.simulation.rendering.lighting import Exposure, expose
from tokt.studies.simulation.rendering.patch_labels import MIN_CONTRAST, contrast
from tokt.studies.simulation.rendering.raycast import cast_rays
from tokt.studies.simulation.rendering.sensor import develop
from tokt.studies.simulation.rendering.synthetic_mission import MissionScene
from tokt.studies.simulation.scene.rig import FULL_WIDTH, SyntheticRig
from tokt.studies.simulation.scene.water import CameraResponse, Water

from .patch_scores import Flags

SEED = 8
RENDERED_WIDTHS = (360, FULL_WIDTH)
"""Least and largest width in pixels of a picture; the methods look at 360."""
_FRAMES = 40
_PLACE = 27
"""The 28th of 40 frames: the tower is about three metres away and fills a part of the picture."""
_MOMENT, _SENSOR = 0, 1


@dataclass(frozen=True)
class DarkPair:
    """A rendered stereo pair in bad light.

    Parameters
    ----------
    left, right : array of uint8, shape (height, width, 3)
        BGR.
    mask : array of uint8, shape (height, width)
        255 on the tower in the left picture: its geometry, however little of it can be seen.
    visible : array of bool, shape (n_patches,)
        Patches in which the tower differs from the water by what a person can make out.
    nearest_m : float
        Least depth of the tower, metres.
    calibration : StereoCalibration
        The exact one.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    visible: Flags
    nearest_m: float
    calibration: StereoCalibration


class DarkScene:
    """One moment at the tower, seen in any light.

    Parameters
    ----------
    width : int
        Of the pictures, in pixels.
    seed : int
        The same scene, snow and noise for every light.
    """

    def __init__(self, width: int = FULL_WIDTH, seed: int = SEED) -> None:
        self._scene, self._seed = MissionScene.draw(seed, _FRAMES, width), seed
        self._pose = self._scene.poses[_PLACE]
        cameras = self._pose.cameras(self._scene.rig)
        self._views = [cast_rays(self._scene.tower, camera) for camera in cameras]

    def at(self, light: float) -> DarkPair:
        """The pair by a lamp of `light`, as a share of a rendered mission's."""
        water = _dimmed(self._scene.water, light)
        (left, exposure), (right, _) = (
            self._picture(water, side, response)
            for side, response in enumerate((water.left, water.right))
        )
        view = self._views[0]
        depth = view.image(view.depth)
        mask = np.isfinite(depth)
        return DarkPair(
            left,
            right,
            mask.astype(np.uint8) * 255,
            _visible(exposure, mask),
            float(depth.min()),
            _calibration(self._scene.rig),
        )

    def _picture(
        self, water: Water, side: int, response: CameraResponse
    ) -> tuple[NDArray[np.uint8], Exposure]:
        """One camera's picture, and the light that came to its sensor."""
        moment = np.random.default_rng([self._seed, _MOMENT])
        exposure = expose(water, self._scene.rig, self._pose, self._views[side], response, moment)
        noise = np.random.default_rng([self._seed, _SENSOR, side])
        return develop(water, exposure, noise), exposure


def _dimmed(water: Water, light: float) -> Water:
    def times(values: tuple[float, float, float]) -> tuple[float, float, float]:
        blue, green, red = values
        return blue * light, green * light, red * light

    return replace(
        water,
        lamp=times(water.lamp),
        veil=times(water.veil),
        veil_floor=times(water.veil_floor),
        snow_brightness=water.snow_brightness * light,
    )


def _visible(exposure: Exposure, mask: NDArray[np.bool_]) -> Flags:
    seen = contrast(exposure.clean, exposure.open_water, mask, GRID)
    return np.asarray(seen >= MIN_CONTRAST)


def _calibration(rig: SyntheticRig) -> StereoCalibration:
    straight = np.zeros(5)
    return StereoCalibration(
        rig.left,
        straight,
        rig.right,
        straight,
        rig.rotation,
        1000.0 * rig.translation_m.reshape(3, 1),
        (rig.width, rig.height),
    )
