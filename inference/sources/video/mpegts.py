"""MPEG-TS over UDP: from datagrams to access units, and where something is missing (ISO 13818-1).

::

    datagrams     [t][t][t]..  t: 188 bytes of one PID, numbered 0 to 15 by that PID
    video's PID   ..a a|B b b b|C ..   capitals begin a PES packet: an access unit and its time

An access unit is whole at its PES packet's length, or where that is 0, as most senders write, when
the next one begins: a picture's period later. A PID's number that does not follow tells a loss.

That cannot tell a loss of 16, 32 .. packets of the video's PID and of none of another. A PES
packet's length does, pictures whose times leave a gap, and the system where this computer dropped
the datagrams. What is left is such a hole within one picture of unknown length: FFmpeg's decoder
lets one of 80 pass in H.264 and most in H.265. RTP has no such gap.
"""

import socket
import sys
import zlib
from collections import deque
from collections.abc import Iterator
from statistics import median

from tokt.inference.clock import SYSTEM_CLOCK

from .access_units import CODECS, AccessUnit, Codec, access_unit, nal_units
from .address import VideoAddress
from .decoder import VideoDecoder
from .newest import NewestReading, Reading, StreamLostError
from .rtp import Delay, SenderClock, parse_rtp
from .rtp_stream import listening_socket, timed_reading

PACKET = 188
_SYNC, _NULL_PID, _PAT_PID = 0x47, 0x1FFF, 0
_CODEC_OF = {0x1B: CODECS["h264"], 0x24: CODECS["h265"]}  # by stream type
_MAX_UNIT = 16 << 20
_MAX_PES = 65_000  # bytes of a PES packet with a length: a longer picture goes on in the next
_MIN_SEEN = 4  # access units of which each begins with a picture, until one is believed
_GAP = 1.75  # usual steps of time, from which pictures are missing
_MAX_OTHERS = 20  # packets of RTP
_WAIT_S = 0.05
_OTHER_S = 1.0  # of silence, after which another sender is listened to
_MAX_DATAGRAM = 65_536
_SO_RXQ_OVFL = 40  # Linux: how many datagrams the socket has dropped
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


class TransportStream:
    """The access units of a transport stream's first video, by its packets.

    What is lost breaks the access unit that is open. Those after it are whole: what they refer to
    is the decoder's to tell.
    """

    def __init__(self) -> None:
        self.codec: Codec | None = None
        self._last: dict[int, bytes] = {}  # by PID, its last packet with a payload
        self._pmt_pid = self._video_pid = -1
        self._open: bytearray | None = None  # the video's PES packet
        self._arrived, self._timestamp = 0.0, 0
        self._fault = ""
        self._seen = 0
        self._time: int | None = None  # of decoding, of the PES packet that is open
        self._steps: deque[int] = deque(maxlen=9)  # from one to the next

    def lose(self, words: str = "packets of it are lost") -> None:
        """Packets were lost, of whatever PID."""
        self._fault = self._fault or words
        if self._open is None and self.codec is not None:
            self._open = bytearray()  # whole access units may be lost: that is told, too

    def add(self, data: bytes, arrived: float) -> Iterator[AccessUnit]:
        """Take a datagram's packets, in their order; the access units that are complete by it."""
        if len(data) % PACKET:
            self.lose()
        for at in range(0, len(data) - PACKET + 1, PACKET):
            packet = data[at : at + PACKET]
            if packet[0] != _SYNC or packet[1] & 0x80 or packet[3] & 0xC0:
                self.lose("packets of it are damaged or scrambled")
            else:
                yield from self._packet(packet, arrived)

    def _packet(self, packet: bytes, arrived: float) -> Iterator[AccessUnit]:
        pid, start = _number(packet[1:], 13), 4
        if packet[3] & 0x20:  # an adaptation field
            start += 1 + packet[4]
            if packet[4] and packet[5] & 0x80:
                self.lose("the sender has begun anew")
        if pid == _NULL_PID or not packet[3] & 0x10 or start > PACKET:
            return
        last, self._last[pid] = self._last.get(pid), packet
        if last is not None:
            if last == packet:
                return  # the standard allows one copy
            if (last[3] + 1 ^ packet[3]) & 15:
                self.lose()
        begins, payload = bool(packet[1] & 0x40), packet[start:]
        if begins and pid in (_PAT_PID, self._pmt_pid):
            self._table(pid, payload[1 + sum(payload[:1]) :])
        elif pid == self._video_pid:
            yield from self._video(begins, payload, arrived)

    def _video(self, begins: bool, payload: bytes, arrived: float) -> Iterator[AccessUnit]:
        if begins:
            if self._is_gap(payload):
                self.lose("pictures after it are missing")  # and its end, maybe
            yield from self._closed()
            self._open, self._fault = bytearray(), ""
        if self._open is None:
            return
        self._open += payload
        self._arrived = arrived
        length = int.from_bytes(self._open[4:6], "big")
        if length and len(self._open) >= 6 + length:
            yield from self._closed()
        elif len(self._open) > _MAX_UNIT:
            self.lose("it has no end")
            yield from self._closed()

    def _is_gap(self, payload: bytes) -> bool:
        """Whether a PES packet that begins is of a later time than the next one's."""
        told = len(payload) >= 19 and payload[7] & 0x40  # B pictures come in another order
        before, self._time = self._time, _time(payload[14 if told else 9 :])
        if before is None or self._time is None:
            return False
        step = (self._time - before) % (1 << 33)
        gap = len(self._steps) >= _MIN_SEEN and step > _GAP * median(self._steps)
        self._steps.append(step)
        return gap

    def _closed(self) -> Iterator[AccessUnit]:
        """The access unit of the PES packet that was open."""
        pes, self._open = self._open, None
        if pes is None or self.codec is None:
            return
        length, fault, units = int.from_bytes(pes[4:6], "big"), self._fault, list[bytes]()
        if not fault and (pes[:3] != b"\0\0\1" or len(pes) < 14 or not pes[7] & 0x80):
            fault = "its PES packet has no time"
        if not fault:  # what is damaged has no time of its own, and no unit that is believed
            self._timestamp = (_time(pes[9:]) or 0) & 0xFFFFFFFF
            units = nal_units(bytes(pes[9 + pes[8] :]))
            short = length and (length > _MAX_PES or len(pes) != 6 + length)
            fault = "a part of it is missing" if short else self._mistaken(units)
        yield access_unit(self.codec, [] if fault else units, self._timestamp, self._arrived, fault)

    def _mistaken(self, units: list[bytes]) -> str:
        """Why a PES packet is not one access unit, or cannot be known to be."""
        assert self.codec is not None
        if any(len(unit) <= self.codec.header for unit in units):
            return "it holds an empty part"
        first = next((unit for unit in units if self.codec.is_picture(unit)), b"\0\0\0")
        # A slice's first bit: a sender that begins a PES packet with each slice is not read.
        self._seen = self._seen + 1 if first[self.codec.header] & 0x80 else 0
        return "" if self._seen >= _MIN_SEEN else "it is not known to be whole"

    def _table(self, pid: int, section: bytes) -> None:
        """Take a table of the program's (clause 2.4.4), which senders fit into one packet."""
        size = 3 + _number(section[1:], 12)
        if not 12 <= size <= len(section) or not section[5] & 1:  # of a time to come
            return
        if zlib.crc32(section[:size].translate(_REVERSED)) != 0xFFFFFFFF:
            return
        body = section[8 : size - 4]
        if pid == _PAT_PID and section[0] == 0:
            rows = (body[at : at + 4] for at in range(0, len(body) - 3, 4))
            self._pmt_pid = next((_number(row[2:], 13) for row in rows if any(row[:2])), -1)
        elif pid == self._pmt_pid and section[0] == 2:
            self._program(body)

    def _program(self, body: bytes) -> None:
        """Find the video in a program's table."""
        at = 4 + _number(body[2:], 12)
        while at + 5 <= len(body):
            pid = _number(body[at + 1 :], 13)
            if codec := _CODEC_OF.get(body[at]):
                if (pid, codec) != (self._video_pid, self.codec):
                    self._video_pid, self.codec, self._open, self._seen = pid, codec, None, 0
                return
            at += 5 + _number(body[at + 3 :], 12)
        raise StreamLostError("the stream holds no video of H.264 or H.265")


def _number(data: bytes, bits: int) -> int:
    """The lower bits of two bytes."""
    return int.from_bytes(data[:2], "big") & (1 << bits) - 1


def _time(data: bytes | bytearray) -> int | None:
    """A time of 33 bits (table 2-21)."""
    if len(data) < 5:
        return None
    low = data[3] << 7 | data[4] >> 1
    return (data[0] >> 1 & 7) << 30 | (data[1] << 7 | data[2] >> 1) << 15 | low


class TransportReader:
    """Put one sender's datagrams together to pictures; without a clock, as `RtpStream`."""

    def __init__(self) -> None:
        self._stream = TransportStream()
        self._clock, self._delay = SenderClock(), Delay()
        self._decoder: VideoDecoder | None = None
        self._last, self._others = b"", 0

    def datagram(self, data: bytes, arrived: float, lost: bool = False) -> list[Reading]:
        """Take one, and whether some before it are known to be lost; what it completes.

        StreamLostError if it is of a stream that cannot be read.
        """
        if lost:
            self._stream.lose()
        if data[:1] != bytes([_SYNC]):
            self._others += parse_rtp(data, arrived) is not None
            if self._others > _MAX_OTHERS and self._decoder is None:
                raise StreamLostError("RTP comes there and no MPEG-TS: name it rtp:// and its port")
            return []
        # A network may send a datagram twice; one of 16 packets may be as it was before.
        if data == self._last and len(data) < 16 * PACKET and not lost:
            return []
        self._last = data
        return [done for unit in self._stream.add(data, arrived) for done in self._decoded(unit)]

    def _decoded(self, unit: AccessUnit) -> list[Reading]:
        codec = self._stream.codec
        assert codec is not None
        if self._decoder is None or codec is not self._decoder.codec:
            self._decoder = VideoDecoder(codec)
        return [
            Reading(None, done.unit.arrived, done.fault)  # its time is not known
            if done.unit.fault
            else timed_reading(done, self._clock, self._delay)
            for done in self._decoder.feed(unit)
        ]


def read_mpegts(address: VideoAddress, newest: NewestReading) -> None:
    """Listen on a UDP port until stopped; StreamLostError if it cannot be had, or be read."""
    assert address.port is not None
    reader, sender, heard, dropped = TransportReader(), None, 0.0, 0
    # VLC and FFmpeg write udp://@:PORT for "listen", where other addresses have a user.
    with listening_socket(address.host, address.port) as port:
        count_drops(port)
        port.settimeout(_WAIT_S)
        while not newest.stopped.is_set():
            newest.alive()
            try:
                data, origin, count = received(port)
            except TimeoutError:
                continue
            now = SYSTEM_CLOCK.monotonic()
            if origin == sender or now - heard > _OTHER_S:
                if origin != sender:
                    reader, sender = TransportReader(), origin
                for reading in reader.datagram(data, now, count != dropped):
                    newest.put(reading)
                heard, dropped = now, count


def count_drops(port: socket.socket) -> None:
    """Have the system count the datagrams that it drops, where it can."""
    if sys.platform == "linux":
        port.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)


def received(port: socket.socket) -> tuple[bytes, object, int]:
    """A datagram, where it is from, and how many were dropped before it since the beginning."""
    if sys.platform != "linux":
        return *port.recvfrom(_MAX_DATAGRAM), 0
    data, told, _, origin = port.recvmsg(_MAX_DATAGRAM, socket.CMSG_SPACE(4))
    return data, origin, int.from_bytes(told[0][2] if told else b"", sys.byteorder)
