"""Workers and their watchdog: a case that crashes or hangs ends its worker, not the run."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from .case import End, Outcome
from .worker import Chunk, Done, serve

_CHUNK = 200
_LOOK_S = 0.2
_SHOW_S = 0.5
"""How long a process that hangs has to write down where it is."""


@dataclass
class Row:
    """What came of one kind."""

    kind: str
    ends: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    slowest_case: int = -1
    memory_mb: float = 0.0

    def add(self, done: Done) -> None:
        """Count a chunk in."""
        self.ends += done.ends
        self.memory_mb = max(self.memory_mb, done.memory_mb)
        if done.slowest_s > self.slowest_s:
            self.slowest_s, self.slowest_case = done.slowest_s, done.slowest_case


Told = Callable[[str, int, Outcome], None]
"""Given kind, case number and outcome of each failure."""


class _Worker:
    """One process, what it is doing and since when."""

    def __init__(self, table: str, seed: int, notes: Path) -> None:
        context = multiprocessing.get_context("spawn")
        self.notes = notes
        self.place: Any = context.RawArray("q", 1)
        self.pipe, far = context.Pipe()
        self.process = context.Process(
            target=serve, args=(far, self.place, table, seed, str(notes))
        )
        self.process.start()
        far.close()
        self.ready = False
        self.chunk: Chunk | None = None
        self._seen, self._since = -1, time.monotonic()

    def give(self, chunk: Chunk) -> None:
        """Have it run a chunk."""
        self.place[0] = chunk.start
        self.chunk, self._seen, self._since = chunk, -1, time.monotonic()
        self.pipe.send(chunk)

    def stuck_s(self) -> float:
        """For how long it has been at the same case, in seconds."""
        now, at = time.monotonic(), self.place[0]
        if at != self._seen or self.chunk is None:
            self._seen, self._since = at, now
        return now - self._since

    def stop(self) -> str:
        """End a process that hangs; gives where it was."""
        if self.process.pid is not None and self.process.is_alive():
            os.kill(self.process.pid, signal.SIGUSR1)
            time.sleep(_SHOW_S)
            self.process.kill()
        self.process.join()
        return self.notes.read_text("utf-8", "replace")[-4000:]


class Fleet:
    """Run chunks of cases in some processes.

    Parameters
    ----------
    table : str
        Module with the `KINDS`, by name.
    seed : int
    workers : int
    limit_s : float
        Seconds on the clock that a case may take.
    told : callable

    Attributes
    ----------
    rows : mapping of str to Row
        What came of each kind so far.
    """

    def __init__(self, table: str, seed: int, workers: int, limit_s: float, told: Told) -> None:
        self._table, self._seed, self._limit_s, self._told = table, seed, limit_s, told
        self._n = workers
        self._pending: deque[Chunk] = deque()
        self.rows: dict[str, Row] = {}

    def run(self, counts: dict[str, int], first: int = 0) -> list[Row]:
        """Run so many cases of each kind, numbered from `first`."""
        self.rows = {kind: Row(kind) for kind in counts}
        self._pending = deque(
            Chunk(kind, start, min(start + _CHUNK, first + count))
            for kind, count in counts.items()
            for start in range(first, first + count, _CHUNK)
        )
        with tempfile.TemporaryDirectory(prefix="tokt-fuzz-notes-") as notes:
            self._notes = Path(notes)
            workers: list[_Worker] = []
            try:
                self._work(workers)
            finally:
                for worker in workers:
                    worker.process.kill()
                    worker.process.join()
        return list(self.rows.values())

    def _work(self, workers: list[_Worker]) -> None:
        made = 0
        while True:
            for worker in workers:
                if worker.ready and worker.chunk is None and self._pending:
                    worker.give(self._pending.popleft())
            busy = [worker for worker in workers if worker.chunk is not None]
            while len(workers) < self._n and len(self._pending) > len(workers) - len(busy):
                made += 1
                workers.append(_Worker(self._table, self._seed, self._notes / str(made)))
            if not self._pending and not busy:
                break
            wait([worker.pipe for worker in workers], _LOOK_S)
            for worker in list(workers):
                if self._has_ended(worker):
                    workers.remove(worker)
        for worker in workers:
            if worker.ready:
                worker.pipe.send(None)
                worker.process.join()

    def _has_ended(self, worker: _Worker) -> bool:
        """Take in what a worker says; whether it has died or was ended."""
        try:
            while worker.pipe.poll():
                self._take(worker, worker.pipe.recv())
        except (EOFError, ConnectionResetError):
            worker.process.join()
            code = worker.process.exitcode or 0
            name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            if worker.chunk is None:
                raise RuntimeError(f"a worker ended by itself: {name}; {worker.stop()}") from None
            self._lost(worker, End.CRASH, f"{name}\n{worker.stop()}")
            return True
        if worker.chunk is not None and worker.stuck_s() > self._limit_s:
            self._lost(worker, End.HANG, f"over {self._limit_s:g} s\n{worker.stop()}")
            return True
        return False

    def _take(self, worker: _Worker, message: Done | None) -> None:
        if message is None or worker.chunk is None:
            worker.ready = True
            return
        self.rows[worker.chunk.kind].add(message)
        for number, outcome in message.failures:
            self._told(worker.chunk.kind, number, outcome)
        worker.chunk = None

    def _lost(self, worker: _Worker, end: End, words: str) -> None:
        """A case has ended its worker: the rest of the chunk is run anew, without it."""
        chunk, number = worker.chunk, int(worker.place[0])
        assert chunk is not None
        self.rows[chunk.kind].ends[end] += 1
        self._told(chunk.kind, number, Outcome(end, words))
        for start, stop in ((chunk.start, number), (number + 1, chunk.stop)):
            if start < stop:
                self._pending.append(Chunk(chunk.kind, start, stop))
