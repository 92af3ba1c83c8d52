"""Timing of two ways of doing the same, in turns on one thread, and medians of the times."""

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from tokt.features.common.arrays import F64
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.labels.formats.options import Progress
from tokt.training.options import Notice

BASELINE, OURS = "baseline", "ours"
LIBRARIES = "libraries"
"""The libraries used as well as they can be, where the baseline is the thesis's way."""
FLOOR, MEMORY = "floor", "memory"
"""A part that both ways have, timed alone."""
SPREAD_PERCENTILES = (10, 90)
SPREAD_IS = (
    "10th and 90th percentile of baseline / ours over single repetitions; "
    "baseline_ms and ours_ms are medians, ratio is baseline_ms / ours_ms"
)

Item = TypeVar("Item")
Times = Mapping[str, F64]


@dataclass(frozen=True)
class BenchSize:
    """Numbers of frames and repetitions of a bench."""

    compared: int | None  # frames of the mission on which both ways are compared; None for all
    timed: int  # frames that are decoded, kept in memory and timed
    rounds: int  # how often each of these is timed
    files: int  # image files of the feature table
    tables: int  # how often the table is made
    starts: int  # how often each process is started
    latency: int  # how often each of the timed frames is sent at a camera's rate


@dataclass(frozen=True)
class BenchRequest:
    """A bench's mission, its labels and calibration, each None for what `run_bench` takes then.

    `say` takes a line for people, and ``progress(items, total, what)`` passes items on.
    """

    mission: Path | None
    labels: Path | None
    calibration: StereoCalibration | None
    size: BenchSize
    progress: Progress
    say: Notice


@dataclass(frozen=True)
class Result:
    """Times and findings of one case."""

    name: str
    baseline_ms: float  # median
    ours_ms: float
    spread: tuple[float, float]  # of the ratio, as `SPREAD_IS` says
    exact: bool  # both gave the same, checked in this run
    extras: Mapping[str, Any]  # further figures of this case, JSON values

    @property
    def ratio(self) -> float:
        """How many times faster ours is."""
        return self.baseline_ms / self.ours_ms

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        figures = {key: value for key, value in vars(self).items() if key != "extras"}
        return {**figures, "spread": list(self.spread), "ratio": self.ratio, **self.extras}


@contextmanager
def single_thread() -> Iterator[None]:
    """Keep OpenCV and the linear algebra libraries of this process to one thread each."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(before)


def in_turns(
    calls: Mapping[str, Callable[[Item], object]], items: Sequence[Item], rounds: int
) -> dict[str, F64]:
    """Time each call on each item, `rounds` times, the calls in turns.

    One after another the calls get *different* items: an item that the call before has just read
    would come from the cache and flatter the second. What is compared is always one item's times
    in one round: the seconds (rounds * n_items,) are in the same order for each call.
    """
    count = len(items)
    shift = max(1, count // len(calls))
    times = {name: np.empty((rounds, count)) for name in calls}
    for call in calls.values():  # warm-up: imports, caches, lazily made tables
        call(items[0])
    gc.disable()
    try:
        for turn in range(rounds):
            for step in range(count):
                for place, (name, call) in enumerate(calls.items()):
                    index = (step + place * shift) % count
                    start = time.perf_counter()
                    call(items[index])
                    times[name][turn, index] = time.perf_counter() - start
    finally:
        gc.enable()
    return {name: values.ravel() for name, values in times.items()}


def result(name: str, times: Times, exact: bool, extras: Mapping[str, Any]) -> Result:
    """Medians and spread of the seconds of `BASELINE` and `OURS`, and medians of what else was."""
    medians = {key: float(np.median(values)) * 1000 for key, values in times.items()}
    low, high = np.percentile(times[BASELINE] / times[OURS], SPREAD_PERCENTILES)
    others = {f"{key}_ms": medians[key] for key in (LIBRARIES, FLOOR, MEMORY) if key in medians}
    more = {**others, "repetitions": len(times[OURS]), **extras}
    return Result(name, medians[BASELINE], medians[OURS], (float(low), float(high)), exact, more)
