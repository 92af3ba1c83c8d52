"""A sensor's noise and the water's clouds, drawn once and read at places that time decides."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.water import Water

from .lighting import UNEVEN
from .sensor import KERNEL, noise_factor, unit_noise

Single = NDArray[np.float32]

_CLOUD_ROWS, _CLOUD_COLUMNS = 9, 12
"""Knots of the clouds over one frame."""


@dataclass(frozen=True, eq=False)
class NoiseBank:
    """Values over an area of four frames, (2 * height, 3 * 2 * width) float32: blue, green, red.

    Frames cut from it at random share rows at most by chance, never the whole of their noise.
    """

    values: Single

    def cut(self, rng: np.random.Generator) -> Single:
        """A frame of (height, 3 * width) at a place drawn at random."""
        height, width = self.values.shape[0] // 2, self.values.shape[1] // 6
        row, column = int(rng.integers(height + 1)), 3 * int(rng.integers(width + 1))
        return self.values[row : row + height, column : column + 3 * width]


def sensor_bank(rng: np.random.Generator, height: int, width: int) -> NoiseBank:
    """Noise of a sensor whose pixels have unit deviation before the colours are interpolated."""
    noise = unit_noise(rng, (2 * height, 2 * width))
    noise *= np.float32(noise_factor(width) / float(np.square(KERNEL).sum()))
    return NoiseBank(noise.reshape(2 * height, 6 * width))


def cloud_bank(rng: np.random.Generator, height: int, width: int) -> NoiseBank:
    """Factors for the veil of open water, which is never quite even."""
    knots = rng.standard_normal((2 * _CLOUD_ROWS, 2 * _CLOUD_COLUMNS)).astype(np.float32)
    clouds = cv2.resize(knots, (2 * width, 2 * height), interpolation=cv2.INTER_CUBIC)
    return NoiseBank(np.repeat(1 + np.float32(UNEVEN) * clouds, 3, axis=1))


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """Shot and read noise of one camera; see `sensor.develop`."""

    bank: NoiseBank
    shot: Single
    read_squared: Single

    @classmethod
    def of(cls, water: Water, rng: np.random.Generator, height: int, width: int) -> SensorNoise:
        """The sensor of a camera with frames of this size."""
        shot, read = (
            np.tile(np.array(values, np.float32), width)
            for values in (water.shot_noise, water.read_noise)
        )
        return cls(sensor_bank(rng, height, width), shot, read * read)

    def develop(self, light: Single, rng: np.random.Generator) -> NDArray[np.uint8]:
        """Add noise to grey levels (height, 3 * width) in place, and round: (height, width, 3)."""
        np.clip(light, 0, 255, out=light)
        noise = light * self.shot
        noise += self.read_squared
        np.sqrt(noise, out=noise)
        noise *= self.bank.cut(rng)
        light += noise
        rounded = cv2.convertScaleAbs(np.maximum(light, 0, out=light))
        return np.asarray(rounded.reshape(len(light), -1, 3), np.uint8)
