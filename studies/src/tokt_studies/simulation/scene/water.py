"""The conditions of one dive: water, lamp, snow and the two cameras' response."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class CameraResponse:
    """One camera's response: the veil of open water over its picture, and its gain.

    `centre` and `spread` are (x, y) in frame widths: the veil is brightest where the lamp's beam
    crosses the camera's view.
    """

    centre: tuple[float, float]
    spread: tuple[float, float]
    gain: float


@dataclass(frozen=True)
class Water:
    """Water, lamp and camera of one mission; triples are blue, green, red."""

    attenuation: Triple = (0.055, 0.065, 0.115)  # 1/m
    veil: Triple = (58.0, 26.7, 14.0)  # grey levels of open water at its brightest, over the floor
    veil_floor: Triple = (3.3, 2.5, 2.1)
    veil_growth: float = 0.30  # 1/m: how fast the veil closes with range
    lamp: Triple = (1900.0, 1600.0, 1120.0)  # of a white surface one metre from lamp and camera
    snow_per_frame: int = 1000  # particles in view
    snow_brightness: float = 900.0  # of a particle in focus at one metre, summed over its pixels
    read_noise: Triple = (0.33, 0.18, 0.20)  # grey levels
    shot_noise: Triple = (0.0055, 0.0055, 0.012)  # grey levels squared a grey level
    blur_px: float = 0.8  # spread of a point by the lens, and by water in front of it
    blur_px_per_m: float = 0.25
    glow: float = 0.05  # share of a surface's light that is scattered forward into a halo
    left: CameraResponse = field(default=CameraResponse((0.71, 0.30), (0.405, 0.50), 1.0))
    right: CameraResponse = field(default=CameraResponse((0.60, 0.17), (0.38, 0.52), 1.48))

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Water:
        """One dive's conditions, spread about those of the mission as days at sea differ."""
        base = cls()

        def times(values: Triple, low: float, high: float) -> Any:
            factor = rng.uniform(low, high)
            return tuple(round(value * factor, 6) for value in values)

        return cls(
            attenuation=times(base.attenuation, 0.8, 1.25),
            veil=times(base.veil, 0.78, 1.12),
            veil_floor=times(base.veil_floor, 0.8, 1.2),
            veil_growth=round(base.veil_growth * rng.uniform(0.8, 1.25), 6),
            lamp=times(base.lamp, 0.8, 1.4),
            snow_per_frame=round(base.snow_per_frame * rng.uniform(0.6, 1.5)),
            snow_brightness=round(base.snow_brightness * rng.uniform(0.7, 1.4), 6),
            read_noise=times(base.read_noise, 0.85, 1.4),
            shot_noise=times(base.shot_noise, 0.85, 1.15),
        )
