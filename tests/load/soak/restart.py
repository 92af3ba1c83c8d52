"""Silence after the runtime was killed: from SIGKILL to the next datagram."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import psutil

from tests.load.timing import WORST, Timing
from tokt.features.common.errors import ToktError
from tokt.inference.monitoring.watchdog import WatchdogTimeouts
from tokt.inference.outputs.udp import decode
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

from .synthetic_frames import near

NAME = "restart.kill_to_datagram"
ASKED_MS = 1000.0
_RATE = 20
_FRAMES = 300
_STEADY_S = WatchdogTimeouts().steady_s
"""A runtime that dies sooner is started after a pause; that is not what is measured here."""
_MARGIN_S = 0.5
_SILENCE_S = 30.0
_MAX_DATAGRAM = 65535

Progress = Callable[..., Iterable[int]]


def measure_restart(folder: Path, bundle: Bundle, kills: int, progress: Progress) -> Timing:
    """Kill the real command's runtime again and again under its watchdog.

    Parameters
    ----------
    folder : Path
        Empty, for a store and a dive.
    bundle : Bundle
    kills : int
    progress : callable

    Raises
    ------
    ToktError
        If the runtime does not come back.
    """
    Store(folder / "store").deploy(bundle)
    dive = folder / "dive"
    dive.mkdir(parents=True)
    for number in range(_FRAMES):
        cv2.imwrite(str(dive / f"t_{number + 1}.png"), near(number))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(_SILENCE_S)
        with _watched_run(folder, receiver.getsockname()[1]) as process:
            _next_start(receiver)
            times = []
            for number in progress(range(kills), kills, "kill"):
                if number:
                    _wait_until_steady(receiver)
                times.append(_kill(process, receiver))
    what = "from SIGKILL of the runtime to the first datagram of the next one"
    return Timing(NAME, what, [1000 * seconds for seconds in times], ASKED_MS, WORST)


@contextmanager
def _watched_run(folder: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    words = f"run --watchdog --rate {_RATE} --format v2 --policy texture --udp 127.0.0.1:{port}"
    files = ["--store", str(folder / "store"), "--source", str(folder / "dive")]
    command = [sys.executable, "-m", "tokt", *words.split(), *files]
    with (folder / "said").open("wb") as said:
        process = subprocess.Popen(command, stderr=said, stdout=subprocess.DEVNULL)
        try:
            yield process
        finally:
            process.terminate()
            process.wait()


def _next_start(receiver: socket.socket) -> float:
    """The moment of the next datagram that begins a run."""
    while True:
        try:
            data = receiver.recv(_MAX_DATAGRAM)
        except TimeoutError:
            raise ToktError(f"nothing was heard for {_SILENCE_S:g} s after a kill") from None
        now = time.monotonic()
        if decode(data)["seq"] == 1:
            return now


def _kill(process: subprocess.Popen[bytes], receiver: socket.socket) -> float:
    """Seconds from a kill to the next run's first datagram."""
    runtime = psutil.Process(process.pid).children()[0]
    start = time.monotonic()
    os.kill(runtime.pid, signal.SIGKILL)
    return _next_start(receiver) - start


def _wait_until_steady(receiver: socket.socket) -> None:
    """Listen until the runtime has lived for so long that it is started again at once."""
    until = time.monotonic() + _STEADY_S + _MARGIN_S
    while time.monotonic() < until:
        receiver.recv(_MAX_DATAGRAM)
