"""The checks of a soak: what is asked, what was found, and whether it holds."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from tests.load.report import WORST, Timing, percentiles
from tokt.features.common.arrays import F64
from tokt.inference.config import Limits
from tokt.inference.publisher import TICK_S

from .attend import REFUSED, SWITCHED
from .run import Run

MAX_TAIL = 3.0  # the 99.9th percentile of the latency over its median, at most
MARGIN_S = 0.15
"""By how much a heartbeat may be late at the receiver: a busy machine runs the thread that says it
and the process that hears it a little later."""
SILENCE_S = Limits().heartbeat_s + TICK_S + MARGIN_S
PERCENTILES = {"median_ms": 50.0, "p99_ms": 99.0, "p99.9_ms": 99.9, "max_ms": 100.0}
WARM_UP = 0.2
"""Part of a run that memory is not judged on: buffers and windows fill, allocators settle."""
BLOCKS = 20
MIN_SAMPLES = 3 * BLOCKS  # after warm-up; fewer say nothing of a slope
CONFIDENCE = 0.95
CAMERA_FPS = 15.0
_WRONG = ("wrong_clear", "wrong_obstacle", "no_such_frame", "other")
_LOST = ("lost", "unreadable", "lost_v1", "different_v1")


def percentiles_ms(seconds: F64) -> dict[str, float]:
    """Of durations in seconds: percentiles in milliseconds, and p99.9 over the median."""
    found = percentiles(seconds * 1000, **PERCENTILES)
    return {**found, "tail": found["p99.9_ms"] / found["median_ms"]}


def growth(frames: F64, resident: F64) -> dict[str, Any] | None:
    """Growth of memory with frames, by least squares over the means of `BLOCKS` blocks.

    Samples of one second are nearly the same as those of the next: over them as they are, the
    interval (of `CONFIDENCE`, by Student's t) would be far too narrow. Given are the frames judged
    so far, rising, and the bytes in memory, both of shape (n,); None of too few samples.
    """
    warm = frames >= WARM_UP * frames[-1] if len(frames) else np.zeros(0, bool)
    if warm.sum() < MIN_SAMPLES:
        return None
    x, y = (
        np.array([part.mean() for part in np.array_split(values[warm], BLOCKS)])
        for values in (frames, resident)
    )
    line = stats.linregress(x, y)
    margin = float(stats.t.ppf((1 + CONFIDENCE) / 2, BLOCKS - 2) * line.stderr)
    slope = float(line.slope)
    return {
        "bytes_per_frame": slope,
        "low": slope - margin,
        "high": slope + margin,
        "first_bytes": float(y[0]),
        "last_bytes": float(y[-1]),
        "mb_per_day": slope * CAMERA_FPS * 86_400 / 1e6,
    }


def growth_words(grown: Mapping[str, Any]) -> str:
    slope, low, high = (grown[name] * 1e6 for name in ("bytes_per_frame", "low", "high"))
    return f"{slope:+,.0f} bytes per 10^6 frames ({low:+,.0f} to {high:+,.0f})"


class Check(NamedTuple):
    name: str
    asked: str  # in words, as what was found
    found: str
    holds: bool


@dataclass(frozen=True)
class Soak:
    whole: Run  # with everything around the loop
    bare: Run  # with nothing
    pauses: dict[str, Any]  # `LiveRuns.pauses`
    restart: Timing | None  # None where nothing was killed
    about: dict[str, Any]  # what it was done on

    @cached_property
    def growth(self) -> dict[str, Any] | None:
        seen = self.whole.attendant
        return growth(seen.column("frames"), seen.column("resident"))

    @cached_property
    def latency(self) -> dict[str, dict[str, float]]:
        times = {
            "age": self.whole.age_s,
            "round_trip": self.whole.round_trip_s,
            "bare_age": self.bare.age_s,
            "bare_round_trip": self.bare.round_trip_s,
        }
        return {name: percentiles_ms(seconds[seconds > 0]) for name, seconds in times.items()}

    @property
    def holds(self) -> bool:
        return all(check.holds for check in self.checks)

    @cached_property
    def checks(self) -> list[Check]:
        return [*self._frames(), *self._silences(), *self._resources(), *self._times()]

    def _frames(self) -> list[Check]:
        summary, heard, asked = self.whole.summary, self.whole.heard, self.whole.extent.frames
        judged, left_out = summary["frames"], summary["dropped"]
        wrong, lost = (_some(heard, names) for names in (_WRONG, _LOST))
        every = heard["datagrams"] + heard["compared_v1"] == summary["sent"]
        words = f"{judged} judged, {left_out} left out"
        return [
            Check("frames", f"all {asked} judged", words, (judged, left_out) == (asked, 0)),
            Check(
                "datagrams",
                "each one heard, in order, v1 as v2",
                f"{heard['datagrams']} of {judged} heard; {_words(lost)}; refused by the system "
                f"{summary['send_failures']}",
                not lost and heard["datagrams"] == judged and every,
            ),
            Check(
                "verdicts",
                "each as the frame is; never a wrong clear",
                f"{_words(wrong)}; {heard.get('cautious', 0)} unknown as the machine was held up",
                not wrong,
            ),
        ]

    def _silences(self) -> list[Check]:
        found, extent = self.pauses, self.whole.extent
        least = extent.pauses * int(extent.pause_s / SILENCE_S)
        said, heard, wrong, silences_s = found.values()
        longest = max(silences_s)
        longer = sum(silence_s > SILENCE_S for silence_s in silences_s)
        return [
            Check(
                "heartbeats",
                f"all that were said are heard; at least {least} in {extent.pauses} pauses",
                f"{heard} heard of {said}; {wrong or 'none'} wrong",
                heard == said >= least and not wrong,
            ),
            Check(
                "longest silence",
                f"at most {SILENCE_S:.2f} s at the receiver",
                f"{longest:.3f} s; longer {longer} times",
                longest <= SILENCE_S,
            ),
        ]

    def _resources(self) -> list[Check]:
        seen, happened = self.whole.attendant, Counter(name for name, _ in self.whole.happened)
        to_be, were = ((each[SWITCHED], each[REFUSED]) for each in (seen.asked, happened))
        ends, lost = seen.ends(), self.whole.summary["log_failures"]
        words = ", ".join(f"{name} {first} to {last}" for name, (first, last) in ends.items())
        same = all(last <= first for first, last in ends.values())
        checks = [
            Check(
                "hot reloads",
                f"{to_be[0]} models taken over, {to_be[1]} damaged ones refused",
                f"{were[0]} and {were[1]}",
                were == to_be,
            ),
            Check("threads and files", "no more at the end", words, same),
            Check("log", "every line written", f"{lost} lost", not lost),
        ]
        if grown := self.growth:
            found = (
                f"{growth_words(grown)}, {grown['mb_per_day']:+.2f} MB a day; "
                f"{grown['last_bytes'] / 1e6:.1f} MB at the end"
            )
            asked = "no growth within the interval"
            checks.append(Check("memory", asked, found, grown["low"] <= 0))
        return checks

    def _times(self) -> list[Check]:
        figures, bare = self.latency["age"], self.latency["bare_age"]
        words = (
            f"median {figures['median_ms']:.2f}, p99 {figures['p99_ms']:.2f}, p99.9 "
            f"{figures['p99.9_ms']:.2f}, max {figures['max_ms']:.1f} ms: {figures['tail']:.2f} x "
            f"(bare loop: median {bare['median_ms']:.2f} ms, {bare['tail']:.2f} x)"
        )
        asked = f"p99.9 at most {MAX_TAIL:g} x the median"
        checks = [Check("latency", asked, words, figures["tail"] <= MAX_TAIL)]
        if (times := self.restart) is not None:
            words = f"median {times.at(50):.0f} ms, worst {times.at(WORST):.0f} ms"
            words += f", {len(times.times_ms)} times"
            asked = f"each at most {times.asked_ms:g} ms"
            checks.append(Check(times.name, asked, words, bool(times.holds)))
        return checks

    def to_json(self) -> dict[str, Any]:
        whole, bare, seen = self.whole, self.bare, self.whole.attendant
        return {
            "holds": self.holds,
            "checks": [check._asdict() for check in self.checks],
            "latency": self.latency,
            "memory": self.growth,
            "samples": seen.samples,
            "metrics": {name: value for name, value in seen.metrics.items() if "tokt_" in name},
            "summary": whole.summary,
            "happened": whole.happened,
            "heard": whole.heard,
            "seconds": whole.seconds,
            "bare": {"summary": bare.summary, "heard": bare.heard},
            "pauses": self.pauses,
            "restart": None if self.restart is None else self.restart.to_json(),
            **self.about,
        }


def _some(heard: dict[str, Any], names: tuple[str, ...]) -> dict[str, int]:
    return {name: heard[name] for name in names if heard.get(name)}


def _words(found: dict[str, int]) -> str:
    parts = [f"{name.replace('_', ' ')} {count}" for name, count in found.items()]
    return ", ".join(parts) or "none wrong"
