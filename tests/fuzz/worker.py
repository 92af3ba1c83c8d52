"""A process that runs cases until it is told to stop, or dies of one."""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .case import GOOD, Outcome, randomness, run_case
from .sandbox import Sandbox

_MOST_MEMORY = 3 << 30
"""Bytes of address space beyond what the process has when it begins."""
_MOST_KEPT = 3
"""Failures of one chunk that are reported in words."""


@dataclass(frozen=True)
class Chunk:
    """Some cases of one kind, from `start` to before `stop`."""

    kind: str
    start: int
    stop: int


@dataclass
class Done:
    """What came of a chunk."""

    ends: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    slowest_case: int = -1
    memory_mb: float = 0.0
    failures: list[tuple[int, Outcome]] = field(default_factory=list)


def serve(pipe: Connection, place: Any, table: str, seed: int, notes: str) -> None:
    """Run the chunks that come through a pipe.

    Parameters
    ----------
    pipe : Connection
        Brings chunks, None for the end; takes `Done`.
    place : shared array of int64
        The case that is being run, for whoever watches.
    table : str
        Module with the `KINDS`.
    seed : int
    notes : str
        File for the stack of a process that is told to show it (SIGUSR1) or that crashes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    memory = Path("/dev/shm")
    with (
        Path(notes).open("w", encoding="utf-8") as stack,
        tempfile.TemporaryDirectory(
            prefix="tokt-fuzz-", dir=memory if os.access(memory, os.W_OK) else None
        ) as box,
    ):
        # What libraries of others print on the way does not belong in the table.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
        faulthandler.enable(stack)
        faulthandler.register(signal.SIGUSR1, stack, all_threads=True)
        sandbox = Sandbox(Path(box))
        kinds = __import__(table, fromlist=["KINDS"]).KINDS
        sandbox.enter()
        _limit_memory()
        pipe.send(None)
        while (chunk := pipe.recv()) is not None:
            pipe.send(_run(chunk, kinds[chunk.kind], seed, sandbox, place))
        os.chdir("/")


def _limit_memory() -> None:
    has = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * resource.getpagesize()
    limit = has + _MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    # A crash is told by its signal; nobody reads the memory it leaves.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _run(chunk: Chunk, kind: Any, seed: int, sandbox: Sandbox, place: Any) -> Done:
    done = Done()
    before = _most_memory_mb(reset=True)
    for number in range(chunk.start, chunk.stop):
        place[0] = number
        outcome = run_case(kind, kind.make(randomness(seed, kind.name, number)), sandbox)
        done.ends[outcome.end] += 1
        if outcome.seconds > done.slowest_s:
            done.slowest_s, done.slowest_case = outcome.seconds, number
        if outcome.end not in GOOD and len(done.failures) < _MOST_KEPT:
            done.failures.append((number, outcome))
    done.memory_mb = _most_memory_mb() - before
    return done


def _most_memory_mb(reset: bool = False) -> float:
    """The most memory the process has had since the last reset (Linux: proc(5), clear_refs)."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5", "ascii")
    status = Path("/proc/self/status").read_text("ascii")
    found = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(found.split()[1]) / 1024
