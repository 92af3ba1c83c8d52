"""Looks at a soaked run from outside, and another model for it now and then."""

import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import psutil
from prometheus_client.parser import text_string_to_metric_families

from tokt.features.common.arrays import F64
from tokt.features.common.terminal import say
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

_CUT = 100
_SCRAPE_S = 5.0
_LOOK_S = 0.05
_SAY_S = 60.0
_ENDS = 10
"""Samples at either end of a run of which the fewest threads and files count: a model that is
checked in another process has pipes for a moment."""


SWITCHED, REFUSED = "model", "model_refused"
"""What a runtime's log says where it went over to another model, and where it refused one."""


def exchanges(store: Store, models: Sequence[Bundle]) -> Iterator[str | None]:
    """Exchange the active model, the first of three, for ever; what each is to lead to."""
    _, other, bad = models
    while True:
        store.deploy(other, "the other")
        yield SWITCHED
        store.rollback("back")
        yield SWITCHED
        store.deploy(other, "the other")
        yield SWITCHED
        store.deploy(bad, "its disk is bad")
        # Cut short; a runtime starts a process to look at it, which takes longer.
        store.bundle_file(bad.sha256).write_bytes(bad.data[:-_CUT])
        yield REFUSED
        store.rollback("back")
        yield None  # what was refused never ran
        store.rollback("back")
        yield SWITCHED


class Attendant:
    """Looks at a run as often as asked and exchanges its model, in a thread, while a block lasts.

    Its metrics are on 127.0.0.1 at `port`. `asked` counts what `exchanges` were to lead to. What
    each look saw is one of `samples`; `metrics` are those of the last look, each the sum over its
    labels; `settled` says that every model was taken over or refused that was to be.
    """

    def __init__(self, pid, port, exchanges, extent) -> None:
        self.samples: list[dict[str, Any]] = []
        self.metrics: Counter[str] = Counter()
        self.settled = True
        self.asked: Counter[str | None] = Counter()
        self._exchanges = exchanges
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

    def column(self, name: str) -> F64:
        return np.array([sample[name] for sample in self.samples], np.float64)

    def ends(self) -> dict[str, list[int]]:
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
                self._look()
                if not self.samples:
                    continue  # it has only just begun: again at once
                look_at += self._extent.look_every_s
            newest = self.samples[-1]
            settled = newest["models"] == self.asked[SWITCHED] + self.asked[REFUSED]
            if now >= exchange_at and settled and newest["frames"] < self._extent.last_exchange:
                exchange_at, settled = now + self._extent.exchange_every_s, False
                self.asked[next(self._exchanges)] += 1
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
    found: Counter[str] = Counter()
    for family in text_string_to_metric_families(metrics):
        for sample in family.samples:
            found[sample.name] += sample.value
    return found
