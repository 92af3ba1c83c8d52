"""Timing of methods of judging frames, stage by stage, in turns on one thread.

What is counted is the thread's own processor time: on an idle machine the time that passes, and on
a busy one not what others take.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tokt.inference.verdict import Verdict

STAGES = (
    "decode",
    "resize",
    "superpixels",
    "features",
    "predict",
    "undistort",
    "match",
    "contours",
)
"""In the order of a table. The last one is all that is left: masks, outlines, the verdict, and in
tokt's methods its checks of the frame."""
REST = STAGES[-1]

Float = NDArray[np.float64]
T = TypeVar("T")


class Laps:
    """Seconds of the stages of one run."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._last = time.thread_time()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap, but for what was counted inside it, for a stage."""
        now = time.thread_time()
        self.seconds[stage] += now - self._last
        self._last = now

    def inside(self, stage: str, call: Callable[[], T]) -> T:
        """Do something in the middle of another stage, and count it for this one."""
        began = time.thread_time()
        done = call()
        took = time.thread_time() - began
        self.seconds[stage] += took
        self._last += took
        return done

    def split_off(self, stage: str, call: Callable[[], T], less_s: float = 0.0) -> T:
        """Do again what was a part of `REST`, and count the time it takes for this stage.

        For a part of a call that cannot be looked into: the total stays that of the one call.

        Parameters
        ----------
        stage : str
        call : callable
        less_s : float
            Seconds of `call` that were split off already.
        """
        began = time.thread_time()
        done = call()
        took = max(0.0, time.thread_time() - began - less_s)
        took = min(took, self.seconds[REST])
        self.seconds[stage] += took
        self.seconds[REST] -= took
        self._last = time.thread_time()
        return done


@dataclass(frozen=True)
class EncodedPair:
    """A frame, or a pair, as it lies on the disk.

    Parameters
    ----------
    number : int
    left : bytes
    right : bytes or None
    """

    number: int
    left: bytes
    right: bytes | None


@dataclass(frozen=True)
class TimedMethod:
    """One method of judging a frame, to be timed.

    Parameters
    ----------
    key, title, kind : str
        Kind as in `curves`.
    run : callable
        Judges an `EncodedPair`, and tells `Laps` about it.
    """

    key: str
    title: str
    kind: str
    run: Callable[[EncodedPair, Laps], Verdict]


@dataclass(frozen=True)
class StageTimes:
    """Times of one method, stage by stage.

    Parameters
    ----------
    method : TimedMethod
    seconds : array of float64, shape (n_runs, n_stages)
        A run is one frame in one round; runs are in the same order for all methods.
    verdicts : tuple of Verdict
        Of each frame, in the order of the frames.
    """

    method: TimedMethod
    seconds: Float
    verdicts: tuple[Verdict, ...]

    @property
    def total_ms(self) -> Float:
        """(n_runs,)"""
        return np.asarray(self.seconds.sum(axis=1) * 1e3)


def time_stages(
    methods: Sequence[TimedMethod],
    frames: Sequence[EncodedPair],
    rounds: int,
    progress: Callable[[Iterable[int], int, str], Iterable[Any]],
) -> list[StageTimes]:
    """Time each method on each frame, `rounds` times, the methods in turns.

    One after another the methods get different frames, as in `speed.paired_timing`: one
    that the method before has just read would come from the cache.

    Parameters
    ----------
    methods : sequence of TimedMethod
    frames : sequence of EncodedPair
    rounds : int
    progress : callable
    """
    count = len(frames)
    shift = max(1, count // len(methods))
    seconds = {method.key: np.zeros((rounds, count, len(STAGES))) for method in methods}
    # A warm-up, not timed: imports, caches, lazily made tables.
    verdicts = {method.key: [method.run(frames[0], Laps())] * count for method in methods}
    gc.disable()
    try:
        for step in progress(range(rounds * count), rounds * count, "run times"):
            turn, at = divmod(step, count)
            for place, method in enumerate(methods):
                index = (at + place * shift) % count
                laps = Laps()
                verdicts[method.key][index] = method.run(frames[index], laps)
                seconds[method.key][turn, index] = [laps.seconds[stage] for stage in STAGES]
    finally:
        gc.enable()
    return [
        StageTimes(
            method, seconds[method.key].reshape(rounds * count, -1), tuple(verdicts[method.key])
        )
        for method in methods
    ]
