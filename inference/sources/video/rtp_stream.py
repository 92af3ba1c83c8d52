"""One camera's RTP: from datagrams to pictures, and the ports it is listened for on."""

import select
import socket
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from ipaddress import ip_address

from tokt.inference.clock import SYSTEM_CLOCK

from .access_units import CODECS, Codec, Depacketizer
from .address import VideoAddress
from .decoder import Decoded, VideoDecoder
from .newest import NewestReading, Reading, StreamLostError
from .rtp import Delay, PacketOrder, RtpPacket, SenderClock, is_rtcp, parse_rtp, parse_sender_report

_LOOK_S = 0.05
_MAX_DATAGRAM = 65_536
_BUFFER_BYTES = 8 << 20  # as far as the system lets: a picture is decoded meanwhile


class RtpStream:
    """Put one sender's datagrams together to pictures.

    It has no clock of its own: who hands it a datagram says when that came.
    """

    def __init__(self, codec: Codec, payload_type: int | None = None) -> None:
        self._codec = codec
        self._order = PacketOrder(payload_type)
        self._ssrc: int | None = None
        self._sets_told = False
        self._begin()

    def _begin(self) -> None:
        """Nothing of one sender holds for the next: parameter sets, above all."""
        self._units = Depacketizer(self._codec)
        self._decoder = VideoDecoder(self._codec)
        self._clock, self._delay = SenderClock(), Delay()

    def take_set(self, unit: bytes) -> None:
        """Take a parameter set that was told beside the stream."""
        self._decoder.take_sets([unit])
        self._sets_told = True

    def datagram(self, data: bytes, arrived: float) -> list[Reading]:
        """Take one, of RTP or RTCP; what it completes. One that is neither is left out.

        `arrived` is in seconds of a clock that never steps back.
        """
        if is_rtcp(data):
            if (report := parse_sender_report(data)) and report[0] == self._ssrc:
                self._clock.report(*report[1:])
            return []
        packet = parse_rtp(data, arrived)
        return [] if packet is None else self._taken(self._order.add(packet))

    def expired(self, now: float) -> list[Reading]:
        """Give up packets that are missing for too long; what is complete by that."""
        return self._taken(self._order.expired(now))

    def due(self) -> float:
        """When `expired` is to be asked, by the same clock; infinite if nothing is missing."""
        return self._order.due()

    def _taken(self, packets: Iterable[tuple[RtpPacket, bool]]) -> list[Reading]:
        readings = []
        for packet, lost in packets:
            if packet.ssrc != self._ssrc and self._ssrc is not None:
                if self._sets_told:  # which were the other's
                    raise StreamLostError("another sender has taken over")
                self._begin()
            self._ssrc = packet.ssrc
            for unit in self._units.add(packet, lost):
                for done in self._decoder.feed(unit):
                    readings.append(timed_reading(done, self._clock, self._delay))
        return readings


def timed_reading(decoded: Decoded, clock: SenderClock, delay: Delay) -> Reading:
    """A picture, or why there is none, with the times that its sender tells."""
    unit = decoded.unit
    taken_s, captured_t = clock.seconds(unit.timestamp), clock.utc(unit.timestamp)
    arrived = delay.undelayed(taken_s, unit.arrived)
    return Reading(decoded.frame, arrived, decoded.fault, taken_s, captured_t)


def read_rtp(address: VideoAddress, newest: NewestReading) -> None:
    """Listen on an RTP address, and on the port after it for RTCP, until stopped."""
    assert address.port is not None
    stream = RtpStream(CODECS[address.options.get("codec", "h264")])
    with ExitStack() as opened:
        ports = [opened.enter_context(listening_socket(address.host, address.port))]
        # Where another program has it, the sender's time of day is not known.
        with suppress(StreamLostError, OverflowError):
            ports.append(opened.enter_context(listening_socket(address.host, address.port + 1)))
        while not newest.stopped.is_set():
            newest.alive()
            wait_s = min(_LOOK_S, max(0.0, stream.due() - SYSTEM_CLOCK.monotonic()))
            for ready in select.select(ports, [], [], wait_s)[0]:
                for reading in stream.datagram(ready.recv(_MAX_DATAGRAM), SYSTEM_CLOCK.monotonic()):
                    newest.put(reading)
            for reading in stream.expired(SYSTEM_CLOCK.monotonic()):
                newest.put(reading)


def listening_socket(host: str, port: int) -> socket.socket:
    """A UDP socket that receives what is sent to this computer's address, or to a group's.

    StreamLostError if it cannot be listened on.
    """
    group = None
    with suppress(ValueError):  # a name
        group = at if (at := ip_address(host)).is_multicast else None
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        if group is not None:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((host, port))
        if group is not None:  # at any interface: the zeros
            level, join = socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP
            if group.version == 6:
                level, join = socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP
            opened.setsockopt(level, join, group.packed + bytes(4))
    except (OSError, TypeError) as error:  # the latter for what can be no host's name
        opened.close()
        where = f"{host or 'any address'}, port {port}"
        words = getattr(error, "strerror", error)
        raise StreamLostError(f"nobody can listen on {where}: {words}") from None
    return opened
