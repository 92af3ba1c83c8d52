"""Looks at a soaked run from outside, and another model for it now and then."""

from __future__ import annotations

import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray
from prometheus_client.parser import text_string_to_metric_families

from tokt.cli.output import say
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

from .plan import SoakSize

_CUT = 100
_SCRAPE_S = 5.0
_LOOK_S = 0.05
_SAY_S = 60.0
_ENDS = 10
"""Samples at either end of a run of which the fewest threads and files count: a model that is
checked in another process has pipes for a moment."""


class Exchanges:
    """Exchange a store's active model, now and then for a damaged one, each time it is asked for.

    ::

        1 ──deploy──> 2 ──rollback──> 1 ──deploy──> 2 ──deploy──> 3 (damaged) ──rollback──> 2 ──> 1

    The store is made here, with the first of three bundles active. `switches` are steps at which a
    runtime is to go over to another model, `refusals` those at which it is to refuse one.
    """

    def __init__(self, store: Path, bundles: Sequence[Bundle]) -> None:
        self.switches = self.refusals = 0
        self._store = Store(store)
        self._bundles = bundles
        self._steps = 0
        self._store.deploy(bundles[0], "the first")

    def step(self) -> None:
        """Make another model the active one."""
        place = self._steps % 6
        self._steps += 1
        if place in (0, 2):
            self._store.deploy(self._bundles[1], "the other")
            self.switches += 1
        elif place == 3:
            self._store.deploy(self._bundles[2], "its disk is bad")
            # Cut short; a runtime starts a process to look at it, which takes longer.
            bad = self._bundles[2]
            self._store.bundle_file(bad.sha256).write_bytes(bad.data[:-_CUT])
            self.refusals += 1
        else:
            self._store.rollback("back")
            self.switches += place != 4  # what was refused never ran


class Attendant:
    """Looks at a run as often as asked and exchanges its model, in a thread, while a block lasts.

    Its metrics are on 127.0.0.1 at `port`. What each look saw is one of `samples`: ``at_s``
    (`time.monotonic`), ``frames`` judged so far and ``models`` taken over or refused so far (by its
    own metrics), ``resident`` bytes in memory, how many ``threads`` and ``files`` it has open, and
    how long its metrics took (``scrape_s``). `metrics` are those of the last look, each the sum
    over its labels; `settled` says that every model was taken over or refused that was to be.
    """

    def __init__(self, pid: int, port: int, exchanges: Exchanges, extent: SoakSize) -> None:
        self.samples: list[dict[str, Any]] = []
        self.metrics: Counter[str] = Counter()
        self.settled = True
        self.exchanges = exchanges
        self._process = psutil.Process(pid)
        self._url = f"http://127.0.0.1:{port}/metrics"
        self._extent = extent
        self._ended = threading.Event()
        self._pool = ThreadPoolExecutor(1)

    def __enter__(self) -> None:
        self._running = self._pool.submit(self._run)

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._pool.shutdown()
        self._running.result()

    def column(self, name: str) -> NDArray[np.float64]:
        """One figure of all samples."""
        return np.array([sample[name] for sample in self.samples], np.float64)

    def ends(self) -> dict[str, list[int]]:
        """Threads and files at the start and at the end."""
        first, last = self.samples[:_ENDS], self.samples[-_ENDS:]
        return {
            name: [min(sample[name] for sample in part) for part in (first, last)]
            for name in ("threads", "files")
            if self.samples
        }

    def _run(self) -> None:
        look_at = time.monotonic()
        exchange_at, say_at = look_at + self._extent.exchange_every_s, look_at + _SAY_S
        while not self._ended.wait(_LOOK_S):
            now = time.monotonic()
            if now >= look_at:
                look_at += self._extent.look_every_s
                self._look()
            if not self.samples:
                continue
            newest = self.samples[-1]
            settled = newest["models"] == self.exchanges.switches + self.exchanges.refusals
            if now >= exchange_at and settled and newest["frames"] < self._extent.last_exchange:
                exchange_at, settled = now + self._extent.exchange_every_s, False
                self.exchanges.step()
            self.settled = settled
            if now >= say_at:
                say_at += _SAY_S
                say(f"   {newest['frames']} frames, {newest['resident'] / 1e6:.1f} MB")

    def _look(self) -> None:
        """Take a sample; none where it does not answer yet, or has ended meanwhile."""
        start = time.monotonic()
        try:
            with urllib.request.urlopen(self._url, timeout=_SCRAPE_S) as answer:
                text = answer.read().decode()
            sample = {"at_s": start, "scrape_s": time.monotonic() - start}
            with self._process.oneshot():
                sample["resident"] = self._process.memory_info().rss
                sample["threads"] = self._process.num_threads()
                sample["files"] = self._process.num_fds()
        except (OSError, psutil.NoSuchProcess):
            return
        self.metrics = found = summed(text)
        models = found["tokt_model_switches_total"] + found["tokt_model_refusals_total"]
        frames = found["tokt_verdicts_total"]
        self.samples.append({**sample, "frames": int(frames), "models": int(models)})


def summed(metrics: str) -> Counter[str]:
    """What each metric on a page has come to, over all its labels."""
    found: Counter[str] = Counter()
    for family in text_string_to_metric_families(metrics):
        for sample in family.samples:
            found[sample.name] += sample.value
    return found
