"""The other end of a soaked run: frames into its stream, and each datagram held against the truth.

The next frame is sent once the datagram of the one before is here, so that nothing waits anywhere
and a frame's way takes as long as the runtime does.
"""

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from typing import Any

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.sources.stream import encode_frame
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

from .plan import EXPECTED, FrameKind, number_of, time_of
from .synthetic_frames import dark, near, water

LOST_S = 60.0  # a datagram that is not here by then does not come, however busy the machine is
_MAX_DATAGRAM = 65535
_CONNECT_S = 60.0
_SAME = ("status", "x", "y")


def receiver() -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", 0))
    return opened


def datagram(opened: socket.socket, wait_s: float) -> bytes | None:
    """The next datagram; None where none comes in time."""
    opened.settimeout(wait_s)
    try:
        return opened.recv(_MAX_DATAGRAM)
    except (TimeoutError, BlockingIOError):
        return None


class Truth:
    """The datagrams heard, held against the truth, which is what `plan.plan` gives."""

    def __init__(self, kinds: U8) -> None:
        self.found: Counter[str] = Counter()  # how often what happened
        self.worst: dict[str, Any] | None = None  # the last one that was not as the plan has it
        self._kinds = kinds
        self._seq = 0

    def hear(self, number: int, data: bytes, v1: bytes | None) -> float | None:
        """Take the datagram that should be of a frame, and that of v1 sent just before, if one was.

        It gives the frame's age in it, ms; None where it is of no such frame.
        """
        self.found["datagrams"] += 1
        try:
            said = decode(data)
        except ToktError:
            self.found["unreadable"] += 1
            return None
        self.found["lost"] += max(said["seq"] - self._seq - 1, 0)
        in_order, self._seq = said["seq"] > self._seq, said["seq"]
        if not in_order or said["t"] is None or number_of(said["t"]) != number:
            self.found["no_such_frame"] += 1
            return None
        self._judge(said, FrameKind(self._kinds[number]))
        self._compare(said, v1)
        return float(said["age_ms"])

    def _judge(self, said: dict[str, Any], kind: FrameKind) -> None:
        status, reason = EXPECTED[kind]
        self.found[f"of_{kind.name.lower()}"] += 1
        if (said["status"], said["reason"]) == (status, reason):
            return
        wrong = (
            {CLEAR: "wrong_clear", OBSTACLE: "wrong_obstacle"} if said["status"] != status else {}
        )
        # Frozen, where the machine, not the runtime, was held up.
        other = "cautious" if said["reason"] == Reason.FROZEN else "other"
        self.found[wrong.get(said["status"], other)] += 1
        self.worst = {**said, "kind": kind.name}

    def _compare(self, said: dict[str, Any], v1: bytes | None) -> None:
        if said["status"] == UNKNOWN:
            self.found["different_v1"] += v1 is not None
            return
        self.found["compared_v1"] += 1
        if v1 is None:
            self.found["lost_v1"] += 1
            return
        other = decode(v1)
        self.found["different_v1"] += any(other[name] != said[name] for name in _SAME)


def pictures(kinds: Iterable[int]) -> Iterator[U8 | None]:
    draw: dict[FrameKind, Callable[[int], U8 | None]] = {
        FrameKind.WATER: water,
        FrameKind.NEAR: near,
        FrameKind.DARK: dark,
        FrameKind.MISSING: lambda number: None,
    }
    picture = None
    for number, code in enumerate(kinds):
        kind = FrameKind(code)
        if kind not in (FrameKind.SAME, FrameKind.FROZEN):
            picture = draw[kind](number)
        yield picture


class Feeder:
    """Sends frames and hears what is said of them.

    `address` is the stream's, `receivers` those of v1 and v2, as `tokt run` names them.
    """

    def __init__(self, kinds: U8) -> None:
        self.truth = Truth(kinds)
        # From a frame sent to its datagram here, and the age that it says; 0 where there was none.
        self.round_trip_s, self.age_s = np.zeros((2, len(kinds)))
        self._kinds = kinds
        self._v1, self._v2 = receiver(), receiver()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(_CONNECT_S)
        self.address = f"stream:127.0.0.1:{self._server.getsockname()[1]}"
        sockets = {"v1": self._v1, "v2": self._v2}
        self.receivers = tuple(
            f"{version}@127.0.0.1:{opened.getsockname()[1]}" for version, opened in sockets.items()
        )

    def close(self) -> None:
        for opened in (self._v1, self._v2, self._server):
            opened.close()

    def run(self, before: Callable[[int, FrameKind], None]) -> None:
        """Send all frames and end the stream; `before` each, its number and kind are told."""
        connection, _ = self._server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with closing(connection):
            for number, picture in enumerate(pictures(self._kinds)):
                before(number, FrameKind(self._kinds[number]))
                frame = encode_frame(number, time_of(number), picture, None)
                sent = time.monotonic()
                connection.sendall(frame)
                self._hear(number, sent)

    def _hear(self, number: int, sent: float) -> None:
        """Wait for a frame's datagram; one that is lost is missed by the next one's number."""
        while (data := datagram(self._v2, LOST_S)) is not None:
            here = time.monotonic()
            age_ms = self.truth.hear(number, data, datagram(self._v1, 0))
            if age_ms is not None:
                self.round_trip_s[number], self.age_s[number] = here - sent, age_ms / 1000
                return
