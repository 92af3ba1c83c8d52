"""Costs of the steps of a program: time, and memory of it and of what it starts."""

import json
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import psutil

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError

_POLL_S = 0.02

Cost = dict[str, Any]
"""Of one step: ``seconds``; ``cpu_s``, the processor time of the process and all that it started
(on a busy computer it says more); ``peak_mb``, their resident memory at the same moment, in MB
(10**6 bytes), in which files that are mapped count as far as they were read; ``own_mb``, the same
without those; and what else the step said of itself."""


def watched(command: Sequence[str]) -> dict[str, Cost]:
    """Run a program that prints ``{"step": NAME, "began": ..., "ended": ...}`` after each step.

    Its times are of `time.monotonic`; what else is in the line are the step's facts. Raises
    ToktError with its own last words if it ends with an error.
    """
    usage = [(0.0, 0, 0, 0.0)]
    with TemporaryFile("w+") as said, TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=said, stderr=errors)
        try:
            while process.poll() is None:
                usage.append((time.monotonic(), *usage_of(process.pid)))
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
    return {step.pop("step"): cost_of(np.array(usage), **step) for step in steps}


def cost_of(usage: F64, began: float, ended: float, **facts: Any) -> Cost:
    """The cost of one step, given what was in use at which time."""
    at, resident, own, cpu_s = usage.T
    used_s = cpu_s[at <= ended].max() - cpu_s[at <= began].max()
    during = (began <= at) & (at <= ended)
    peak, peak_own = (float(held[during].max(initial=0)) / 1e6 for held in (resident, own))
    times = {"seconds": ended - began, "cpu_s": float(used_s)}
    return {**times, "peak_mb": peak, "own_mb": peak_own, **facts}


def usage_of(pid: int) -> tuple[int, int, float]:
    """Bytes in memory, of them not of files, and processor seconds of a process and its own."""
    resident, own, cpu_s = 0, 0, 0.0
    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(pid)
        for member in (process, *process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess), member.oneshot():
                memory = member.memory_info()
                resident += memory.rss
                own += memory.rss - memory.shared
                cpu_s += sum(member.cpu_times()[:2])
    return resident, own, cpu_s
