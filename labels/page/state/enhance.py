"""Nearly black frames made visible, for eyes only: never for features.

The lamps' light on the water is taken away as a smooth background and what differs from it is
amplified, in floating point: averaging over pixels resolves far less than one grey level. What is
amplified is brightness, added to all colours of the frame alike: fine detail and the camera's
colours stay as they are, with no more noise than the frame has, and no colour that is not there.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, U8
from tokt.features.kernels.checks import check_frame

STRONGEST = 100
DEFAULT_AMOUNT = 60
"""Seen on the sea trial of 20 April 2016: here the tower can be made out in frame 140, where the
frame itself shows nothing, and 186, close to it, is not saturated. Above 80 the steps of the
camera's grey levels show as rings."""

_FULL_BACKGROUND = 40.0  # the amount from which the light of the lamps is gone altogether
_WORKING_WIDTH = 680  # pixels; what is amplified has no finer detail, as single pixels are noise
_SMOOTHING = 1.5  # pixels of the working picture, when it is as wide as that
_MIN_SMOOTHING = 0.8
_LOW_STEP = 8  # working pixels for one of the background's
_BACKGROUND = 0.08  # standard deviation of the background's window, of the width
_ROUNDS = 4
_OUTLIER = 6.0  # grey levels from the background; what is further away is not water
_MIDDLE = 105.0  # the grey level that the background becomes
_SPREAD = 30.0  # grey levels, standard deviation, that strong structure is brought to at most
_COMPRESSED = 30.0  # grey levels; a lit tower counts as hardly more in how much there is to see
_SOFT_LIMIT = 200.0  # grey levels; bends the amplified ones so that bright things keep shades
_GRAY = np.array([[0.114, 0.587, 0.299]], np.float32)  # of B, G, R; ITU-R BT.601


def gain(amount: int) -> float:
    """How many times `enhanced` amplifies what is faint."""
    return 1 + amount / 4


def enhanced(frame: U8, amount: int = DEFAULT_AMOUNT) -> U8:
    """A frame with its local contrast amplified, of the same shape.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        Gray or BGR.
    amount : int
        0 (the frame as it is) to 100: faint structure is amplified ``1 + amount / 4`` times,
        less where there is strong structure nearby. Up to 40 the light of the lamps fades away,
        from there on the water is evenly bright. Colours are the camera's.

    Raises
    ------
    TypeError, ValueError
        If the frame has another type or shape, or the amount is out of range.
    """
    frame = check_frame(frame, 1)
    _check_amount(amount)
    if amount == 0:
        return frame
    height, width = frame.shape[:2]
    change: F32 = np.asarray(
        cv2.resize(_change(_working(frame), amount), (width, height)), np.float32
    )
    return np.asarray(cv2.add(_like(frame, change), frame, dtype=cv2.CV_8U), np.uint8)


def enhanced_small(frame: U8, amount: int = DEFAULT_AMOUNT) -> U8:
    """`enhanced`, made smaller by a whole number to a width of about 680 pixels; faster."""
    frame = check_frame(frame, 1)
    _check_amount(amount)
    picture = _working(frame)
    if amount:
        picture += _like(picture, _change(picture, amount))
    return np.asarray(picture.round().clip(0, 255), np.uint8)


def working_width(width: int) -> int:
    """How wide `enhanced_small` makes a frame of a width in pixels."""
    return width // _step(width)


def _step(width: int) -> int:
    return max(1, round(width / _WORKING_WIDTH))


def _check_amount(amount: int) -> None:
    if not 0 <= amount <= STRONGEST:
        raise ValueError(f"the enhancement is 0 to {STRONGEST}, not {amount}")


def _working(frame: U8) -> F32:
    """The frame as floating point, made smaller by a whole number: sums of pixels, not rounded."""
    height, width = frame.shape[:2]
    step = _step(width)
    picture = frame.astype(np.float32)
    if step == 1:
        return picture
    size = (width // step, max(1, height // step))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float32)


def _like(picture: NDArray[Any], change: F32) -> F32:
    """A change of brightness for each of a picture's colours."""
    return np.asarray(cv2.cvtColor(change, cv2.COLOR_GRAY2BGR)) if picture.ndim == 3 else change


def _change(picture: F32, amount: int) -> F32:
    """By how much to brighten the pixels of a working picture, of its height and width."""
    height, width = picture.shape[:2]
    gray = np.asarray(cv2.transform(picture, _GRAY)) if picture.ndim == 3 else picture
    smoothing = max(_MIN_SMOOTHING, _SMOOTHING * width / _WORKING_WIDTH)
    gray = np.asarray(cv2.GaussianBlur(gray, (0, 0), smoothing))
    low_size = (max(1, width // _LOW_STEP), max(1, height // _LOW_STEP))
    low = cv2.resize(gray, low_size, interpolation=cv2.INTER_AREA)
    background, gains = _background(np.asarray(low), gain(amount))
    difference = gray - np.asarray(cv2.resize(background, (width, height)))
    bright = difference * np.asarray(cv2.resize(gains, (width, height)))
    bright /= 1 + np.abs(bright) / _SOFT_LIMIT
    bright += _MIDDLE - gray
    return np.asarray(bright * min(1.0, amount / _FULL_BACKGROUND), np.float32)


def _background(low: F32, most: float) -> tuple[F32, F32]:
    """The water behind a small gray picture, and how much to amplify, pixel by pixel.

    A lit tower is left out of the background round by round: else there would be a dark halo
    around it, which looks like something.
    """
    sigma = max(0.5, _BACKGROUND * low.shape[1])

    def window(values: NDArray[Any]) -> F32:
        blurred = cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
        return np.asarray(blurred, np.float32)

    background = window(low)
    for _ in range(_ROUNDS):
        weights = 1 / (1 + ((low - background) / _OUTLIER) ** 4) + np.float32(1e-3)
        background = window(low * weights) / window(weights)
    seen = np.abs(low - background)
    seen /= 1 + seen / _COMPRESSED
    spread = np.sqrt(window(seen * seen))
    return background, (_SPREAD / np.maximum(spread, 1e-3)).clip(1, most)
