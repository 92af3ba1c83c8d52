"""The runtime in real time: what is heard while no frame comes, and after it was killed."""

import json
import socket
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil

from tests.load.program import ended, program
from tests.load.report import WORST, Timing
from tokt.cli.output import progress
from tokt.features.common.errors import ToktError
from tokt.inference.monitoring.watchdog import STEADY_S
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.verdict import UNKNOWN
from tokt.models.bundle.bundle import Bundle
from tokt.models.store.store import Store

from .feed import datagram, receiver
from .synthetic_frames import near

NAME = "restart.kill_to_datagram"
ASKED_MS = 1000.0
_RATE = 20
_FRAMES = 300
_MARGIN_S = 0.5
_SILENCE_S = 30.0
_END_S = 1.0
_NO_FRAME = frozenset({Reason.NO_FRAME, Reason.STALE, Reason.STALLED})


class LiveRuns:
    """Runs of one dive in real time, with store and dive in a folder of their own."""

    def __init__(self, folder: Path, bundle: Bundle) -> None:
        self._folder = folder
        Store(folder / "store").deploy(bundle)
        (folder / "dive").mkdir(parents=True)
        for number in range(_FRAMES):
            cv2.imwrite(str(folder / "dive" / f"t_{number + 1}.png"), near(number))

    def pauses(self, count: int, pause_s: float) -> dict[str, Any]:
        """Let so much time pass between frames, so often. Raises ToktError if the run fails.

        Heartbeats ``said`` by the run's own count, ``heard`` at the receiver and ``wrong``, as they
        were not unknown; and ``silences_s``, from each datagram to the next.
        """
        options = ("--rate", 1 / pause_s, "--frames", f"1-{count + 1}", "--json")
        times, heartbeats = [], []
        with receiver() as heard, self._running(heard, *options) as process:
            data: bytes | None = b""
            while data is not None or process.poll() is None:
                if (data := datagram(heard, _END_S)) is not None:
                    times.append(time.monotonic())
                    said = decode(data)
                    if said["latency_ms"] is None:
                        heartbeats.append(said)
            if process.returncode:
                raise ended("run", process, self._folder / "said")
            summary = json.load(process.stdout)
        unknown = [said["status"] == UNKNOWN and said["reason"] in _NO_FRAME for said in heartbeats]
        counts = {"heard": len(heartbeats), "wrong": unknown.count(False)}
        return {"said": summary["heartbeats"], **counts, "silences_s": np.diff(times).tolist()}

    def restarts(self, kills: int) -> Timing:
        """Kill the runtime again and again. Raises ToktError if it does not come back."""
        with receiver() as heard, self._running(heard, "--watchdog", "--rate", _RATE) as process:
            _next_start(heard)
            times = []
            for number in progress(range(kills), kills, "kill"):
                steady_at = time.monotonic() + (STEADY_S + _MARGIN_S if number else 0)
                while time.monotonic() < steady_at:
                    datagram(heard, _SILENCE_S)
                runtime = psutil.Process(process.pid).children()[0]
                start = time.monotonic()
                runtime.kill()
                times.append(1000 * (_next_start(heard) - start))
        what = "from SIGKILL of the runtime to the first datagram of the next one"
        return Timing(NAME, what, times, ASKED_MS, WORST)

    def _running(self, heard, *options):
        fixed = ["--policy", "texture", "--udp", f"v2@127.0.0.1:{heard.getsockname()[1]}"]
        fixed += ["--store", self._folder / "store", "--source", self._folder / "dive"]
        return program("run", *fixed, *options, said=self._folder / "said")


def _next_start(heard: socket.socket) -> float:
    while (data := datagram(heard, _SILENCE_S)) is not None:
        now = time.monotonic()
        if decode(data)["seq"] == 1:
            return now
    raise ToktError(f"nothing was heard for {_SILENCE_S:g} s after a kill")
