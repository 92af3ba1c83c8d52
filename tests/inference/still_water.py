"""Still water before a vehicle on station, and what a frozen picture of it may come as."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

RNG = np.random.default_rng(3)
Picture = NDArray[np.uint8]


def light(brightest: float, darkest: float, height: int, width: int) -> NDArray[np.float64]:
    """Grey levels that fall off from the middle."""
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return brightest - (brightest - darkest) * (x**2 + y**2) / 2


def water(lit: NDArray[np.float64], sigma: float = 1.0, rng: Any = RNG) -> Picture:
    """A new picture of it, with the noise of a sensor."""
    return np.clip(lit + rng.normal(0, sigma, lit.shape), 0, 255).round().astype(np.uint8)


def jpeg(picture: Picture, quality: int) -> Picture:
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))


def dithered(picture: Picture) -> Picture:
    """With noise of a grey level on it."""
    return np.asarray(picture + RNG.integers(-1, 2, picture.shape), np.uint8)


def with_clock(picture: Picture, number: int) -> Picture:
    return np.asarray(cv2.putText(picture.copy(), f"{number}", (5, 20), 0, 0.6, (255,) * 3, 2))


def with_bit(picture: Picture, number: int) -> Picture:
    changed = picture.copy()
    changed[number * 7 % len(changed), number * 5 % changed.shape[1]] ^= 1
    return changed


def flickering(picture: Picture, number: int) -> Picture:
    """By 1 % brighter or darker."""
    return np.asarray(np.clip(picture * (1.01 - number % 2 / 50), 0, 255), np.uint8)
