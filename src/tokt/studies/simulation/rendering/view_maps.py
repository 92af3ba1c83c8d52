"""Maps that never change for one camera in one water: rays, the lamp's place, open water."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.rig import SyntheticRig
from tokt.studies.simulation.scene.water import Water

from .lighting import LAMP_AT_M, LAMP_TOWARDS, SNOW_TINT, illumination, vignette

Float = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class ViewMaps:
    """Maps over the pixels of one camera, in its own coordinates (x right, y down, z ahead).

    Attributes
    ----------
    matrix : (3, 3) float64
        Camera matrix.
    turn, shift : (3, 3), (3,) float64
        A point of the left camera is seen at ``turn @ point + shift``.
    rays : (3, pixels) float32
        Direction of each pixel, of length one along the optical axis.
    length : (pixels,) float32
        Norm of the ray.
    lamp : (3,) float64
        Where the lamp is.
    lamp_along, lamp_beam : (pixels,) float32
        Ray times the lamp's place, and times the unit vector that it shines along.
    lens : (pixels,) float32
        Gain and fall-off towards the corners.
    open_water, floor : (height, 3 * width) float32
        Grey levels of open water: the veil where the water is even, and what is under it.
    snow_gain : (height, 3 * width) float32
        Grey levels of a particle for each of its brightness.
    """

    width: int
    height: int
    scale: float
    matrix: Float
    turn: Float
    shift: Float
    rays: Single
    length: Single
    lamp: Float
    lamp_axis: Float
    lamp_along: Single
    lamp_beam: Single
    lens: Single
    open_water: Single
    floor: Single
    snow_gain: Single

    @classmethod
    def of(cls, water: Water, rig: SyntheticRig, side: int) -> ViewMaps:
        """The maps of the left camera (0) or the right one (1)."""
        matrix, response = ((rig.left, water.left), (rig.right, water.right))[side]
        turn = (np.eye(3), rig.rotation)[side]
        shift = (np.zeros(3), rig.translation_m)[side]
        x = (np.arange(rig.width) - matrix[0, 2]) / matrix[0, 0]
        y = (np.arange(rig.height) - matrix[1, 2]) / matrix[1, 1]
        rays = np.stack([*np.meshgrid(x, y), np.ones((rig.height, rig.width))]).reshape(3, -1)
        lamp = turn @ LAMP_AT_M + shift
        axis = turn @ LAMP_TOWARDS / np.linalg.norm(LAMP_TOWARDS)
        across = (np.arange(rig.width) + 0.5) / rig.width
        down = (np.arange(rig.height) + 0.5) / rig.width
        shape = illumination(rig, response)[..., None]
        size = (rig.height, 3 * rig.width)

        def single(values: Any) -> Single:
            return np.ascontiguousarray(values, np.float32)

        return cls(
            rig.width,
            rig.height,
            rig.scale,
            matrix,
            turn,
            shift,
            single(rays),
            single(np.linalg.norm(rays, axis=0)),
            lamp,
            axis,
            single(lamp @ rays),
            single(axis @ rays),
            single(response.gain * vignette(across[None, :], down[:, None], rig)).ravel(),
            single(shape * np.array(water.veil) * response.gain).reshape(size),
            single(np.ones_like(shape) * np.array(water.veil_floor) * response.gain).reshape(size),
            single(shape * np.array(SNOW_TINT) * response.gain).reshape(size),
        )

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width * self.height

    def project(self, points: Float) -> Float:
        """Columns and rows (..., 2) of points (..., 3) in front of this camera."""
        there = points[..., :2] / points[..., 2:] * self.matrix[0, 0] + self.matrix[:2, 2]
        return np.asarray(there)


@dataclass(frozen=True, eq=False)
class Standpoint:
    """One camera at one moment: a world point p is seen at ``rotation @ (p - centre)``."""

    rotation: Float
    centre: Float

    @classmethod
    def of(cls, maps: ViewMaps, position: Float, heading_rad: float) -> Standpoint:
        """The standpoint of `maps` with the left camera at `position`, level, at that heading."""
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        level = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        rotation = maps.turn @ level
        return cls(rotation, position - rotation.T @ maps.shift)

    def seen(self, points: Float) -> Float:
        """World points (..., 3) in this camera's coordinates."""
        return np.asarray((points - self.centre) @ self.rotation.T)
