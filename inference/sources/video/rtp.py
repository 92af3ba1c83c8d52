"""RTP: datagrams in their order, what of them is lost, and the sender's clock (RFC 3550)."""

import math
import struct
from collections import OrderedDict
from dataclasses import dataclass

from .newest import StreamLostError

RTP_HZ = 90_000
"""Ticks a second of video's time stamps."""

_REORDER_S = 0.05  # that a missing packet is waited for while later ones are there already
_SILENT_S = 0.5  # of silence, after which another sender is believed to have taken over
_MAX_AHEAD = 1024  # packets that wait for a missing one
_MAX_JUMP = 3000  # RFC 3550, A.1: beyond it the sender may have begun anew
_MAX_CANDIDATES, _MAX_HELD = 8, 1024
_NTP_1970 = 2_208_988_800
_SENDER_REPORT = 200
_LATE_S, _LATE_FOR_S, _SHORTER_S = 0.5, 1.0, 0.1
_DRIFT = 600e-6  # of two clocks: as in `tokt.inference.sources.cameras.pairing`


@dataclass(frozen=True)
class RtpPacket:
    """One packet, and when it came: `Clock.monotonic`, in seconds."""

    ssrc: int
    sequence: int
    timestamp: int
    payload_type: int
    marker: bool
    payload: bytes
    arrived: float


def parse_rtp(data: bytes, arrived: float) -> RtpPacket | None:
    """Read a datagram as RTP (section 5.1); None of what is none, or carries nothing."""
    if len(data) < 12 or data[0] >> 6 != 2:
        return None
    second, sequence, timestamp, ssrc = struct.unpack_from("!xBHII", data)
    start, end = 12 + 4 * (data[0] & 15), len(data)
    if data[0] & 16:  # an extension
        if end < start + 4:
            return None
        start += 4 + 4 * int.from_bytes(data[start + 2 : start + 4], "big")
    if data[0] & 32:  # padding, whose last byte is its length
        if not data[-1]:
            return None
        end -= data[-1]
    if start >= end:
        return None
    payload_type, marker = second & 127, bool(second & 128)
    return RtpPacket(ssrc, sequence, timestamp, payload_type, marker, data[start:end], arrived)


def is_rtcp(data: bytes) -> bool:
    """Whether a datagram is RTCP, where both come to one port (RFC 5761, section 4)."""
    return len(data) >= 8 and data[0] >> 6 == 2 and 192 <= data[1] <= 223


def parse_sender_report(data: bytes) -> tuple[int, float, int] | None:
    """Read the sender report that a compound RTCP packet begins with; None of any other.

    It is the sender's SSRC, and its time of day (seconds since 1970 by its own clock) at one of its
    time stamps (section 6.4.1).
    """
    if len(data) < 28 or data[0] >> 6 != 2 or data[1] != _SENDER_REPORT:
        return None
    ssrc, seconds, fraction, timestamp = struct.unpack_from("!4xIIII", data)
    # A sender that does not know the time of day says 0, or counts from its own start.
    if seconds < _NTP_1970:
        return None
    return ssrc, seconds - _NTP_1970 + fraction / 2**32, timestamp


class PacketOrder:
    """The packets of one sender in their order, and where some are lost.

    A sender is known by its SSRC. Another one, or one whose numbers begin anew, is believed once
    two of its packets follow each other and the one before has fallen silent; what it sent since
    then is not lost. A packet that comes twice, or after its place was given up, is left out, as
    are those of other payload types than the wanted one, by default the sender's first.
    """

    def __init__(self, payload_type: int | None = None) -> None:
        self._wanted = payload_type
        self._sender: tuple[int, int] | None = None  # SSRC, payload type
        self._next = 0
        self._heard = -math.inf
        self._ahead: dict[int, RtpPacket] = {}
        self._candidates: OrderedDict[tuple[int, int], list[RtpPacket]] = OrderedDict()

    def add(self, packet: RtpPacket) -> list[tuple[RtpPacket, bool]]:
        """Take a packet; what is in order now, each with whether some before it are lost."""
        if self._wanted not in (None, packet.payload_type):
            return []
        ahead = _signed(packet.sequence - self._next, 16)
        sender = packet.ssrc, packet.payload_type
        if self._sender != sender or not 0 <= ahead < _MAX_JUMP:
            return self._try(packet)
        self._heard = packet.arrived
        self._ahead.setdefault(packet.sequence, packet)
        return self._run() if len(self._ahead) <= _MAX_AHEAD else self._skip()

    def due(self) -> float:
        """When `expired` is to be asked: `Clock.monotonic`; infinite if nothing is missing."""
        first = min((each.arrived for each in self._ahead.values()), default=math.inf)
        return first + _REORDER_S

    def expired(self, now: float) -> list[tuple[RtpPacket, bool]]:
        """Give up what is missing for too long; what is in order by that."""
        return self._skip() if self._ahead and now >= self.due() else []

    def _run(self) -> list[tuple[RtpPacket, bool]]:
        """Those that follow without a gap."""
        run = []
        while (packet := self._ahead.pop(self._next, None)) is not None:
            run.append((packet, False))
            self._next = (self._next + 1) & 0xFFFF
        return run

    def _skip(self) -> list[tuple[RtpPacket, bool]]:
        """Go on after the gap."""
        self._next = min(self._ahead, key=lambda number: _signed(number - self._next, 16))
        (first, _), *rest = self._run()
        return [(first, True), *rest]

    def _try(self, packet: RtpPacket) -> list[tuple[RtpPacket, bool]]:
        """Keep a packet of who may be the next sender, and go over to that one when it is."""
        sender = packet.ssrc, packet.payload_type
        since, before = self._heard - _REORDER_S, (packet.sequence - 1) & 0xFFFF
        held = [each for each in self._candidates.pop(sender, []) if each.arrived > since]
        self._candidates[sender] = held = [*held[1 - _MAX_HELD :], packet]
        if len(self._candidates) > _MAX_CANDIDATES:
            self._candidates.popitem(last=False)
        follows = any(each.sequence == before for each in held)
        if not follows or packet.arrived - self._heard < _SILENT_S:
            return []
        del self._candidates[sender]
        self._sender = sender
        near = [one for one in held if abs(_signed(one.sequence - packet.sequence, 16)) < _MAX_JUMP]
        self._ahead = {one.sequence: one for one in near}
        self._next, self._heard = packet.sequence, packet.arrived
        return self._skip()


def _signed(number: int, bits: int) -> int:
    """The least difference that a counter of so many bits can mean."""
    half = 1 << (bits - 1)
    return (number + half) % (2 * half) - half


class SenderClock:
    """A sender's time stamps in seconds, by its own clock and as time of day.

    Time stamps have 32 bits: they begin anew each 13 hours, which is followed. Time of day is told
    by the last sender report, and does not drift.
    """

    def __init__(self) -> None:
        self._ticks: int | None = None
        self._report: tuple[int, float] | None = None  # ticks, seconds since 1970

    def report(self, utc: float, timestamp: int) -> None:
        """Learn the time of day."""
        self._report = self._unwrapped(timestamp), utc

    def seconds(self, timestamp: int) -> float:
        """When something was taken, by the sender's clock, of any zero."""
        self._ticks = self._unwrapped(timestamp)
        return self._ticks / RTP_HZ

    def utc(self, timestamp: int) -> float | None:
        """The same in seconds since 1970; None while the sender has not told."""
        if self._report is None:
            return None
        ticks, utc = self._report
        return utc + (self._unwrapped(timestamp) - ticks) / RTP_HZ

    def _unwrapped(self, timestamp: int) -> int:
        if self._ticks is None:
            return timestamp
        return self._ticks + _signed(timestamp - self._ticks, 32)


class Delay:
    """When a picture would have come had nothing held it up: the age of those that queued.

    The least of what was seen of ``arrived - taken`` is the way's own delay. A picture that comes
    later than that was waiting somewhere, and is as much older. The least rises as fast as two
    clocks can drift apart, and no faster. A queue that does not get shorter, or a sender whose
    clock stood still, only a new session gets rid of.
    """

    def __init__(self) -> None:
        self._least = math.inf
        self._last = 0.0, -math.inf  # arrived, taken
        self._held = 0.0, math.inf  # since when, and how much at least

    def undelayed(self, taken_s: float, arrived: float) -> float:
        """The earliest time at which it can have come; both as `Clock.monotonic`, in seconds.

        StreamLostError if pictures come late, and do not come any earlier.
        """
        last_arrived, last_taken = self._last
        if taken_s < last_taken - 1.0:  # the sender's clock was set back
            self._least = math.inf
        elif math.isfinite(self._least):
            self._least += _DRIFT * max(0.0, arrived - last_arrived)
        self._last = arrived, taken_s
        self._least = min(self._least, arrived - taken_s)
        delay_s, (since, held_s) = arrived - taken_s - self._least, self._held
        if delay_s < _LATE_S:
            self._held = 0.0, math.inf
        elif delay_s < held_s - _SHORTER_S:
            self._held = arrived, delay_s
        elif arrived - since > _LATE_FOR_S:
            raise StreamLostError(f"its pictures come {delay_s:.1f} s late")
        return taken_s + self._least
