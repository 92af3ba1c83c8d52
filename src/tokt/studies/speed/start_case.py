"""From the start of a process to the datagram with its first verdict, and its peak memory."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode

from . import launch
from .models import ModelPair
from .paired_timing import BASELINE, OURS, Result, result

_LOOK_EVERY_S = 0.2  # whether the process still runs; a datagram is taken at once
_MAX_DATAGRAM = 65535


@dataclass(frozen=True)
class ProcessStart:
    """One process's way to its first verdict.

    Parameters
    ----------
    seconds : float
    peak_mb : float or None
    said : (status, x, y)
    """

    seconds: float
    peak_mb: float | None
    said: tuple[Any, ...]


def first_verdict(command: Callable[[int], list[str]], folder: Path) -> ProcessStart:
    """Start a program and wait for its datagram and its end.

    Parameters
    ----------
    command : callable
        Gives the command line for a UDP port of 127.0.0.1.
    folder : Path
        Where the program runs.

    Raises
    ------
    ToktError
        If it ends with an error, or no datagram arrives.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(_LOOK_EVERY_S)
        line = [sys.executable, "-I", "-S", launch.__file__, *command(receiver.getsockname()[1])]
        with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
            datagram = _wait(receiver, process)
            arrived = time.monotonic()
            told = json.loads(process.communicate()[0])
    if told["code"] != 0 or datagram is None:
        raise ToktError(f"a process of the bench ended with {told['code']}: {told['error']}")
    heard = decode(datagram)
    said = (heard["status"], heard["x"], heard["y"])
    return ProcessStart(arrived - told["started"], told["peak_mb"], said)


def _wait(receiver: socket.socket, process: subprocess.Popen[str]) -> bytes | None:
    """The first datagram, at the moment it arrives; None if the process ends without one."""
    ended = False
    while True:
        try:
            return receiver.recv(_MAX_DATAGRAM)
        except TimeoutError:
            if ended:
                return None
            ended = process.poll() is not None


def measure_start(
    name: str, models: ModelPair, frame: bytes, suffix: str, folder: Path, rounds: int
) -> Result:
    """Time both processes, in turns, on the same frame.

    Parameters
    ----------
    name : str
    models : ModelPair
        Of LBP (10, 5).
    frame, suffix : bytes, str
        An image file and the ending of its name.
    folder : Path
        Empty, for the model files and the frame.
    rounds : int
        Starts of each, after one that is not counted.
    """
    source = folder / "source"
    source.mkdir(parents=True)
    picture, bundle, pickle = source / f"frame_1{suffix}", folder / "m.tokt", folder / "m.joblib"
    picture.write_bytes(frame)
    bundle.write_bytes(models.bundle.data)
    joblib.dump(models.classifier, pickle)

    def ours(port: int) -> list[str]:
        words = f"run --policy texture --format v2 --udp 127.0.0.1:{port}".split()
        files = ["--bundle", str(bundle), "--source", str(source)]
        return [sys.executable, "-m", "tokt", *words, *files]

    def baseline(port: int) -> list[str]:
        module = "tokt.studies.speed.thesis_process"
        return [sys.executable, "-m", module, str(pickle), str(picture), str(port)]

    pairs = [
        (first_verdict(baseline, folder), first_verdict(ours, folder)) for _ in range(rounds + 1)
    ][1:]
    times = {
        BASELINE: np.array([theirs.seconds for theirs, _ in pairs]),
        OURS: np.array([mine.seconds for _, mine in pairs]),
    }
    memory = {
        "baseline_mb": _median_mb([theirs for theirs, _ in pairs]),
        "ours_mb": _median_mb([mine for _, mine in pairs]),
    }
    said = {start.said for pair in pairs for start in pair}
    extras = {"of": "process start to first verdict, LBP (10,5)", **memory}
    return result(name, times, len(said) == 1, extras)


def _median_mb(starts: list[ProcessStart]) -> float | None:
    peaks = [start.peak_mb for start in starts if start.peak_mb is not None]
    return float(np.median(peaks)) if peaks else None
