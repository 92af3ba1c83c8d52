"""Augmentations: frames as another lamp, water or camera setting would have made them.

A model is to say the same of them. They are learnt from (`TrainingSettings.changes`, the option
``--changes``) and tested on (``tokt train --stress``). Named ``gain_0.5`` (light times a half, as
exposure or a camera's gain change it), ``gamma_0.7`` (each value over 255 to this power, as a
camera's or a recorder's tone curve), ``jpeg_60`` (stored as a JPEG of quality 60) and ``noise_1``
(each value up or down by at most 1, evenly). ``random_9`` is only learnt from: each frame changed
9 times at random (`tokt.training.datasets.frame_changes`).
"""

import math
import re

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256

STRESS = (
    *("gain_0.5", "gain_0.7", "gain_1.4", "gain_2"),
    *("gamma_0.7", "gamma_1.4", "jpeg_60", "jpeg_75", "jpeg_95", "noise_1"),
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
    noise = rng.integers(-int(value), int(value), frame.shape, np.int16, endpoint=True)
    return np.asarray(np.clip(frame + noise, 0, 255), np.uint8)


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
        or (kind == RANDOM and whole and 1 <= value <= 99)
    ):
        return kind, value
    raise ToktError(
        f"no picture change {name!r} (they are like gain_0.5, gamma_0.7, jpeg_60, noise_1 and "
        "random_9)"
    )
