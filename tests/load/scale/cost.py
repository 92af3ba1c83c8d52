"""Costs of the steps of a program: time, and memory of it and of what it starts."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Any

import psutil

from tokt.features.common.errors import ToktError

_POLL_S = 0.02


@dataclass(frozen=True)
class Cost:
    """Time and memory of one step.

    Parameters
    ----------
    step : str
    seconds : float
    cpu_s : float
        Processor time of the process and all that it started: on a busy computer it says more.
    peak_mb : float
        Resident memory of the process and all that it started, at the same moment, in MB (10**6
        bytes). Files that are mapped into memory count as far as they were read.
    facts : dict
        What else the step said of itself.
    """

    step: str
    seconds: float
    cpu_s: float
    peak_mb: float
    facts: dict[str, Any] = field(default_factory=dict)


def watched(command: Sequence[str]) -> list[Cost]:
    """Run a program that prints ``{"begin": STEP}`` and then ``{"seconds": ...}`` for each step.

    Raises
    ------
    ToktError
        If it ends with an error; its own last words are passed on.
    """
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    steps = _Steps()
    errors: list[str] = []
    readers = [
        threading.Thread(target=steps.read, args=(process.stdout,)),
        threading.Thread(target=lambda pipe: errors.extend(pipe), args=(process.stderr,)),
    ]
    for reader in readers:
        reader.start()
    try:
        while process.poll() is None:
            steps.saw(*_usage(process.pid))
            time.sleep(_POLL_S)
    finally:
        process.kill()
        process.wait()
        for reader in readers:
            reader.join()
    if process.returncode:
        last = (errors or ["no message"])[-1].strip()
        raise ToktError(f"a step of the measurement ended with code {process.returncode}: {last}")
    return steps.costs


class _Steps:
    """The steps a program told of, and what was seen in each."""

    def __init__(self) -> None:
        self.costs: list[Cost] = []
        self._now = ""
        self._resident, self._cpu_s, self._cpu_s_before = 0, 0.0, 0.0

    def read(self, lines: IO[str]) -> None:
        """Follow the program until it ends."""
        for line in lines:
            said = json.loads(line)
            if "begin" in said:
                self._now, self._resident = said["begin"], 0
                self._cpu_s_before = self._cpu_s
                continue
            cpu_s = self._cpu_s - self._cpu_s_before
            self.costs.append(
                Cost(self._now, said.pop("seconds"), cpu_s, self._resident / 1e6, said)
            )

    def saw(self, resident: int, cpu_s: float) -> None:
        """Take note of the memory in use now, and of the processor time so far."""
        self._resident = max(self._resident, resident)
        self._cpu_s = max(self._cpu_s, cpu_s)


def _usage(pid: int) -> tuple[int, float]:
    """Bytes in memory and processor seconds of a process and of all that it started."""
    resident, cpu_s = 0, 0.0
    try:
        process = psutil.Process(pid)
        family = [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return resident, cpu_s
    for member in family:
        with suppress(psutil.NoSuchProcess), member.oneshot():
            resident += member.memory_info().rss
            cpu_s += sum(member.cpu_times()[:2])
    return resident, cpu_s
