"""Still water before a vehicle on station, and what a frozen picture of it may come as."""

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

RNG = np.random.default_rng(3)
_START = RNG.bit_generator.state
Picture = NDArray[np.uint8]


def begin_anew() -> None:
    """Draw from now on what is drawn first in every test, whichever tests ran before."""
    RNG.bit_generator.state = _START


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


def moved(
    picture: Picture, x_px: float = 0.0, y_px: float = 0.0, degrees: float = 0.0, zoom: float = 1.0
) -> Picture:
    """Shifted, turned and enlarged, its edges mirrored."""
    height, width = picture.shape[:2]
    how = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, zoom)
    how[:, 2] += x_px, y_px
    return np.asarray(cv2.warpAffine(picture, how, (width, height), borderMode=cv2.BORDER_REFLECT))


def filtered_in_time(pictures: Iterable[Picture], gain: float) -> list[Picture]:
    """As a camera gives them that mixes each one, with this weight, into those before."""
    mixed, given = None, []
    for picture in pictures:
        new = picture.astype(np.float64)
        mixed = new if mixed is None else mixed + gain * (new - mixed)
        given.append(mixed.round().astype(np.uint8))
    return given
