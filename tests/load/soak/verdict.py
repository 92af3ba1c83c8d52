"""The checks of a soak: what is asked, what was found, and whether it holds."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from tests.load.report import WORST, Timing, percentiles
from tokt.features.common.arrays import F64

from .fault_results import (
    FaultResult,
    fault_results,
    lines_lost_without_fault,
    longest_without_fault_s,
    without_fault,
)
from .faults import SILENCE_S
from .run import Around, Run

MAX_TAIL = 3.0  # the 99.9th percentile of the latency over its median, at most
PERCENTILES = {"median_ms": 50.0, "p99_ms": 99.0, "p99.9_ms": 99.9, "max_ms": 100.0}
WARM_S, WARM_UP = 20.0, 0.2
"""Seconds since a start, and part of a life's frames, that memory is not judged on: buffers and
windows fill (the live view keeps 10 s of pictures), allocators settle."""
BLOCKS, BLOCK_SAMPLES = 20, 5
"""Most blocks of the samples of one runtime, and least samples of a block."""
MIN_BLOCKS = 12  # of all runtimes together, beside one each; fewer say nothing of a slope
CONFIDENCE = 0.95
WATCHDOG_MB = 1.0  # a leak of what it passes on, some 200 kB at each restart, comes to more
_ENDS = 10  # samples at either end of which the median counts
CAMERA_FPS = 15.0
_WRONG = ("wrong_clear", "wrong_obstacle", "no_such_frame", "other")
_LOST = ("lost", "unreadable", "lost_v1", "different_v1")


def percentiles_ms(seconds: F64) -> dict[str, float]:
    """Of durations in seconds: percentiles in milliseconds, and p99.9 over the median."""
    found = percentiles(seconds * 1000, **PERCENTILES)
    return {**found, "tail": found["p99.9_ms"] / found["median_ms"]}


def growth(frames: F64, resident: F64, lives: F64 | None = None) -> dict[str, Any] | None:
    """Growth of memory with frames, by least squares over the means of blocks.

    Samples of one second are nearly the same as those of the next: over them as they are, the
    interval (of `CONFIDENCE`, by Student's t) would be far too narrow. Each runtime has a level of
    its own, and all have one slope.

    Parameters
    ----------
    frames : array of float64, shape (n,)
        Judged so far, rising within a life.
    resident : array of float64, shape (n,)
        Bytes in memory.
    lives : array of float64, shape (n,), optional
        Which runtime each sample is of; by default they are all of one.

    Returns
    -------
    dict or None
        None of too few samples.
    """
    lives = np.zeros(len(frames)) if lives is None else lives
    parts = [_blocks(frames[lives == life], resident[lives == life]) for life in np.unique(lives)]
    parts = [(x, y) for x, y in parts if len(x) > 1]
    freedom = sum(len(x) - 1 for x, _ in parts) - 1
    if freedom < MIN_BLOCKS:
        return None
    x, y = (np.concatenate([part[i] - part[i].mean() for part in parts]) for i in (0, 1))
    slope = float(x @ y / (x @ x))
    error = float(np.sqrt(((y - slope * x) ** 2).sum() / freedom / (x @ x)))
    margin = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom)) * error
    return {
        "bytes_per_frame": slope,
        "low": slope - margin,
        "high": slope + margin,
        "first_bytes": float(parts[0][1][0]),
        "last_bytes": float(parts[-1][1][-1]),
        "mb_per_day": slope * CAMERA_FPS * 86_400 / 1e6,
    }


def _blocks(frames: F64, resident: F64) -> tuple[F64, F64]:
    """Means of frames and memory over blocks of one life, once it is warm."""
    warm = frames >= WARM_UP * frames[-1] if len(frames) else np.zeros(0, bool)
    count = max(min(int(warm.sum()) // BLOCK_SAMPLES, BLOCKS), 1)
    x, y = (
        np.array([part.mean() for part in np.array_split(values[warm], count) if len(part)])
        for values in (frames, resident)
    )
    return x, y


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

    @property
    def around(self) -> Around:
        assert self.whole.around is not None
        return self.whole.around

    @cached_property
    def growth(self) -> dict[str, Any] | None:
        seen = self.around.attendant
        warm = seen.column("life_s") >= WARM_S
        columns = map(seen.column, ("frames", "resident", "life"))
        return growth(*(column[warm] for column in columns))

    @cached_property
    def faults(self) -> list[FaultResult]:
        return fault_results(self.whole)

    @cached_property
    def latency(self) -> dict[str, dict[str, float]]:
        quiet, bare = without_fault(self.whole), self.bare.age_s > 0
        times = {
            "age": self.whole.age_s[quiet],
            "round_trip": self.whole.round_trip_s[quiet],
            "age_in_faults": self.whole.age_s[~quiet & (self.whole.age_s > 0)],
            "bare_age": self.bare.age_s[bare],
            "bare_round_trip": self.bare.round_trip_s[bare],
        }
        return {name: percentiles_ms(seconds) for name, seconds in times.items() if len(seconds)}

    @property
    def holds(self) -> bool:
        return all(check.holds for check in self.checks)

    @cached_property
    def checks(self) -> list[Check]:
        parts = self._frames(), self._injected(), self._silences(), self._resources()
        return [check for part in (*parts, self._times()) for check in part]

    def _frames(self) -> list[Check]:
        heard, frames, around = self.whole.heard, self.whole.extent.frames, self.around
        judged = sum(count for name, count in heard.items() if name.startswith("of_"))
        gone = heard.get("lost_on_the_way", 0)
        wrong, lost = (_some(heard, names) for names in (_WRONG, _LOST))
        beats = heard.get("heartbeats", 0)
        every = heard["datagrams"] == judged + beats
        planned = sum(each.restarts for each in around.injections)
        return [
            Check(
                "frames",
                f"all {frames} judged, but one at most that is on its way at each restart",
                f"{judged} judged, {gone} gone with a runtime",
                judged + gone == frames and gone <= around.restarts,
            ),
            Check(
                "datagrams",
                "each one heard, in order, v1 as v2",
                f"{heard['datagrams']} of {judged} frames, {beats} heartbeats; {_words(lost)}",
                not lost and every,
            ),
            Check(
                "verdicts",
                "each as the frame is; never a wrong clear",
                f"{_words(wrong)}; {heard.get('cautious', 0)} unknown as the machine was held up",
                not wrong,
            ),
            Check(
                "restarts",
                f"{planned}, one by each fault that ends the runtime",
                f"{around.restarts}; {heard['starts']} runtimes heard",
                around.restarts == planned == heard["starts"] - 1,
            ),
        ]

    def _injected(self) -> list[Check]:
        injections, results = self.around.injections, self.faults
        reported = sum(not each.missing for each in injections)
        lacking = [f"{each.words} ({', '.join(each.missing)})" for each in results if each.missing]
        longer = [each for each in results if not each.is_heard]
        nearest = max(results, key=lambda each: each.longest_s / each.bound_s, default=None)
        worst = longer or [each for each in (nearest,) if each is not None]
        words = [f"{each.longest_s:.2f} of {each.bound_s:.2f} s: {each.words}" for each in worst]
        otherwise_s = longest_without_fault_s(self.whole)
        stood_s = sum(later - earlier for earlier, later in self.around.standstills)
        return [
            Check(
                "faults",
                f"{len(self.around.injections)}, each reported as its row of faults.md says",
                f"{reported} of {len(injections)}; {len(results)} rows"
                + "".join(f"; not: {each}" for each in lacking),
                reported == len(injections) == self.around.drawn,
            ),
            Check(
                "silence in faults",
                "each within the bound of its row, but while the whole machine stands",
                f"{len(longer)} longer; the machine stood {stood_s:.1f} s; {'; '.join(words)}",
                not longer,
            ),
            Check(
                "silence otherwise",
                f"at most {SILENCE_S:.2f} s",
                f"{otherwise_s:.3f} s",
                otherwise_s <= SILENCE_S,
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
        ends, lost = self.around.attendant.ends(), lines_lost_without_fault(self.whole)
        words = ", ".join(
            f"{name.replace('_', ' ')} {first} to {last}" for name, (first, last) in ends.items()
        )
        same = all(last <= first for first, last in ends.values())
        checks = [
            Check("threads and files", "no more at the end", words, same),
            Check("log", "every line written, but in faults of the log", f"{lost} lost", not lost),
        ]
        if grown := self.growth:
            found = (
                f"{growth_words(grown)}, {grown['mb_per_day']:+.2f} MB a day; "
                f"{grown['last_bytes'] / 1e6:.1f} MB at the end"
            )
            asked = "no growth within the interval, over all runtimes"
            checks.append(Check("memory", asked, found, grown["low"] <= 0))
        return [*checks, self._watchdog()]

    def _watchdog(self) -> Check:
        resident = self.around.attendant.column("watchdog_resident") / 1e6
        more = float(np.median(resident[-_ENDS:]) - np.median(resident[:_ENDS]))
        words = f"{more:+.2f} MB to {resident[-1]:.1f} MB, after {self.around.restarts} restarts"
        asked = f"at most {WATCHDOG_MB:g} MB more at the end"
        return Check("watchdog's memory", asked, words, more <= WATCHDOG_MB)

    def _times(self) -> list[Check]:
        figures, bare = self.latency["age"], self.latency["bare_age"]
        words = (
            f"median {figures['median_ms']:.2f}, p99 {figures['p99_ms']:.2f}, p99.9 "
            f"{figures['p99.9_ms']:.2f}, max {figures['max_ms']:.1f} ms: {figures['tail']:.2f} x "
            f"(bare loop: median {bare['median_ms']:.2f} ms, {bare['tail']:.2f} x)"
        )
        asked = f"p99.9 at most {MAX_TAIL:g} x the median, while no fault lasts"
        checks = [Check("latency", asked, words, figures["tail"] <= MAX_TAIL)]
        if (times := self.restart) is not None:
            words = f"median {times.at(50):.0f} ms, worst {times.at(WORST):.0f} ms"
            words += f", {len(times.times_ms)} times"
            asked = f"each at most {times.asked_ms:g} ms"
            checks.append(Check(times.name, asked, words, bool(times.holds)))
        return checks

    def to_json(self) -> dict[str, Any]:
        whole, bare, seen = self.whole, self.bare, self.around.attendant
        return {
            "holds": self.holds,
            "checks": [check._asdict() for check in self.checks],
            "faults": [asdict(each) for each in self.faults],
            "injections": [asdict(each) for each in self.around.injections],
            "standstills": self.around.standstills,
            "latency": self.latency,
            "memory": self.growth,
            "samples": seen.samples,
            "metrics": {name: value for name, value in seen.metrics.items() if "tokt_" in name},
            "summary": whole.summary,
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
