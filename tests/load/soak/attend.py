"""Looks at a soaked run from outside: its metrics, and the memory of its two processes."""

import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import psutil

from tokt.features.common.arrays import F64
from tokt.features.common.terminal import say

from .plan import SoakSize
from .ship import Ship

_LOOK_S = 0.05
_SAY_S = 60.0
_ENDS, _STARTED_S = 10, 3.0
"""Samples at either end of a run of which the fewest threads and files count, as a model that is
checked in another process has pipes for a moment; from so many seconds after a start."""


class Attendant:
    """Looks at a run as often as wanted, in a thread, while a block lasts.

    What each look saw is one of `samples`. A `life` is that of one runtime, `frames` are those that
    it has judged. `metrics` are those of the last look.
    """

    def __init__(self, ship: Ship, size: SoakSize) -> None:
        self.samples: list[dict[str, Any]] = []
        self.metrics: Counter[str] = Counter()
        self._ship, self._size = ship, size
        self._ended = threading.Event()
        self._pool = ThreadPoolExecutor(1)

    def __enter__(self) -> None:
        self._running = self._pool.submit(self._run)

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._pool.shutdown()
        self._running.result()

    def column(self, name: str) -> F64:
        return np.array([sample[name] for sample in self.samples], np.float64)

    def ends(self) -> dict[str, list[int]]:
        started = [sample for sample in self.samples if sample["life_s"] >= _STARTED_S]
        first, last = started[:_ENDS], started[-_ENDS:]
        return {
            name: [min(sample[name] for sample in part) for part in (first, last)]
            for name in ("threads", "files", "watchdog_threads", "watchdog_files")
            if started
        }

    def _run(self) -> None:
        look_at = time.monotonic()
        say_at = look_at + _SAY_S
        while not self._ended.wait(_LOOK_S):
            now = time.monotonic()
            if now >= look_at:
                self._look()
                if not self.samples:
                    continue  # it has only just begun: again at once
                look_at += self._size.look_every_s
            if now >= say_at:
                say_at += _SAY_S
                newest = self.samples[-1]
                say(f"   {newest['given']} frames, {newest['resident'] / 1e6:.1f} MB")

    def _look(self) -> None:
        """Take a sample; none where it does not answer, as it begins or has ended."""
        start = time.monotonic()
        try:
            runtime = self._ship.runtime()
            metrics = self._ship.metrics()
            sample = {
                "at_s": start,
                "life": runtime.pid,
                "given": self._ship.feeder.number + 1,
                **_resources(runtime, ""),
                **_resources(self._ship.process, "watchdog_"),
            }
        except psutil.NoSuchProcess:
            return
        if metrics is not None:
            self.metrics = metrics
            frames, lost = metrics["tokt_verdicts_total"], metrics["tokt_log_lines_failed_total"]
            sample |= {"frames": int(frames), "log_lines_lost": int(lost)}
            since_s = next(
                (one["at_s"] for one in self.samples if one["life"] == runtime.pid), start
            )
            self.samples.append({**sample, "life_s": start - since_s})


def _resources(process: psutil.Process, prefix: str) -> dict[str, int]:
    with process.oneshot():
        return {
            f"{prefix}resident": process.memory_info().rss,
            f"{prefix}threads": process.num_threads(),
            f"{prefix}files": process.num_fds(),
        }
