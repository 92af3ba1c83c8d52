"""RTP packets of encoded pictures, written without any library: RFC 3550, 6184 (H.264), 7798."""

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from io import BytesIO
from typing import Any

import av

from .encoding import CLOCK_HZ, AccessUnit

RTP, RTCP = "rtp", "rtcp"
PAYLOAD_TYPE = 96
FORMATS = {"h264": "H264", "h265": "H265"}
MTU = 1400
SSRC = 0x70_6B_74_01
MAX_SEQ, MAX_TIMESTAMP = 1 << 16, 1 << 32
TS_DATAGRAM = 7 * 188

_STAP_A, _FU_A = 24, 28  # RFC 6184, table 1
_AP, _FU = 48, 49  # RFC 7798, 4.4
_SENDER_REPORT, _DESCRIPTION = 200, 202
_START_CODE = re.compile(b"\0\0\1")


@dataclass(frozen=True)
class Packet:
    """One datagram of a capture."""

    kind: str  # RTP or RTCP: which port it goes to
    data: bytes
    t: float  # seconds since the capture's start
    number: int | None  # of the picture it is part of


def nal_units(data: bytes) -> list[bytes]:
    """The NAL units of an Annex B stream."""
    starts = [found.start() for found in _START_CODE.finditer(data)]
    ends = [*starts[1:], len(data)]
    return [data[start + 3 : end].rstrip(b"\0") for start, end in zip(starts, ends, strict=True)]


def annex_b(units: Iterable[bytes]) -> bytes:
    """NAL units as one Annex B stream."""
    return b"".join(b"\0\0\0\1" + unit for unit in units)


def payloads(units: list[bytes], codec: str, mtu: int = MTU, aggregate: bool = True) -> list[bytes]:
    """The RTP payloads of one access unit: single, aggregated, fragmented."""
    room = mtu - 12
    made: list[bytes] = []
    small: list[bytes] = []

    def flush() -> None:
        if len(small) == 1:
            made.append(small[0])
        elif small:
            made.append(_aggregated(small, codec))
        small.clear()

    for unit in units:
        if small and 2 + sum(len(each) + 2 for each in (*small, unit)) > room:
            flush()
        if len(unit) > room:
            flush()
            made += _fragments(unit, codec, room)
        else:
            small.append(unit)
            if not aggregate:
                flush()
    flush()
    return made


def _aggregated(units: list[bytes], codec: str) -> bytes:
    parts = b"".join(struct.pack("!H", len(unit)) + unit for unit in units)
    if codec == "h264":
        return bytes([max(unit[0] & 0x60 for unit in units) | _STAP_A]) + parts
    return bytes([_AP << 1, 1]) + parts


def _fragments(unit: bytes, codec: str, room: int) -> Iterator[bytes]:
    header = 1 if codec == "h264" else 2
    if codec == "h264":
        kind, front = unit[0] & 0x1F, bytes([unit[0] & 0xE0 | _FU_A])
    else:
        kind, front = unit[0] >> 1 & 0x3F, bytes([unit[0] & 0x81 | _FU << 1, unit[1]])
    body, step = unit[header:], room - header - 1
    for at in range(0, len(body), step):
        edges = (0x80 if at == 0 else 0) | (0x40 if at + step >= len(body) else 0)
        yield front + bytes([edges | kind]) + body[at : at + step]


def rtp_packets(
    units: Iterable[AccessUnit],
    codec: str = "h264",
    *,
    mtu: int = MTU,
    aggregate: bool = True,
    ssrc: int = SSRC,
    seq: int = 1000,
    timestamp: int = 123_456,
    payload_type: int = PAYLOAD_TYPE,
    report_every: int = 0,
    start: float = 0.0,
) -> list[Packet]:
    """A capture of a stream.

    Parameters
    ----------
    seq, timestamp : int
        Of the first packet; both wrap.
    report_every : int
        Pictures from one RTCP sender report to the next; 0 for none.
    start : float
        The capture's time of the first picture, s.
    """
    made: list[Packet] = []
    sent = octets = 0
    first_pts = None
    t = start
    for place, unit in enumerate(units):
        first_pts = unit.pts if first_pts is None else first_pts
        stamp = (timestamp + unit.pts - first_pts) % MAX_TIMESTAMP
        t = max(t, start + (unit.pts - first_pts) / CLOCK_HZ)
        if report_every and place % report_every == 0:
            report = sender_report(ssrc, t, stamp, sent, octets)
            made.append(Packet(RTCP, report, t, None))
        parts = payloads(nal_units(unit.data), codec, mtu, aggregate)
        for at, payload in enumerate(parts):
            marker = 0x80 if at == len(parts) - 1 else 0
            second = marker | payload_type
            header = struct.pack("!BBHII", 0x80, second, seq % MAX_SEQ, stamp, ssrc)
            made.append(Packet(RTP, header + payload, t + at * 2e-5, unit.number))
            seq, sent, octets = seq + 1, sent + 1, octets + len(payload)
    return made


def sender_report(ssrc: int, t: float, timestamp: int, sent: int, octets: int) -> bytes:
    """An RTCP sender report with the name that has to go with it; NTP time is 2026 and `t`."""
    ntp = 3_976_214_400 + t
    whole, fraction = int(ntp), int(ntp % 1 * (1 << 32))
    head = struct.pack("!BBHI", 0x80, _SENDER_REPORT, 6, ssrc)
    report = struct.pack("!IIIII", whole, fraction, timestamp, sent % (1 << 32), octets % (1 << 32))
    items = struct.pack("!IBB", ssrc, 1, 4) + b"test" + b"\0\0"  # CNAME, then the end, padded
    return head + report + struct.pack("!BBH", 0x81, _DESCRIPTION, len(items) // 4) + items


def follow(*captures: list[Packet], gap_s: float = 0.1) -> list[Packet]:
    """Captures one after the other: a sender that starts anew, or changes its pictures."""
    made: list[Packet] = []
    for capture in captures:
        shift = made[-1].t + gap_s if made else 0.0
        made += [replace(packet, t=packet.t + shift) for packet in capture]
    return made


def merged(*captures: list[Packet]) -> list[Packet]:
    """Captures at the same time: a second stream at the same port."""
    return sorted((packet for capture in captures for packet in capture), key=lambda one: one.t)


def joined_units(*films: list[AccessUnit], rate: int = 30) -> list[AccessUnit]:
    """Encoded films one after the other in one stream: the pictures' size may change there."""
    made: list[AccessUnit] = []
    for film in films:
        shift = made[-1].pts + CLOCK_HZ // rate if made else 0
        made += [replace(unit, pts=unit.pts + shift) for unit in film]
    return made


def sdp(port: int, codec: str = "h264", payload_type: int = PAYLOAD_TYPE) -> str:
    """A session description for other programs; parameter sets are in the stream."""
    lines = ["v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=test", "c=IN IP4 127.0.0.1", "t=0 0"]
    lines += [f"m=video {port} RTP/AVP {payload_type}"]
    lines += [f"a=rtpmap:{payload_type} {FORMATS[codec]}/{CLOCK_HZ}"]
    if codec == "h264":
        lines += [f"a=fmtp:{payload_type} packetization-mode=1"]
    return "\r\n".join(lines) + "\r\n"


def transport_stream(units: list[AccessUnit], codec: str = "h264", rate: int = 30) -> list[Packet]:
    """The same pictures as MPEG-TS in datagrams of seven packets, as FFmpeg writes it."""
    made: list[Packet] = []
    sink = BytesIO()
    with av.open(sink, "w", format="mpegts") as container:
        stream: Any = container.add_stream({"h264": "h264", "h265": "hevc"}[codec], rate=rate)
        for unit in units:
            packet = av.Packet(unit.data)
            packet.stream = stream
            packet.pts = packet.dts = unit.pts
            packet.time_base, packet.is_keyframe = Fraction(1, CLOCK_HZ), unit.key
            container.mux(packet)
    data = sink.getvalue()
    pieces = [data[at : at + TS_DATAGRAM] for at in range(0, len(data), TS_DATAGRAM)]
    last = units[-1].pts / CLOCK_HZ
    for place, piece in enumerate(pieces):
        made.append(Packet(RTP, piece, last * place / len(pieces), None))
    return made
