"""Augmentations: frames as another lamp, water or camera setting would have made them.

A model is to say the same of them. They are learnt from (`TrainingSettings.changes`, the option
``--changes``) and tested on (``tokt train --stress``). Named ``gain_0.5`` (light times a half, as
exposure or a camera's gain change it), ``gamma_0.7`` (each value over 255 to this power, as a
camera's or a recorder's tone curve), ``jpeg_60`` (stored as a JPEG of quality 60) and ``noise_1``
(each value up or down by at most 1, evenly). ``random_9`` is only learnt from: each frame changed
9 times at random (`tokt.training.datasets.frame_changes`).

Of kinds that ``random`` never draws, so that they test a model that learnt from it: ``motion_6``
(smeared along the rows over 6 thousandths of the width), ``snow_60`` (60 bright particles),
``ripple_25`` (light that a rippled surface focuses, up and down by 25 %), ``hue_15`` (all hues
turned by 15 degrees) and ``bits_4`` (4 bits a value are left).

``gray_100`` takes 100 % of the colours away, as a gray camera does; ``random`` draws that, too.
"""

import math
import re
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256

STRESS = (
    *("gain_0.5", "gain_0.7", "gain_1.4", "gain_2"),
    *("gamma_0.7", "gamma_1.4", "jpeg_60", "jpeg_75", "jpeg_95", "noise_1"),
    *("motion_6", "motion_12", "snow_60", "snow_200", "ripple_15", "ripple_30"),
    *("hue_15", "hue_30", "bits_4", "bits_3", "gray_100"),
)
"""What ``--stress`` tests on."""
RANDOM = "random"


def augment(frame: U8, name: str) -> U8:
    """Augment a frame.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    name : str
        Such as ``gain_0.5``.

    Returns
    -------
    numpy.ndarray
        Shape and dtype of `frame`; the same each time.

    Raises
    ------
    ToktError
        If there is no such augmentation.
    """
    kind, value = parse_augmentation(name)
    if kind == "gain":
        return np.asarray(np.clip(np.rint(frame * value), 0, 255), np.uint8)
    if kind == "gamma":
        levels = np.rint(255 * (np.arange(256) / 255) ** value).astype(np.uint8)
        return np.asarray(cv2.LUT(frame, levels), np.uint8)
    if kind == "jpeg":
        data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, int(value)])[1]
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), np.uint8)
    if kind == RANDOM:
        raise ToktError(f"{name}: random changes move patches; they are only learnt from")
    rng = np.random.default_rng(int(pixel_sha256(frame)[:16], 16))
    return _KINDS[kind](frame, value, rng)


def _noise(frame: U8, most: float, rng: np.random.Generator) -> U8:
    noise = rng.integers(-int(most), int(most), frame.shape, np.int16, endpoint=True)
    return np.asarray(np.clip(frame + noise, 0, 255), np.uint8)


def _motion(frame: U8, thousandths: float, rng: np.random.Generator) -> U8:
    length = max(1, round(frame.shape[1] * thousandths / 1000))
    return np.asarray(cv2.blur(frame, (length, 1)), np.uint8)


def _snow(frame: U8, particles: float, rng: np.random.Generator) -> U8:
    """Bright soft discs of 1 to 6 thousandths of the width in radius."""
    height, width = frame.shape[:2]
    light: Any = np.zeros((height, width), np.float32)
    for _ in range(int(particles)):
        at = int(rng.integers(width)), int(rng.integers(height))
        radius = max(1, round(width * rng.uniform(0.001, 0.006)))
        cv2.circle(light, at, radius, float(rng.uniform(30, 140)), cv2.FILLED)
    light = cv2.GaussianBlur(light, (0, 0), max(0.5, width / 1000))
    whole = light if frame.ndim == 2 else light[..., None]
    return np.asarray(np.clip(frame + whole, 0, 255), np.uint8)


def _ripple(frame: U8, percent: float, rng: np.random.Generator) -> U8:
    """Light by a smooth random field of 12 cells in each direction."""
    height, width = frame.shape[:2]
    field = cv2.resize(rng.uniform(-1, 1, (12, 12)), (width, height), interpolation=cv2.INTER_CUBIC)
    gain = 1 + np.clip(field, -1, 1) * percent / 100
    return np.asarray(
        np.clip(frame * (gain if frame.ndim == 2 else gain[..., None]), 0, 255), np.uint8
    )


def _hue(frame: U8, degrees: float, rng: np.random.Generator) -> U8:
    if frame.ndim == 2:
        return frame
    hsv = cv2.cvtColor(frame.astype(np.float32) / 255, cv2.COLOR_BGR2HSV)
    hsv[..., 0] = (hsv[..., 0] + degrees) % 360
    turned = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)
    return np.asarray(np.clip(np.rint(turned * 255), 0, 255), np.uint8)


def _gray(frame: U8, percent: float, rng: np.random.Generator) -> U8:
    if frame.ndim == 2:
        return frame
    gray = cv2.cvtColor(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    return np.asarray(cv2.addWeighted(gray, percent / 100, frame, 1 - percent / 100, 0), np.uint8)


def _bits(frame: U8, bits: float, rng: np.random.Generator) -> U8:
    step = 1 << (8 - int(bits))
    return np.asarray(frame // step * step, np.uint8)


_KINDS: dict[str, Callable[[U8, float, np.random.Generator], U8]] = {
    "noise": _noise,
    "motion": _motion,
    "snow": _snow,
    "ripple": _ripple,
    "hue": _hue,
    "bits": _bits,
    "gray": _gray,
}


def parse_augmentation(name: str) -> tuple[str, float]:
    """The kind and the strength that an augmentation's name says; ToktError if there is none."""
    kind, _, text = name.partition("_")
    # Not all that `float` reads: one augmentation has one name.
    value = float(text) if re.fullmatch(r"\d{1,3}(\.\d{1,3})?", text, re.ASCII) else math.nan
    whole = value.is_integer()
    if (
        (kind == "gain" and 0 < value <= 16)
        or (kind == "gamma" and 0 < value <= 4)
        or (kind == "jpeg" and whole and 1 <= value <= 100)
        or (kind == "noise" and whole and 1 <= value <= 64)
        or (kind in ("motion", "ripple", "gray") and whole and 1 <= value <= 100)
        or (kind == "snow" and whole and 1 <= value <= 999)
        or (kind == "hue" and whole and 1 <= value <= 359)
        or (kind == "bits" and whole and 1 <= value <= 7)
        or (kind == RANDOM and whole and 1 <= value <= 99)
    ):
        return kind, value
    raise ToktError(
        f"no picture change {name!r} (they are like gain_0.5, gamma_0.7, jpeg_60, noise_1, "
        "motion_6, snow_60, ripple_25, hue_15, bits_4, gray_100 and random_9)"
    )
