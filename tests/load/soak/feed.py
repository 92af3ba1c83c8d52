"""The other end of a soaked run: frames into its stream, and each datagram held against the truth.

The next frame is sent once the datagram of the one before is here, so that nothing waits anywhere
and a frame's way takes as long as the runtime does. Where the runtime dies, the frame that was on
its way is lost, and the next one goes to the next runtime.
"""

import select
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError
from tokt.inference.outputs.udp import decode
from tokt.inference.reason import Reason
from tokt.inference.sources.stream import encode_frame
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

from .plan import CALM, EXPECTED, FrameKind, number_of, time_of
from .standstill import Interval
from .synthetic_frames import dark, near, water

LOST_S = 60.0  # a datagram that is not here by then does not come, however busy the machine is
KEPT_SILENCE_S = 0.1  # silences that are longer are kept
_POLL_S = 0.05
_MAX_DATAGRAM = 65535
_CONNECT_S = 60.0
_SAME = ("status", "x", "y")
_HEARTBEAT, _UNKNOWN = b'"latency_ms":null', b'"status":-1'
_V1_S = 0.5  # that v1 may come after v2
_CALM_FRAMES = 30  # that no repeated picture is among, where the runtime is to begin anew

Verdict = tuple[int, str]
"""Status and reason."""
Strike = Callable[[socket.socket, bytes], None]
"""Sends the bytes of a frame in its own way, and does something to the runtime."""


@dataclass(frozen=True)
class AlteredFrame:
    """A frame that is given in place of the planned one."""

    picture: U8 | None
    verdicts: frozenset[Verdict]  # of which it gets one


@dataclass
class Heard:
    """The datagrams of some time, for who waits for one."""

    healths: set[str] = field(default_factory=set)
    models: set[str] = field(default_factory=set)
    heartbeats: int = 0
    starts: int = 0  # of a runtime, whose first datagram has number 1


_NO_FRAME = (UNKNOWN, Reason.NO_FRAME)
"""Status and reason of a heartbeat, between a start and the first frame that is judged."""


def receiver(port: int = 0) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", port))
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

    def __init__(self, kinds: U8, altered: Mapping[int, AlteredFrame] | None = None) -> None:
        self.found: Counter[str] = Counter()  # how often what happened
        self.worst: dict[str, Any] | None = None  # the last one that was not as the plan has it
        self.recent = Heard()  # since somebody put another one in its place
        self.model, self.health = "", ""  # of the newest frame that was judged as it should be
        self._kinds, self._altered = kinds, altered or {}
        self._seq = 0
        self.of_altered: dict[int, Verdict] = {}  # by the frame's number
        self._waits = True  # the newest runtime has judged no frame

    def hear(self, number: int | None, data: bytes, v1: bytes | None) -> float | None:
        """Take the datagram that should be of a frame, and that of v1 sent just before, if one was.

        It gives the frame's age in it, ms; None where it is of no such frame.
        """
        self.found["datagrams"] += 1
        try:
            said = decode(data)
        except ToktError:
            self.found["unreadable"] += 1
            return None
        self.recent.healths.add(said["health"])
        if said["seq"] == 1:  # another runtime
            self._waits, self._seq = True, 0
            self.found["starts"] += 1
            self.recent.starts += 1
        self.found["lost"] += max(said["seq"] - self._seq - 1, 0)
        in_order, self._seq = said["seq"] > self._seq, said["seq"]
        if in_order and self._waits and (said["status"], said["reason"]) == _NO_FRAME:
            self.found["heartbeats"] += 1
            self.recent.heartbeats += 1
            return None
        if not in_order or said["t"] is None or number_of(said["t"]) != number:
            self.found["no_such_frame"] += 1
            return None
        self._waits = False
        self._judge(said, number)
        self._compare(said, v1)
        return float(said["age_ms"])

    def _judge(self, said: dict[str, Any], number: int) -> None:
        kind, altered = FrameKind(self._kinds[number]), self._altered.get(number)
        expected = {EXPECTED[kind]} if altered is None else altered.verdicts
        verdict = said["status"], said["reason"]
        name = kind.name.lower() if altered is None else "altered"
        self.found[f"of_{name}"] += 1
        if altered is not None:
            self.of_altered[number] = verdict
        if said["model"] is not None:
            self.recent.models.add(said["model"])
        if verdict in expected:
            if kind is FrameKind.WATER and altered is None:
                self.model, self.health = said["model"], said["health"]
            return
        statuses = {status for status, _ in expected}
        wrong = {CLEAR: "wrong_clear", OBSTACLE: "wrong_obstacle"}
        wrong = {} if said["status"] in statuses else wrong
        # Frozen, where the machine, not the runtime, was held up.
        other = "cautious" if said["reason"] == Reason.FROZEN else "other"
        self.found[wrong.get(said["status"], other)] += 1
        self.worst = {**said, "kind": name}

    def _compare(self, said: dict[str, Any], v1: bytes | None) -> None:
        if said["status"] == UNKNOWN:
            self.found["different_v1"] += v1 is not None
            return
        self.found["compared_v1"] += 1
        if v1 is None:  # a receiver that takes long to open, on a busy machine, joins later
            self.found["without_v1" if "--udp" in said["health"] else "lost_v1"] += 1
            return
        other = decode(v1)
        self.found["different_v1"] += any(other[name] != said[name] for name in _SAME)


def pictures(kinds: U8, altered: Mapping[int, AlteredFrame] | None = None) -> Iterator[U8 | None]:
    draw: dict[FrameKind, Callable[[int], U8 | None]] = {
        FrameKind.WATER: water,
        FrameKind.NEAR: near,
        FrameKind.DARK: dark,
        FrameKind.MISSING: lambda number: None,
    }
    picture = None
    for number, code in enumerate(kinds):
        kind = FrameKind(code)
        if altered and number in altered:
            picture = altered[number].picture
        elif kind not in (FrameKind.SAME, FrameKind.FROZEN):
            picture = draw[kind](number)
        yield picture


class Feeder:
    """Sends frames and hears what is said of them.

    `address` is the stream's, `receivers` those of v1 and v2, as `tokt run` names them. The frame
    given last has `number`. `silences` are those of the runtime alone: what this side takes for
    itself before it sends a frame is left out.
    """

    def __init__(self, kinds: U8, altered: Mapping[int, AlteredFrame] | None = None) -> None:
        self.truth = Truth(kinds, altered)
        self.number = -1
        self.silences: list[Interval] = []
        # From a frame sent to its datagram here, the age that it says, and when it was here; 0
        # where there was none.
        self.round_trip_s, self.age_s, self.heard_s = np.zeros((3, len(kinds)))
        self._kinds, self._altered = kinds, altered or {}
        self._v1, self._v2 = receiver(), receiver()
        self._strike: tuple[int, Strike] | None = None
        self._connection: socket.socket | None = None
        self._quiet_from = time.monotonic()
        self._server: socket.socket | None = None
        self._port = 0
        self.listen()
        self.address = f"stream:127.0.0.1:{self._port}"
        sockets = {"v1": self._v1, "v2": self._v2}
        self.receivers = tuple(
            f"{version}@127.0.0.1:{opened.getsockname()[1]}" for version, opened in sockets.items()
        )

    def listen(self) -> None:
        """Be there for a runtime that connects."""
        self._server = socket.create_server(("127.0.0.1", self._port))
        self._port = self._server.getsockname()[1]

    def be_away(self) -> None:
        """Be there for no new runtime, until `listen`."""
        server, self._server = self._server, None
        if server is not None:
            server.close()

    def arm(self, strike: Strike, at_most: int) -> None:
        """Let a strike send a frame: the next first one of an obstacle, or after some frames."""
        self._strike = self.number + at_most, strike

    @property
    def is_armed(self) -> bool:
        """True while a strike waits for its frame, or that frame for its datagram."""
        return self._strike is not None

    def close(self) -> None:
        self.be_away()
        for opened in (self._v1, self._v2, self._connection):
            if opened is not None:
                opened.close()

    def run(self, rest: Callable[[int, FrameKind], None]) -> None:
        """Send all frames and end the stream; `rest` before each, given its number and kind."""
        self._connect()
        self._quiet_from = time.monotonic()
        drawn = pictures(self._kinds, self._altered)
        for number, code in enumerate(self._kinds):
            began = time.monotonic()
            rest(number, FrameKind(code))
            frame = encode_frame(number, time_of(number), next(drawn), None)
            self._quiet_from += time.monotonic() - began
            self._give(number, frame)
        if self._connection is not None:
            self._connection.close()

    def _connect(self) -> None:
        """Wait for a runtime, and hear it say that it has no frame."""
        until = time.monotonic() + _CONNECT_S
        while time.monotonic() < until:
            sockets = [each for each in (self._server, self._v2) if each is not None]
            for ready in select.select(sockets, [], [], _POLL_S)[0]:
                if ready is self._v2:
                    self._take(None, self._v2.recv(_MAX_DATAGRAM))
                    until = time.monotonic() + _CONNECT_S
                    continue
                self._connection, _ = ready.accept()
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return
        raise ToktError(f"no runtime asks for frames for {_CONNECT_S:g} s")

    def _give(self, number: int, frame: bytes) -> None:
        if self._connection is None:
            self._connect()
        assert self._connection is not None
        send: Strike = socket.socket.sendall
        if self._strike is not None and self._is_time(number, self._strike[0]):
            send = self._strike[1]
        sent = time.monotonic()
        with suppress(OSError):  # it has died, which is seen as its datagram is waited for
            send(self._connection, frame)
        self.number = number
        self._hear(number, sent)
        if send is not socket.socket.sendall:
            self._strike = None

    def _is_time(self, number: int, at_most: int) -> bool:
        coming = slice(number, number + _CALM_FRAMES)
        if not np.isin(self._kinds[coming], CALM).all() or any(
            each in self._altered for each in range(*coming.indices(len(self._kinds)))
        ):
            return False
        begins = self._kinds[number] == FrameKind.NEAR != self._kinds[number - 1]
        return bool(begins) or number >= at_most

    def _hear(self, number: int, sent: float) -> None:
        """Wait for a frame's datagram; one that is lost is missed by the next one's number."""
        until = sent + LOST_S
        while time.monotonic() < until:
            data = datagram(self._v2, _POLL_S)
            if data is None and self._is_cut():
                data = datagram(self._v2, 0)  # what it said last
                if data is None:
                    self._lose()
                    return
            if data is None:
                continue
            until = time.monotonic() + LOST_S
            age_ms = self._take(number, data)
            if age_ms is not None:
                self.heard_s[number] = self._quiet_from
                self.round_trip_s[number] = self._quiet_from - sent
                self.age_s[number] = age_ms / 1000
                return

    def _take(self, number: int | None, data: bytes) -> float | None:
        here = time.monotonic()
        if here - self._quiet_from > KEPT_SILENCE_S:
            self.silences.append((self._quiet_from, here))
        self._quiet_from = here
        # v1 is there before, unless its receiver has joined the run later. What it has with a
        # heartbeat may be of the frame that is judged just after that.
        wait_s = 0.0 if _UNKNOWN in data else _V1_S
        v1 = None if _HEARTBEAT in data else datagram(self._v1, wait_s)
        return self.truth.hear(number, data, v1)

    def _is_cut(self) -> bool:
        """Return True if the runtime has gone."""
        assert self._connection is not None
        try:
            return not self._connection.recv(1, socket.MSG_DONTWAIT | socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def _lose(self) -> None:
        assert self._connection is not None
        self._connection.close()
        self._connection = None
        while datagram(self._v1, 0) is not None:
            self.truth.found["v1_alone"] += 1  # v1 goes out first
        self.truth.found["lost_on_the_way"] += 1
