"""Costs of the steps of a program: time, and memory of it and of what it starts."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

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
    """Run a program that prints ``{"step": NAME, "began": ..., "ended": ...}`` after each step.

    Its times are of `time.monotonic`; what else is in the line are the step's facts.

    Raises
    ------
    ToktError
        If it ends with an error; its own last words are passed on.
    """
    usage = [(0.0, 0, 0.0)]
    with TemporaryFile("w+") as said, TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=said, stderr=errors)
        try:
            while process.poll() is None:
                usage.append((time.monotonic(), *_usage(process.pid)))
                time.sleep(_POLL_S)
        finally:
            process.kill()
            process.wait()
        said.seek(0)
        errors.seek(0)
        steps = [json.loads(line) for line in said]
        last = (errors.readlines() or ["no message"])[-1].strip()
    if process.returncode:
        raise ToktError(f"a step of the measurement ended with code {process.returncode}: {last}")
    return [_cost(np.array(usage), **step) for step in steps]


def _cost(usage: NDArray[np.float64], step: str, began: float, ended: float, **facts: Any) -> Cost:
    """The cost of one step, given what was in use at which time."""
    at, resident, cpu_s = usage.T
    used_s = cpu_s[at <= ended].max() - cpu_s[at <= began].max()
    peak = resident[(began <= at) & (at <= ended)].max(initial=0)
    return Cost(step, ended - began, float(used_s), float(peak) / 1e6, facts)


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
