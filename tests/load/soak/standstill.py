"""Standstills of the whole machine, seen by a process that does nothing but look at the clock."""

import multiprocessing
import time
from contextlib import suppress
from multiprocessing.connection import Connection

Interval = tuple[float, float]
"""From and to, in seconds of `time.monotonic`, which all processes share."""

TICK_S = 0.02
STANDSTILL_S = 0.2
"""Between two looks at the clock, and how far apart they are where the machine stands. A busy one
runs a process that only sleeps before those that work: it is late by some milliseconds."""


class StandstillWatch:
    """Look for standstills while a block lasts."""

    def __enter__(self) -> "StandstillWatch":
        spawning = multiprocessing.get_context("spawn")
        self._ours, theirs = spawning.Pipe()
        self._process = spawning.Process(target=_look, args=(theirs,), daemon=True)
        self._process.start()
        self._ours.recv()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ours.close()
        self._process.join()

    def gaps(self) -> list[Interval]:
        """Return those up to now."""
        self._ours.send(None)
        return list(self._ours.recv())


def _look(asked: Connection) -> None:
    gaps: list[Interval] = []
    before = time.monotonic()
    asked.send(None)
    with suppress(EOFError):
        while True:
            is_asked = asked.poll(TICK_S)
            now = time.monotonic()
            if now - before >= STANDSTILL_S:
                gaps.append((before, now))
            before = now
            if is_asked:
                asked.recv()
                asked.send(gaps)


def overlap_s(one: Interval, other: Interval) -> float:
    """Seconds that two intervals have in common."""
    return max(min(one[1], other[1]) - max(one[0], other[0]), 0.0)
