"""The camera's sensor: shot and read noise, and 8 bits.

In the closed loop noise and the water's clouds are drawn once, and read at places that the time
decides.
"""

import cv2
import numpy as np

from tokt.features.common.arrays import F32, U8
from tokt_studies.simulation.scene.rig import FULL_WIDTH
from tokt_studies.simulation.scene.water import Water

from .lighting import UNEVEN, Exposure

_GRID_WIDTH = 360
_CLOUD_ROWS, _CLOUD_COLUMNS = 9, 12
"""Knots of the clouds over one frame."""
_KERNEL = np.array([0.27, 0.46, 0.27], np.float32)
"""How a colour filter's interpolation spreads a pixel's noise to its neighbours."""


def develop(water: Water, exposure: Exposure, rng: np.random.Generator) -> U8:
    """Add the sensor's noise and round to 8 bits: (height, width, 3) uint8."""
    light = exposure.clean
    light += exposure.snow
    np.clip(light, 0, 255, out=light)
    noise = _unit_noise(rng, light.shape[:2])
    variance = light * np.array(water.shot_noise, np.float32)
    variance += np.square(np.array(water.read_noise, np.float32))
    noise *= cv2.sqrt(variance)
    noise *= _noise_gain(light.shape[1])
    light += noise
    return np.asarray(cv2.convertScaleAbs(np.maximum(light, 0, out=light)), np.uint8)


def _unit_noise(rng: np.random.Generator, size: tuple[int, ...]) -> F32:
    """Noise (height, width, 3) of unit deviation, spread over neighbours and colours."""
    shared = rng.standard_normal(size, np.float32)
    noise = rng.standard_normal((*size, 3), np.float32)
    noise *= np.float32(0.65)
    noise += np.float32(0.76) * shared[..., None]
    cv2.sepFilter2D(noise, -1, _KERNEL, _KERNEL, dst=noise)
    return noise


def _noise_left(pixels: float) -> float:
    """Deviation of the mean over a square of `pixels` x `pixels` of noise of unit deviation."""
    correlation = np.correlate(_KERNEL, _KERNEL, "full")[2:] / np.square(_KERNEL).sum()
    pairs = np.maximum(1 - np.arange(len(correlation)) / pixels, 0)
    return float((2 * (correlation * pairs).sum() - 1) / pixels)


def _noise_gain(width: int) -> np.float32:
    """Makes the noise that is left after the resize to the grid's width the same at any width.

    Its deviation is 1 before the colours are interpolated, at the mission camera's width.
    """
    gain = _noise_left(FULL_WIDTH / _GRID_WIDTH) / _noise_left(max(width / _GRID_WIDTH, 1.0))
    return np.float32(gain / float(np.square(_KERNEL).sum()))


def cut(bank: F32, rng: np.random.Generator) -> F32:
    """A frame of (height, 3 * width) at a place drawn at random in a bank of noise.

    A bank's values are over an area of four frames, (2 * height, 3 * 2 * width): blue, green, red.
    Frames cut from it at random share rows at most by chance, never the whole of their noise.
    """
    height, width = bank.shape[0] // 2, bank.shape[1] // 6
    row, column = int(rng.integers(height + 1)), 3 * int(rng.integers(width + 1))
    return bank[row : row + height, column : column + 3 * width]


def cloud_bank(rng: np.random.Generator, height: int, width: int) -> F32:
    """Factors for the veil of open water, which is never quite even."""
    knots = rng.standard_normal((2 * _CLOUD_ROWS, 2 * _CLOUD_COLUMNS)).astype(np.float32)
    clouds = cv2.resize(knots, (2 * width, 2 * height), interpolation=cv2.INTER_CUBIC)
    return np.repeat(1 + np.float32(UNEVEN) * clouds, 3, axis=1)


class SensorNoise:
    """Shot and read noise of one camera of the closed loop; see `develop`."""

    def __init__(self, water: Water, rng: np.random.Generator, height: int, width: int) -> None:
        noise = _unit_noise(rng, (2 * height, 2 * width))
        noise *= _noise_gain(width)
        self._bank = noise.reshape(2 * height, 6 * width)
        self._shot = np.tile(np.array(water.shot_noise, np.float32), width)
        read = np.tile(np.array(water.read_noise, np.float32), width)
        self._read_squared = read * read

    def develop(self, light: F32, rng: np.random.Generator) -> U8:
        """Add noise to grey levels (height, 3 * width) in place, and round: (height, width, 3)."""
        np.clip(light, 0, 255, out=light)
        noise = light * self._shot
        noise += self._read_squared
        np.sqrt(noise, out=noise)
        noise *= cut(self._bank, rng)
        light += noise
        rounded = cv2.convertScaleAbs(np.maximum(light, 0, out=light))
        return np.asarray(rounded.reshape(len(light), -1, 3), np.uint8)
