"""The checks of a soak: what is asked, what was found, and whether it holds."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tests.load.timing import WORST, Timing

from .figures import Check, MemoryGrowth, growth, percentiles_ms
from .run import SILENCE_S, Run

MAX_TAIL = 3.0
"""The 99.9th percentile of the latency over its median, at most."""
_WRONG = ("wrong_clear", "wrong_obstacle", "no_such_frame", "other", "wrong_heartbeats")
_LOST = ("lost", "unreadable", "lost_v1", "different_v1")


@dataclass(frozen=True)
class Soak:
    """All that was found.

    Parameters
    ----------
    whole, bare : Run
        With everything around the loop, and with nothing.
    restart : Timing or None
        None where nothing was killed.
    about : dict
        What it was done on.
    """

    whole: Run
    bare: Run
    restart: Timing | None
    about: dict[str, Any]

    @cached_property
    def growth(self) -> MemoryGrowth | None:
        """Of the whole run's memory; None where it was too short."""
        watch = self.whole.watch
        return None if watch is None else growth(*watch.memory())

    @cached_property
    def latency(self) -> dict[str, dict[str, float]]:
        """Percentiles, by what they are of."""
        return {
            "datagrams_out": percentiles_ms(self.whole.latency_s),
            "received": percentiles_ms(self.whole.reception_s),
            "bare_datagrams_out": percentiles_ms(self.bare.latency_s),
            "bare_received": percentiles_ms(self.bare.reception_s),
        }

    @property
    def holds(self) -> bool:
        """Whether everything was as asked."""
        return all(check.holds for check in self.checks)

    @cached_property
    def checks(self) -> list[Check]:
        """Each thing that is asked."""
        return [
            self._every_frame(),
            *self._said_and_heard(),
            *self._silences(),
            *self._models(),
            *self._resources(),
            *self._times(),
        ]

    def _every_frame(self) -> Check:
        summary, asked = self.whole.loop["summary"], self.whole.extent.frames
        judged, left_out = summary["frames"], summary["dropped"]
        found = f"{judged} judged, {left_out} left out"
        return Check("frames", f"all {asked} judged", found, (judged, left_out) == (asked, 0))

    def _said_and_heard(self) -> list[Check]:
        heard, sent = self.whole.heard, self.whole.loop["sent"]
        wrong, lost = (_some(heard, names) for names in (_WRONG, _LOST))
        dropped = heard["dropped_by_the_system"]
        refused = self.whole.loop["refused"]
        words = f"{heard['datagrams']} of {sent['v2']} heard; {_words(lost)}"
        words += f"; refused by the system {refused}, dropped by it {dropped}"
        cautious = heard.get("cautious", 0)
        return [
            Check(
                "datagrams",
                "each one heard, in order, v1 as v2",
                words,
                not lost and heard["datagrams"] == sent["v2"],
            ),
            Check(
                "verdicts",
                "each as the frame is; never a wrong clear",
                f"{_words(wrong)}; {cautious} unknown as the machine was held up",
                not wrong,
            ),
        ]

    def _silences(self) -> list[Check]:
        heard, loop = self.whole.heard, self.whole.loop
        said, pauses = loop["summary"]["heartbeats"], loop["pauses"]
        came = heard.get("heartbeats", 0)
        least = pauses * int(self.whole.extent.pause_s / (SILENCE_S))
        longest = heard["longest_silence_s"]
        return [
            Check(
                "heartbeats",
                f"all that were said are heard; at least {least} in {pauses} pauses",
                f"{came} heard of {said}",
                came == said and said >= least,
            ),
            Check(
                "longest silence",
                f"at most {SILENCE_S:.2f} s at the receiver",
                f"{longest:.3f} s; longer {heard.get('long_silences', 0)} times",
                longest <= SILENCE_S,
            ),
        ]

    def _models(self) -> list[Check]:
        asked = self.whole.exchanges
        happened = Counter(name for name, _ in self.whole.loop["happened"])
        switches, refusals = happened["model"], happened["model_refused"]
        return [
            Check(
                "hot reloads",
                f"{asked.switches} models taken over, {asked.refusals} damaged ones refused",
                f"{switches} and {refusals}",
                (switches, refusals) == (asked.switches, asked.refusals),
            )
        ]

    def _resources(self) -> list[Check]:
        watch, loop = self.whole.watch, self.whole.loop
        if watch is None:
            return []
        ends = watch.ends()
        words = ", ".join(f"{name} {first} to {last}" for name, (first, last) in ends.items())
        same = all(last <= first for first, last in ends.values())
        checks = [
            Check("threads and files", "no more at the end", words, same),
            Check("log", "every line written", f"{loop['log_lines_failed']} lost",
                  not loop["log_lines_failed"]),
        ]  # fmt: skip
        grown = self.growth
        if grown is not None:
            found = (
                f"{grown.bytes_per_frame * 1e6:+,.0f} bytes per 10^6 frames "
                f"({grown.low * 1e6:+,.0f} to {grown.high * 1e6:+,.0f}), "
                f"{grown.mb_per_day:+.2f} MB a day; {grown.last_bytes / 1e6:.1f} MB at the end"
            )
            asked = "no growth within the interval"
            checks.append(Check("memory", asked, found, grown.none_to_be_seen))
        return checks

    def _times(self) -> list[Check]:
        figures, bare = self.latency["datagrams_out"], self.latency["bare_datagrams_out"]
        found = (
            f"median {figures['median_ms']:.2f}, p99 {figures['p99_ms']:.2f}, p99.9 "
            f"{figures['p99.9_ms']:.2f}, max {figures['max_ms']:.1f} ms: {figures['tail']:.2f} x "
            f"(bare loop: median {bare['median_ms']:.2f} ms, {bare['tail']:.2f} x)"
        )
        asked = f"p99.9 at most {MAX_TAIL:g} x the median"
        checks = [Check("latency", asked, found, figures["tail"] <= MAX_TAIL)]
        if self.restart is not None:
            times = self.restart
            words = f"median {times.at(50):.0f} ms, worst {times.at(WORST):.0f} ms"
            asked = f"each at most {times.asked_ms:g} ms"
            name, count = times.name, len(times.times_ms)
            found = f"{words}, {count} times"
            checks.append(Check(name, asked, found, bool(times.holds)))
        return checks

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        watch = self.whole.watch
        return {
            "holds": self.holds,
            "checks": [check.to_json() for check in self.checks],
            "latency": self.latency,
            "memory": None if self.growth is None else self.growth.to_json(),
            "samples": [] if watch is None else [vars(sample) for sample in watch.samples],
            "loop": self.whole.loop,
            "heard": self.whole.heard,
            "seconds": self.whole.seconds,
            "bare": {"loop": self.bare.loop, "heard": self.bare.heard},
            "restart": None if self.restart is None else self.restart.to_json(),
            **self.about,
        }


def _some(heard: dict[str, Any], names: tuple[str, ...]) -> dict[str, int]:
    return {name: heard[name] for name in names if heard.get(name)}


def _words(found: dict[str, int]) -> str:
    parts = [f"{name.replace('_', ' ')} {count}" for name, count in found.items()]
    return ", ".join(parts) or "none wrong"
