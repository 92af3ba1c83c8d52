"""Replay frames through the real runtime, as a process of its own, into a real UDP socket."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import format_frames
from tokt.inference.outputs.udp import decode

_MAX_DATAGRAM = 65535
_LAST_DATAGRAM_WAIT_S = 0.5


@dataclass(frozen=True)
class DemoReplay:
    """The log and the datagrams of a replay.

    Parameters
    ----------
    log : list of dict
        The runtime's log, one entry a frame, with decision values.
    datagrams : list of bytes
        As they arrived.
    """

    log: list[dict[str, Any]]
    datagrams: list[bytes]

    def disagreements(self) -> int:
        """Datagrams (v1) that do not say what the log says, and verdicts that never arrived."""
        sent = [entry for entry in self.log if entry["status"] != -1]
        wrong = abs(len(sent) - len(self.datagrams))
        for entry, datagram in zip(sent, self.datagrams, strict=False):
            heard = decode(datagram)
            same = all(heard[key] == entry[key] for key in ("status", "x", "y"))
            wrong += not same or abs(heard["mean"] - entry["mean"]) > 1e-9 * max(1, entry["mean"])
        return wrong


def _receive(receiver: socket.socket, done: threading.Event, datagrams: list[bytes]) -> None:
    receiver.settimeout(_LAST_DATAGRAM_WAIT_S)
    while True:
        try:
            datagrams.append(receiver.recv(_MAX_DATAGRAM))
        except TimeoutError:
            if done.is_set():
                return


def replay(store: Path, mission: Path, frames: list[int], log: Path) -> DemoReplay:
    """Run ``tokt run`` on some frames of a mission and listen to what it sends.

    Parameters
    ----------
    store : Path
        The deploy store whose active model judges.
    mission : Path
    frames : list of int
    log : Path
        Where the runtime's log goes; replaced.

    Raises
    ------
    ToktError
        If the runtime ends with an error; its own words are passed on.
    """
    log.unlink(missing_ok=True)
    datagrams: list[bytes] = []
    done = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        receiver.bind(("127.0.0.1", 0))
        listener = threading.Thread(target=_receive, args=(receiver, done, datagrams))
        listener.start()
        try:
            _run(store, mission, frames, log, receiver.getsockname()[1])
        finally:
            done.set()
            listener.join()
    lines = log.read_text("utf-8").splitlines()
    return DemoReplay([json.loads(line) for line in lines], datagrams)


def _run(store: Path, mission: Path, frames: list[int], log: Path, port: int) -> None:
    command = [sys.executable, "-m", "tokt", "run", "--store", str(store)]
    command += ["--source", str(mission), "--frames", format_frames(frames)]
    command += ["--policy", "texture", "--udp", f"127.0.0.1:{port}", "--format", "v1"]
    command += ["--log", str(log), "--log-values"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
        raise ToktError(f"the runtime ended with code {ended.returncode}: {last}")
