"""Figures of a soak's samples: percentiles of latencies, and the growth of memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

PERCENTILES = {"median_ms": 50.0, "p99_ms": 99.0, "p99.9_ms": 99.9, "max_ms": 100.0}
WARM_UP = 0.2
"""Part of a run that memory is not judged on: buffers and windows fill, allocators settle."""
BLOCKS = 20
MIN_SAMPLES = 3 * BLOCKS
"""After warm-up; fewer say nothing of a slope."""
CONFIDENCE = 0.95
CAMERA_FPS = 15.0


def percentiles_ms(seconds: NDArray[np.float64]) -> dict[str, float]:
    """Of durations in seconds: `PERCENTILES` in milliseconds, and p99.9 over the median."""
    found = np.percentile(seconds, list(PERCENTILES.values())) * 1000
    named = dict(zip(PERCENTILES, found.tolist(), strict=True))
    return {**named, "tail": named["p99.9_ms"] / named["median_ms"]}


@dataclass(frozen=True)
class MemoryGrowth:
    """Growth of memory with frames, by least squares over the means of `BLOCKS` blocks.

    Samples of one second are nearly the same as those of the next: over them as they are, the
    interval would be far too narrow.

    Parameters
    ----------
    bytes_per_frame : float
    low, high : float
        Interval of `CONFIDENCE` by Student's t.
    first_bytes, last_bytes, most_bytes : float
        Means of the first and of the last block after warm-up, and the most of any sample.
    """

    bytes_per_frame: float
    low: float
    high: float
    first_bytes: float
    last_bytes: float
    most_bytes: float

    @property
    def mb_per_day(self) -> float:
        """At `CAMERA_FPS`, as if it were the frames that memory grew with."""
        return self.bytes_per_frame * CAMERA_FPS * 86_400 / 1e6

    @property
    def none_to_be_seen(self) -> bool:
        """Whether no growth is within the interval."""
        return self.low <= 0

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            **asdict(self),
            "bytes_per_1e6_frames": self.bytes_per_frame * 1e6,
            "mb_per_day": self.mb_per_day,
            "mb_per_day_is": f"at {CAMERA_FPS:g} frames a second",
            "confidence": CONFIDENCE,
        }


def growth(frames: NDArray[np.float64], resident: NDArray[np.float64]) -> MemoryGrowth | None:
    """The growth of what was sampled; None of too few samples.

    Parameters
    ----------
    frames : array of float64, shape (n,)
        Frames judged so far, rising.
    resident : array of float64, shape (n,)
        Bytes in memory.
    """
    warm = frames >= WARM_UP * frames[-1] if len(frames) else np.zeros(0, bool)
    if warm.sum() < MIN_SAMPLES:
        return None
    x = np.array([part.mean() for part in np.array_split(frames[warm], BLOCKS)])
    y = np.array([part.mean() for part in np.array_split(resident[warm], BLOCKS)])
    line = stats.linregress(x, y)
    margin = float(stats.t.ppf((1 + CONFIDENCE) / 2, BLOCKS - 2) * line.stderr)
    slope = float(line.slope)
    ends = (float(y[0]), float(y[-1]), float(resident.max()))
    return MemoryGrowth(slope, slope - margin, slope + margin, *ends)


@dataclass(frozen=True)
class Check:
    """One thing that is asked of a soak.

    Parameters
    ----------
    name : str
    asked, found : str
        In words.
    holds : bool
    """

    name: str
    asked: str
    found: str
    holds: bool

    def to_json(self) -> Mapping[str, Any]:
        """Plain JSON form."""
        return asdict(self)
