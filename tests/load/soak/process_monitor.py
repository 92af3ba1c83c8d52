"""A monitor of a running loop: its memory, its threads and files, and its metrics."""

from __future__ import annotations

import time
import urllib.request
from dataclasses import dataclass

import numpy as np
import psutil
from numpy.typing import NDArray

_SCRAPE_S = 5.0
_JUDGED = "tokt_verdicts_total"
_MODELS = ("tokt_model_switches_total", "tokt_model_refusals_total")
_ENDS = 10
"""Samples at either end of a run of which the fewest threads and files count: a model that is
checked in another process has pipes for a moment."""


@dataclass(frozen=True)
class Sample:
    """One look.

    Parameters
    ----------
    at_s : float
        `time.monotonic`.
    frames : int
        Judged so far, by its own metrics.
    models : int
        Models taken over or refused so far, by them as well.
    resident : int
        Bytes in memory.
    threads, files : int
        How many it has open.
    scrape_s : float
        How long its metrics took.
    """

    at_s: float
    frames: int
    models: int
    resident: int
    threads: int
    files: int
    scrape_s: float


class ProcessMonitor:
    """Take samples of a process that serves metrics.

    Parameters
    ----------
    pid : int
    port : int
        Of its metrics, on 127.0.0.1.
    """

    def __init__(self, pid: int, port: int) -> None:
        self.samples: list[Sample] = []
        self._process = psutil.Process(pid)
        self._url = f"http://127.0.0.1:{port}/metrics"

    def look(self) -> None:
        """Take a sample; none where it has ended meanwhile."""
        start = time.monotonic()
        try:
            with urllib.request.urlopen(self._url, timeout=_SCRAPE_S) as answer:
                text = answer.read().decode()
            took_s = time.monotonic() - start
            with self._process.oneshot():
                resident = self._process.memory_info().rss
                threads = self._process.num_threads()
                files = self._process.num_fds() if psutil.POSIX else self._process.num_handles()
        except (OSError, psutil.NoSuchProcess):
            return
        models = sum(counted(text, name) for name in _MODELS)
        frames = counted(text, _JUDGED)
        self.samples.append(Sample(start, frames, models, resident, threads, files, took_s))

    def memory(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frames and bytes of all samples."""
        frames = np.array([sample.frames for sample in self.samples], np.float64)
        return frames, np.array([sample.resident for sample in self.samples], np.float64)

    def ends(self) -> dict[str, list[int]]:
        """Threads and files at the start and at the end."""
        first, last = self.samples[:_ENDS], self.samples[-_ENDS:]
        return {
            name: [min(getattr(sample, name) for sample in part) for part in (first, last)]
            for name in ("threads", "files")
            if self.samples
        }


def counted(metrics: str, name: str) -> int:
    """What a counter on a page of metrics has come to, over all its labels."""
    lines = (line for line in metrics.splitlines() if line.startswith((name + " ", name + "{")))
    return int(sum(float(line.rpartition(" ")[2]) for line in lines))
