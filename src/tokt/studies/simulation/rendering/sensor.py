"""The camera's sensor: shot and read noise, and 8 bits."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.rig import FULL_WIDTH
from tokt.studies.simulation.scene.water import Water

from .lighting import Exposure

_GRID_WIDTH = 360
KERNEL = np.array([0.27, 0.46, 0.27], np.float32)
"""How a colour filter's interpolation spreads a pixel's noise to its neighbours."""


def develop(water: Water, exposure: Exposure, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add the sensor's noise and round to 8 bits: (height, width, 3) uint8."""
    light = exposure.clean
    light += exposure.snow
    np.clip(light, 0, 255, out=light)
    noise = unit_noise(rng, light.shape[:2])
    variance = light * np.array(water.shot_noise, np.float32)
    variance += np.square(np.array(water.read_noise, np.float32))
    noise *= cv2.sqrt(variance)
    noise *= np.float32(noise_factor(light.shape[1]) / float(np.square(KERNEL).sum()))
    light += noise
    return np.asarray(cv2.convertScaleAbs(np.maximum(light, 0, out=light)), np.uint8)


def unit_noise(rng: np.random.Generator, size: tuple[int, ...]) -> NDArray[np.float32]:
    """Noise (height, width, 3) of unit deviation, spread over neighbours and colours."""
    shared = rng.standard_normal(size, np.float32)
    noise = rng.standard_normal((*size, 3), np.float32)
    noise *= np.float32(0.65)
    noise += np.float32(0.76) * shared[..., None]
    cv2.sepFilter2D(noise, -1, KERNEL, KERNEL, dst=noise)
    return noise


def _noise_left(pixels: float) -> float:
    """Deviation of the mean over a square of `pixels` x `pixels` of noise of unit deviation."""
    correlation = np.correlate(KERNEL, KERNEL, "full")[2:] / np.square(KERNEL).sum()
    pairs = np.maximum(1 - np.arange(len(correlation)) / pixels, 0)
    return float((2 * (correlation * pairs).sum() - 1) / pixels)


def noise_factor(width: int) -> float:
    """Makes the noise that is left after the resize to the grid's width the same at any width."""
    return _noise_left(FULL_WIDTH / _GRID_WIDTH) / _noise_left(max(width / _GRID_WIDTH, 1.0))
