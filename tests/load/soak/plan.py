"""The plan of a soak: its extent, the kind of each frame, and what has to be said of it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import chain, count, islice, repeat

import numpy as np

from tokt.features.common.arrays import U8
from tokt.inference.config import Limits
from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

SEED = 7
_EPOCH_S = 1_700_000_000.0
_STEP_S = 1e-3
_STRETCH = (300, 900)  # frames of clear water between two things that happen
_REPEATS = Limits().frozen_repeats


class FrameKind(IntEnum):
    WATER = 0
    NEAR = 1  # something can be hit
    SAME = 2
    """Clear water, the very pixels of the frame before, as few times as a camera may give them."""
    FROZEN = 3  # the same once more, and more often than that
    DARK = 4
    MISSING = 5  # the stream has no picture of it


CALM = (FrameKind.WATER, FrameKind.NEAR)
"""Kinds of which the verdict depends on no frame before."""
EXPECTED: dict[FrameKind, tuple[int, Reason]] = {
    FrameKind.WATER: (CLEAR, Reason.OK),
    FrameKind.NEAR: (OBSTACLE, Reason.OK),
    FrameKind.SAME: (CLEAR, Reason.OK),
    FrameKind.FROZEN: (UNKNOWN, Reason.FROZEN),
    FrameKind.DARK: (UNKNOWN, Reason.DARK),
    FrameKind.MISSING: (UNKNOWN, Reason.MISSING),
}
"""Status and reason of the verdict on each."""
_FAULTS = (FrameKind.FROZEN, FrameKind.DARK, FrameKind.MISSING)
_LENGTHS = {FrameKind.NEAR: (20, 60), **dict.fromkeys(_FAULTS, (1, 5))}
"""Frames that an obstacle or a fault lasts, from and up to."""
_LAST_FAULT = 0.99  # part of all frames: then no fault is made any more


@dataclass(frozen=True)
class SoakSize:
    frames: int = 1_000_000
    bare_frames: int = 50_000  # of the same run with nothing around it, to compare with
    fault_every: int = 10_000  # frames
    fault_rows: tuple[str, ...] = ()  # the only ones that are injected; all, where there are none
    kills: int = 20  # how often the runtime is killed under its watchdog, in real time
    rest_s: float = 0.0  # between a frame's end and the next one
    pauses: int = 30  # how often no frame comes to a run in real time
    pause_s: float = 1.3  # and for how long
    look_every_s: float = 1.0  # how often its metrics are asked for, and its memory is looked at
    log_mb: float = 5.0  # of a log file, after which the next one begins
    log_keep: int = 3  # older log files
    record_mb: float = 100.0  # of the disk, for recordings: two runtimes' at least

    @property
    def last_fault(self) -> int:
        return int(_LAST_FAULT * self.frames)

    def of(self, frames: int) -> "SoakSize":
        return replace(self, frames=frames, bare_frames=min(self.bare_frames, frames))


FULL = SoakSize()
QUICK = SoakSize(
    frames=3000,
    bare_frames=1000,
    fault_every=700,
    fault_rows=("glare", "the log's file is deleted", "SIGKILL at any moment"),
    kills=2,
    rest_s=2e-3,
    pauses=3,
    log_mb=0.2,
    record_mb=10.0,
)


def plan(frames: int, seed: int = SEED) -> U8:
    stretches = _stretches(np.random.default_rng(seed))
    kinds = chain.from_iterable(repeat(kind, length) for kind, length in stretches)
    return np.fromiter(islice(kinds, frames), np.uint8, frames)


def _stretches(rng: np.random.Generator) -> Iterator[tuple[FrameKind, int]]:
    """Kinds and how many frames of each, for ever: near obstacles and faults in turns."""
    for turn in count():
        happens = _FAULTS[rng.integers(len(_FAULTS))] if turn % 2 else FrameKind.NEAR
        yield FrameKind.WATER, rng.integers(*_STRETCH)
        if happens is FrameKind.FROZEN:
            yield FrameKind.SAME, _REPEATS
        yield happens, rng.integers(*_LENGTHS[happens])


def time_of(number: int) -> float:
    return _EPOCH_S + _STEP_S * number


def number_of(t: float) -> int:
    return round((t - _EPOCH_S) / _STEP_S)
