"""Attacks on a picture: what can happen to it before it is judged."""

import cv2
import numpy as np


def noise(mean, sigma, colour=False):
    """A covered lens under auto gain, or snow: noise instead of the picture."""

    def of(picture):
        channels = 3 if colour else 1
        noisy = np.empty((*picture.shape[:2], channels), np.uint8)
        cv2.randn(noisy, (mean,) * channels, (sigma,) * channels)
        return noisy if colour else noisy.repeat(3, axis=2)

    return of


def levels(gain, offset):
    """Haze and glow over the whole picture."""
    return lambda picture: cv2.convertScaleAbs(picture, alpha=gain, beta=offset)


def glow_from_below(picture):
    """Light of the lamps that comes back from below."""
    rise = np.linspace(0, 120, len(picture)).reshape(-1, *[1] * (picture.ndim - 1))
    return np.clip(0.5 * picture + rise, 0, 255).astype(np.uint8)


def blurred(sigma):
    """Out of focus, or water on the lens."""
    return lambda picture: cv2.GaussianBlur(picture, (0, 0), sigma)


def inverted(picture):
    """Black is white."""
    return 255 - picture


def zoomed(picture):
    """The middle of the picture, twice as large."""
    height, width = picture.shape[:2]
    part = picture[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR)


def band(top, share, colour):
    """A packet lost: rows of one colour."""

    def of(picture):
        damaged = picture.copy()
        first = round(top * len(picture))
        damaged[first : first + round(share * len(picture))] = colour
        return damaged

    return of


def attacked(name, picture):
    """An attack whose picture has the size that it had."""
    return cv2.resize(ATTACKS[name](picture), picture.shape[1::-1])


GREY, GREEN = (128, 128, 128), (0, 135, 0)
ATTACKS = {
    "noise 12,4": noise(12, 4),
    "noise 60,20": noise(60, 20),
    "noise 128,40": noise(128, 40),
    "noise 12,4 colour": noise(12, 4, True),
    "noise 60,20 colour": noise(60, 20, True),
    "noise 128,40 colour": noise(128, 40, True),
    "haze 0.5": levels(0.5, 50),
    "haze 0.15": levels(0.15, 100),
    "offset": levels(1, 60),
    "glow": glow_from_below,
    "blur 8": blurred(8),
    "inverted": inverted,
    "zoom": zoomed,
    "grey band": band(0.425, 0.15, GREY),
    "green band": band(0.425, 0.15, GREEN),
    "grey end": band(0.91, 0.09, GREY),
    "green end": band(0.91, 0.09, GREEN),
    "turned 90": lambda picture: np.ascontiguousarray(np.rot90(picture)),
    "turned 180": lambda picture: cv2.rotate(picture, cv2.ROTATE_180),
    "mirrored": lambda picture: cv2.flip(picture, 1),
    "upside down": lambda picture: cv2.flip(picture, 0),
    "half contrast": levels(0.5, 0),
    "x2": levels(2, 0),
}
