"""Networks that lose, reorder, repeat and invent datagrams, the same way each time."""

import random
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace

from .packets import SSRC, Packet, sender_report

GARBAGE = (
    "random bytes",
    "empty",
    "one byte",
    "header alone",
    "other version",
    "other source",
    "other payload type",
    "cut short",
    "report",
    "report garbage",
    "extension too long",
    "padding too long",
    "fragment of nothing",
    "aggregate too long",
)
"""Kinds of datagrams that are no packets of the stream."""


@dataclass
class Network:
    """What becomes of each datagram; one object for one way.

    Parameters
    ----------
    seed : int
    loss : float
        Share of datagrams that are lost.
    burst : float
        Datagrams lost at a time, on average; 1 loses each by itself.
    reorder, duplicate, garbage : float
        Share of datagrams that come later, twice, or with a datagram of no stream in front.
    reorder_by : int
        Datagrams that overtake, at most.
    kinds : tuple of str
        Of `GARBAGE`.
    """

    seed: int = 0
    loss: float = 0.0
    burst: float = 1.0
    reorder: float = 0.0
    reorder_by: int = 3
    duplicate: float = 0.0
    garbage: float = 0.0
    kinds: tuple[str, ...] = GARBAGE

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._losing = False
        self._held: list[tuple[int, bytes]] = []

    def pass_on(self, datagram: bytes) -> list[bytes]:
        """What comes out where this one goes in."""
        out = [data for left, data in self._held if left <= 0]
        self._held = [(left - 1, data) for left, data in self._held if left > 0]
        draw = self._random.random
        if draw() < self.garbage:
            out.append(garbage(self._random, datagram, self._random.choice(self.kinds)))
        if self._loses():
            return out
        copies = 2 if draw() < self.duplicate else 1
        if draw() < self.reorder:
            self._held.append((self._random.randrange(self.reorder_by), datagram))
            copies -= 1
        return out + [datagram] * copies

    def _loses(self) -> bool:
        if not 0 < self.loss < 1:
            return self.loss >= 1
        # Gilbert's model: the share of the time that is spent losing is `loss`.
        leave = 1 / self.burst
        enter = leave * self.loss / (1 - self.loss)
        if self.burst <= 1:
            return self._random.random() < self.loss
        self._losing = self._random.random() < (1 - leave if self._losing else min(1.0, enter))
        return self._losing

    def over(self, capture: Iterable[Packet]) -> list[Packet]:
        """A capture as it comes out at the other end."""
        made = []
        for packet in capture:
            for data in self.pass_on(packet.data):
                number = packet.number if data is packet.data else None
                made.append(replace(packet, data=data, number=number))
        return made


def garbage(rng: random.Random, packet: bytes, kind: str) -> bytes:
    """A datagram that a reader must take for no packet of its stream, made like one of it."""
    head, body = bytearray(packet[:12].ljust(12, b"\0")), packet[12:]

    def headed(first: int | None = None, second: int | None = None, rest: bytes = body) -> bytes:
        head[0] = head[0] if first is None else first
        head[1] = head[1] if second is None else second
        return bytes(head) + rest

    near = struct.pack("!H", (int.from_bytes(head[2:4], "big") + rng.randrange(-9, 9)) % (1 << 16))
    makers = {
        "random bytes": lambda: rng.randbytes(rng.randrange(1, 1400)),
        "empty": lambda: b"",
        "one byte": lambda: b"\x80",
        "header alone": lambda: headed(rest=b""),
        "other version": lambda: headed(first=rng.choice((0x00, 0x40, 0xC0))),
        "other source": lambda: bytes(head[:8]) + rng.randbytes(4) + body,
        "other payload type": lambda: headed(second=rng.choice((0, 26, 33, 97, 127))),
        "cut short": lambda: packet[: rng.randrange(1, 12)],
        "report": lambda: sender_report(SSRC, 1.0, rng.randrange(1 << 32), 5, 5),
        "report garbage": lambda: bytes([0x81, rng.randrange(192, 224)]) + rng.randbytes(30),
        "extension too long": lambda: headed(first=0x90, rest=b"\xbe\xde\xff\xff" + body),
        "padding too long": lambda: headed(first=0xA0, rest=body[:40] + b"\xff"),
        "fragment of nothing": lambda: (
            bytes(head[:2]) + near + bytes(head[4:8]) + rng.randbytes(14)
        ),
        "aggregate too long": lambda: (
            bytes(head[:8]) + rng.randbytes(4) + b"\x78\xff\xff" + rng.randbytes(20)
        ),
    }
    return makers[kind]()


def cut(capture: list[Packet], first: int) -> list[Packet]:
    """What a reader hears that joins in the middle, at packet `first`."""
    return capture[first:]
