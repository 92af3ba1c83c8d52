"""Receive datagrams and see what is missing: what ``tokt listen`` shows.

Two things are told besides the datagrams themselves: how many of a sender's are lost, by the gaps
in v2's `seq`, and that nothing has come for so long that a receiver has to take it for unknown.
"""

import ipaddress
import json
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from tokt.features.common.address import resolve
from tokt.features.common.errors import ToktError, os_errors_as, printable
from tokt.inference.clock import Clock
from tokt.inference.verdict import STATUS_WORDS

from .udp import decode

DEFAULT_TIMEOUT_S = 1.0
"""Seconds of silence that people are told of: some frames of the slowest usual camera."""
_MAX_DATAGRAM = 65535
_STOP_CHECK_S = 0.2

RESTART_BEHIND = 1000
"""A number that is so far behind the last is of another run, whose first ones are lost; one less
far behind was overtaken on its way."""
MAX_SENDERS = 256
"""Senders that are kept in mind; of more, the one that was heard longest ago is forgotten."""


@dataclass(frozen=True)
class ReceivedDatagram:
    """A datagram that came, and what its number and time tell of its sender."""

    sender: str  # ``ADDRESS:PORT``
    fields: dict[str, Any]  # `decode`'s; ``error`` and ``bytes`` of what is no datagram of tokt's
    lost: int | None = None  # sent before it and missing; None where they are not numbered (v1)
    restarted: bool = False  # whether the sender began to count anew
    overtaken: bool = False  # came after one sent later, or twice: what it says is old
    after_s: float | None = None  # seconds of silence that it ends, where that silence was told


@dataclass(frozen=True)
class Silence:
    """Nothing came for longer than the time-out."""

    sender: str | None  # from whom; None while there has been no sender at all
    seconds: float


@dataclass
class _Sender:
    """What is known of one sender."""

    heard: float
    seq: int | None = None
    silent: bool = False


class SenderMonitor:
    """Keep an account of each sender's numbers and silences.

    Times are seconds of a clock that never steps back. A silence is told after `timeout_s`, never
    without one. `lost` datagrams are missing, over all senders.
    """

    def __init__(self, now: float, timeout_s: float | None) -> None:
        self.lost = 0
        self._timeout_s = timeout_s
        # Silence before anybody was heard is told, too: most often the address is wrong.
        self._senders: dict[str | None, _Sender] = {None: _Sender(now)}

    def heard(self, sender: str, data: bytes, now: float) -> ReceivedDatagram:
        """Take a datagram in."""
        self._senders.pop(None, None)
        known = self._senders.pop(sender, _Sender(now))
        after_s = now - known.heard if known.silent else None
        # Put in anew: the first of them is always the one heard longest ago.
        self._senders[sender] = kept = _Sender(now, known.seq)
        if len(self._senders) > MAX_SENDERS:
            del self._senders[next(iter(self._senders))]
        try:
            fields = decode(data)
        except ToktError as error:
            fields = {"error": str(error), "bytes": len(data)}
        heard = ReceivedDatagram(sender, fields, after_s=after_s)
        return self._numbered(kept, heard) if "seq" in fields else heard

    def _numbered(self, kept: _Sender, heard: ReceivedDatagram) -> ReceivedDatagram:
        """The same with what its number tells."""
        seq, last = heard.fields["seq"], kept.seq
        restarted = last is not None and seq <= last and (seq == 1 or last - seq >= RESTART_BEHIND)
        overtaken = last is not None and seq <= last and not restarted
        lost = 0 if last is None else max(seq - 1 - (0 if restarted else last), 0)
        if not overtaken:
            kept.seq = seq
        self.lost += lost
        return replace(heard, lost=lost, restarted=restarted, overtaken=overtaken)

    def silences(self, now: float) -> list[Silence]:
        """Who has been silent for longer than the time-out; each silence is told once."""
        if self._timeout_s is None:
            return []
        found = []
        for name, sender in self._senders.items():
            if not sender.silent and now - sender.heard >= self._timeout_s:
                sender.silent = True
                found.append(Silence(name, now - sender.heard))
        return found


def listen(
    host: str,
    port: int,
    watch: SenderMonitor,
    clock: Clock,
    stopped: Callable[[], bool],
    ready: Callable[[], None],
) -> Iterator[ReceivedDatagram | Silence]:
    """Yield what comes, and when nothing does, until `stopped` says so.

    It is asked every 0.2 s, and after each datagram. `ready` is called once the port is open, so
    that nothing sent after it is missed. Raises ToktError if the host is not known or a group's
    address, or the port cannot be opened.
    """
    family, address = resolve(host, port)
    if ipaddress.ip_address(address[0]).is_multicast:
        raise ToktError(f"{host} is a multicast group, which tokt listen does not join")
    with socket.socket(family, socket.SOCK_DGRAM) as receiver:
        with os_errors_as(f"cannot listen on {host}:{port}"):
            receiver.bind(address)
        receiver.settimeout(_STOP_CHECK_S)
        ready()
        while not stopped():
            yield from watch.silences(clock.monotonic())
            try:
                data, sender = receiver.recvfrom(_MAX_DATAGRAM)
            except (TimeoutError, ConnectionResetError):
                continue  # the latter: Windows reports another socket's ICMP answer here
            yield watch.heard(f"{sender[0]}:{sender[1]}", data, clock.monotonic())


def as_json(event: ReceivedDatagram | Silence) -> str:
    """One line for programs."""
    if isinstance(event, Silence):
        told: dict[str, Any] = {"from": event.sender, "silent_s": round(event.seconds, 3)}
    else:
        told = {"from": event.sender, **event.fields}
        if event.lost is not None:
            told |= {"lost": event.lost, "restarted": event.restarted, "overtaken": event.overtaken}
    return json.dumps(told, allow_nan=False)


def as_words(event: ReceivedDatagram | Silence) -> str:
    """One line for people; what came over the network cannot move the cursor."""
    if isinstance(event, Silence):
        sender = event.sender or "nobody yet"
        return f"{sender}  silent for {event.seconds:.1f} s: take it for unknown"
    fields = event.fields
    if "error" in fields:
        words = [f"{fields['error']} ({fields['bytes']} bytes)"]
    else:
        told = {name: value for name, value in fields.items() if value is not None}
        words = [f"v{told.pop('v')}", STATUS_WORDS[told.pop("status")]]
        words += [f"{name}={value}" for name, value in told.items()]
    words += ["[counts anew]"] if event.restarted else []
    words += ["[overtaken: old]"] if event.overtaken else []
    words += [f"[{event.lost} lost before it]"] if event.lost else []
    words += [f"[after {event.after_s:.1f} s of silence]"] if event.after_s is not None else []
    return printable("  ".join([event.sender, *words]))
