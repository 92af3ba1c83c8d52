"""The plan of a soak: the kind of each frame, and what has to be said of it."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from tokt.inference.config import Limits
from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

SEED = 7
_EPOCH_S = 1_700_000_000.0
_STEP_S = 1e-3
_STRETCH = (300, 900)
"""Frames of clear water between two things that happen."""
_NEAR = (20, 60)
"""Frames that an obstacle is seen in."""
_MAX_FAULTY = 4
_REPEATS = Limits().frozen_repeats


class FrameKind(IntEnum):
    """The kind of a frame."""

    WATER = 0
    NEAR = 1
    """Something can be hit."""
    SAME = 2
    """Clear water, the very pixels of the frame before, as few times as a camera may give them."""
    FROZEN = 3
    """The same once more, and more often than that."""
    DARK = 4
    MISSING = 5
    """The stream has no picture of it."""


EXPECTED: dict[FrameKind, tuple[int, Reason]] = {
    FrameKind.WATER: (CLEAR, Reason.OK),
    FrameKind.NEAR: (OBSTACLE, Reason.OK),
    FrameKind.SAME: (CLEAR, Reason.OK),
    FrameKind.FROZEN: (UNKNOWN, Reason.FROZEN),
    FrameKind.DARK: (UNKNOWN, Reason.DARK),
    FrameKind.MISSING: (UNKNOWN, Reason.MISSING),
}
"""Status and reason of the verdict on each."""


def plan(frames: int, seed: int = SEED) -> NDArray[np.uint8]:
    """The kinds of so many frames, by number; the first ones are clear water.

    Returns
    -------
    numpy.ndarray
        uint8 of `FrameKind`, shape (frames,).
    """
    rng = np.random.default_rng(seed)
    parts: list[NDArray[np.uint8]] = []
    planned = 0
    faults = (FrameKind.FROZEN, FrameKind.DARK, FrameKind.MISSING)
    while planned < frames:
        happens = FrameKind.NEAR if len(parts) % 4 == 0 else faults[rng.integers(len(faults))]
        parts += [
            np.full(rng.integers(*_STRETCH), FrameKind.WATER, np.uint8),
            _happening(happens, rng),
        ]
        planned += len(parts[-1]) + len(parts[-2])
    return np.concatenate(parts)[:frames]


def _happening(kind: FrameKind, rng: np.random.Generator) -> NDArray[np.uint8]:
    if kind is FrameKind.NEAR:
        return np.full(rng.integers(*_NEAR), kind, np.uint8)
    faulty = np.full(rng.integers(1, _MAX_FAULTY + 1), kind, np.uint8)
    if kind is FrameKind.FROZEN:
        return np.concatenate([np.full(_REPEATS, FrameKind.SAME, np.uint8), faulty])
    return faulty


def time_of(number: int) -> float:
    """Frame time in seconds of the frame with a number."""
    return _EPOCH_S + _STEP_S * number


def number_of(t: float) -> int:
    """The number of the frame with a time in seconds."""
    return round((t - _EPOCH_S) / _STEP_S)
