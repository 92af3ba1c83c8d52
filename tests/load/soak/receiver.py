"""The receiving end of a soak, in a process of its own: it holds every datagram against the truth.

Run as ``python -m tests.load.soak.receiver FOLDER FRAMES SILENCE_S``. Its ports are the
first line on standard output; it goes on until its standard input ends, and then says what it
heard. ``FOLDER/heard.npz`` has the time at which each frame's datagram was here.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

from .plan import EXPECTED, FrameKind, number_of, plan

_MAX_DATAGRAM = 65535
_BUFFER_BYTES = 1 << 22
_WAIT_S = 0.2
_CAUTIOUS = frozenset({Reason.LATE, Reason.STALE, Reason.FROZEN})
"""Why a frame may be unknown where the machine, not the runtime, was held up."""
_NO_FRAME = frozenset({Reason.NO_FRAME, Reason.STALE, Reason.STALLED})


class Truth:
    """The datagrams heard, held against the truth.

    Parameters
    ----------
    frames : int
    silence_s : float
        Longest silence that is allowed.

    Attributes
    ----------
    found : Counter
        How often what happened.
    heard : array of float64, shape (frames,)
        `time.monotonic` at each frame's datagram; 0 where there was none.
    """

    def __init__(self, frames: int, silence_s: float) -> None:
        self.found: Counter[str] = Counter()
        self.heard = np.zeros(frames)
        self.longest_silence_s = 0.0
        self.worst: dict[str, Any] | None = None
        self._kinds = plan(frames)
        self._silence_s = silence_s
        self._seq = 0
        self._at: float | None = None
        self._same_as_v1 = True

    def hear(self, data: bytes, v1: bytes | None, now: float) -> None:
        """Take one datagram of v2.

        Parameters
        ----------
        data : bytes
        v1 : bytes or None
            The datagram of v1 that was sent just before, where this one has a status for it.
        now : float
            `time.monotonic` when it was here.
        """
        self.found["datagrams"] += 1
        if self._at is not None:
            silence_s = now - self._at
            self.longest_silence_s = max(self.longest_silence_s, silence_s)
            self.found["long_silences"] += silence_s > self._silence_s
        self._at = now
        try:
            said = decode(data)
        except ToktError:
            self.found["unreadable"] += 1
            return
        if said["seq"] != self._seq + 1:
            self.found["lost"] += max(said["seq"] - self._seq - 1, 1)
            self._same_as_v1 = False  # v1 has no number by which they could be paired again
        self._seq = said["seq"]
        if said["reason"] in _NO_FRAME and said["latency_ms"] is None:
            self.found["heartbeats"] += 1
            self.found["wrong_heartbeats"] += said["status"] != UNKNOWN
            return
        self._judge(said, now)
        self._compare(said, v1)

    def _judge(self, said: dict[str, Any], now: float) -> None:
        number = number_of(said["t"])
        if not 0 <= number < len(self.heard) or self.heard[number]:
            self.found["no_such_frame"] += 1
            return
        self.heard[number] = now
        kind = FrameKind(self._kinds[number])
        status, reason = EXPECTED[kind]
        self.found[f"of_{kind.name.lower()}"] += 1
        if (said["status"], said["reason"]) == (status, reason):
            return
        if said["status"] == CLEAR and status != CLEAR:
            what = "wrong_clear"
        elif said["status"] == OBSTACLE and status != OBSTACLE:
            what = "wrong_obstacle"
        elif said["status"] == UNKNOWN and said["reason"] in _CAUTIOUS:
            what = "cautious"
        else:
            what = "other"
        self.found[what] += 1
        self.worst = {**said, "kind": kind.name}

    def _compare(self, said: dict[str, Any], v1: bytes | None) -> None:
        if said["status"] == UNKNOWN or not self._same_as_v1:
            return
        self.found["compared_v1"] += 1
        if v1 is None:
            self.found["lost_v1"] += 1
            self._same_as_v1 = False
            return
        same = ("status", "x", "y")
        other = decode(v1)
        self.found["different_v1"] += any(other[name] != said[name] for name in same)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return {
            **self.found,
            "longest_silence_s": self.longest_silence_s,
            "last_seq": self._seq,
            "unlike_the_plan": self.worst,
        }


def dropped_by_the_system(opened: socket.socket) -> int | None:
    """Datagrams that came while the socket's buffer was full; None where it is not told."""
    table = Path("/proc/net/udp")
    if not table.is_file():
        return None
    inode = str(os.fstat(opened.fileno()).st_ino)
    for line in table.read_text().splitlines()[1:]:
        fields = line.split()
        if fields[9] == inode:
            return int(fields[-1])
    return None


def _udp() -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    opened.bind(("127.0.0.1", 0))
    return opened


def _waiting(opened: socket.socket) -> bytes | None:
    """A datagram that is there already."""
    try:
        return opened.recv(_MAX_DATAGRAM)
    except BlockingIOError:
        return None


def listen(truth: Truth, v1: socket.socket, v2: socket.socket, ended: threading.Event) -> None:
    """Hear datagrams until there are no more after the end."""
    v2.settimeout(_WAIT_S)
    v1.setblocking(False)
    while True:
        try:
            data = v2.recv(_MAX_DATAGRAM)
        except TimeoutError:
            if ended.is_set():
                return
            continue
        now = time.monotonic()
        known = b'"status":-1' not in data
        truth.hear(data, _waiting(v1) if known else None, now)


def main(arguments: Sequence[str]) -> None:
    """Run as the program."""
    folder, frames, silence_s = Path(arguments[0]), int(arguments[1]), float(arguments[2])
    truth, ended = Truth(frames, silence_s), threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.read()
        ended.set()

    with _udp() as v1, _udp() as v2:
        ports = {"v1": v1.getsockname()[1], "v2": v2.getsockname()[1]}
        print(json.dumps(ports), flush=True)
        threading.Thread(target=wait_for_the_end, daemon=True).start()
        listen(truth, v1, v2, ended)
        dropped = {"v1": dropped_by_the_system(v1), "v2": dropped_by_the_system(v2)}
    np.savez(folder / "heard.npz", heard=truth.heard)
    print(json.dumps({**truth.to_json(), "dropped_by_the_system": dropped}))


if __name__ == "__main__":
    main(sys.argv[1:])
