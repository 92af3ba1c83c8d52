"""Access units: what RTP packets carry of one coded picture, and whether all of it is there.

H.264 by RFC 6184 (single units, STAP-A, FU-A), H.265 by RFC 7798 (single units, AP, FU).
"""

import re
from dataclasses import dataclass, replace

from .rtp import RtpPacket

_START = re.compile(rb"\0{2,}\x01")
_MAX_BYTES = 16 << 20  # of one picture: more is none


@dataclass(frozen=True)
class AccessUnit:
    """One coded picture."""

    units: tuple[bytes, ...]  # NAL units, without start codes
    timestamp: int  # the sender's, of `rtp.RTP_HZ`
    arrived: float  # when its last packet came: `Clock.monotonic`, in seconds
    key: bool  # whether it and what follows can be decoded without any other
    fault: str = ""  # what of it is not there, in words; empty where all is

    @property
    def data(self) -> bytes:
        """As decoders take it (Annex B of the standards)."""
        return b"".join(b"\0\0\0\1" + unit for unit in self.units)


def nal_units(data: bytes) -> list[bytes]:
    """The NAL units in a byte stream with start codes (Annex B)."""
    return [unit for unit in _START.split(data)[1:] if unit]


@dataclass(frozen=True)
class Codec:
    """The types of a codec's NAL units, and of their packets in RTP."""

    name: str  # as FFmpeg calls its decoder
    header: int  # bytes of a NAL unit's header; the bit after it: is a slice its picture's first
    aggregate: int  # type of the packets that hold several units; lower ones are units
    fragment: int  # of those that hold a part of one
    pictures: range  # of slices
    keys: range  # of those from which decoding can begin
    sets: range  # of parameter sets, without which no picture can be decoded

    def type_of(self, unit: bytes) -> int:
        """The type of a NAL unit or a packet."""
        return unit[0] & 31 if self.header == 1 else unit[0] >> 1 & 63

    def whole(self, fragment: bytes) -> bytes:
        """The header of the unit that a fragment is of."""
        if self.header == 1:
            return bytes([fragment[0] & 0xE0 | fragment[1] & 31])
        return bytes([fragment[0] & 0x81 | (fragment[2] & 63) << 1, fragment[1]])

    def is_picture(self, unit: bytes) -> bool:
        """Whether it is a slice of a picture."""
        return self.type_of(unit) in self.pictures

    def is_set(self, unit: bytes) -> bool:
        """Whether it is a parameter set."""
        return self.type_of(unit) in self.sets

    def is_first(self, unit: bytes) -> bool:
        """Whether a slice is its picture's first."""
        return bool(unit[self.header] & 0x80)


CODECS = {
    "h264": Codec("h264", 1, 24, 28, range(1, 6), range(5, 6), range(7, 9)),
    "h265": Codec("hevc", 2, 48, 49, range(32), range(16, 24), range(32, 35)),
}
"""By the names that addresses and SDP have for them, in lower case: table 7-1 of either standard,
RFC 6184 and RFC 7798."""


def access_unit(
    codec: Codec, units: list[bytes], timestamp: int, arrived: float, fault: str = ""
) -> AccessUnit:
    """The access unit of some NAL units."""
    slices = [codec.type_of(unit) for unit in units if codec.is_picture(unit)]
    key = bool(slices) and all(kind in codec.keys for kind in slices)
    return AccessUnit(tuple(units), timestamp, arrived, key, fault)


class Depacketizer:
    """Put the access units of one sender together.

    ::

        packets   ..A A A*  B B . B*  C C* ..     . is lost, * has the marker
        units       A       B fault   C           C refers to B: that is the decoder's to tell

    A marker is believed to end a picture once a whole one ended with one: some senders mark each
    slice. Until then, and of these always, the next time stamp ends it.
    """

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._timestamp: int | None = None  # of the unit that is being put together
        self._units: list[bytes] = []
        self._part: bytearray | None = None
        self._arrived = 0.0
        self._size = 0
        self._fault = ""
        self._gap = False  # before the first packet of the unit
        self._sets: set[int] = set()  # types of parameter sets that the sender sends
        self._told: int | None = None
        self._marked = False  # the packet before, in which a slice ended
        self._marks: bool | None = None  # whether markers end pictures, where that is known

    def add(self, packet: RtpPacket, lost: bool) -> list[AccessUnit]:
        """Take the next packet, and whether some before it are lost; what is complete by it."""
        done = []
        if self._timestamp is not None and packet.timestamp != self._timestamp:
            # The one that marks its end is lost, or its sender's marks mean nothing.
            done.append(self._closed("its end is lost" if lost else ""))
        if self._timestamp is None:
            self._timestamp, self._gap = packet.timestamp, lost
        elif lost:
            self._fault = "packets of it are lost"
        elif self._marked:
            self._marks = False
        self._arrived = packet.arrived
        self._size += len(packet.payload)
        if self._size > _MAX_BYTES:
            self._fault, self._units, self._part = "it has no end", [], None
        else:
            self._take(packet.payload)
        self._marked = packet.marker and any(map(self._codec.is_picture, self._units))
        if packet.marker and self._marks:
            done.append(self._closed(""))
        return done

    def _closed(self, fault: str) -> AccessUnit:
        """The unit that was put together, and begin anew."""
        assert self._timestamp is not None
        self._finish_part()
        codec, fault = self._codec, self._fault or fault
        unit = access_unit(codec, self._units, self._timestamp, self._arrived)
        sets = {codec.type_of(each) for each in self._units if codec.is_set(each)}
        first = next(filter(codec.is_picture, self._units), None)
        begins = first is not None and codec.is_first(first)
        # After a gap a key picture's first slice says that it has its beginning, and so do the
        # parameter sets where the sender sends some. Any other picture refers to what is lost.
        if self._gap and not (unit.key and begins and self._sets <= sets):
            fault = fault or "its beginning is lost"
        elif first is not None and not begins and self._told == self._timestamp:
            self._marks, fault = False, fault or "it came in several pieces"
        elif self._marks is None and first is not None and not fault:
            self._marks = self._marked
        self._sets |= sets
        self._told = self._told if first is None else self._timestamp
        self._timestamp, self._units, self._fault, self._size = None, [], "", 0
        return replace(unit, fault=fault)

    def _take(self, payload: bytes) -> None:
        """The NAL units that a packet holds, or its part of one."""
        codec = self._codec
        kind = codec.type_of(payload)
        if len(payload) <= codec.header + (kind == codec.fragment):
            self._fault = "it holds an empty packet"
            return
        if kind == codec.fragment:
            self._take_part(payload)
            return
        self._finish_part()
        if kind == codec.aggregate:
            self._take_several(payload[codec.header :])
        elif kind < codec.aggregate:
            self._units.append(payload)
        else:
            self._fault = f"it holds a packet of unknown type {kind}"

    def _take_part(self, payload: bytes) -> None:
        """A fragment of a unit: the first one begins it, the last one ends it."""
        codec = self._codec
        flags = payload[codec.header]
        if flags & 0x80:
            self._finish_part()
            self._part = bytearray(codec.whole(payload))
        if self._part is None:
            self._fault = self._fault or "the beginning of a part is lost"
            return
        self._part += payload[codec.header + 1 :]
        if flags & 0x40:
            self._units.append(bytes(self._part))
            self._part = None

    def _take_several(self, payload: bytes) -> None:
        """The units of an aggregate, each with its size in front."""
        while payload:
            size = int.from_bytes(payload[:2], "big")
            unit, payload = payload[2 : 2 + size], payload[2 + size :]
            if len(unit) < size or size <= self._codec.header:
                self._fault = "it holds a packet of which a part is missing"
                return
            self._units.append(unit)

    def _finish_part(self) -> None:
        """What is open has no end any more."""
        if self._part is not None:
            self._fault = self._fault or "the end of a part is lost"
            self._part = None
