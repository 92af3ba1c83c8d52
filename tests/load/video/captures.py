"""Captures with faults through tokt's reader as fast as it reads: no picture that was not sent."""

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from tests.inference.sources.video.encoding import AccessUnit, decoded, encode
from tests.inference.sources.video.network import Network, cut
from tests.inference.sources.video.packets import (
    MAX_SEQ,
    MAX_TIMESTAMP,
    Packet,
    follow,
    joined_units,
    merged,
    rtp_packets,
)
from tests.inference.sources.video.pictures import number_of
from tokt.features.common.arrays import U8
from tokt.inference.sources.video.access_units import CODECS
from tokt.inference.sources.video.newest import Reading, StreamLostError
from tokt.inference.sources.video.rtp_stream import RtpStream

_FRAMES = 24
_SMALL, _LARGE = (96, 64), (160, 96)
_ENCODINGS: tuple[dict[str, Any], ...] = (
    {},
    {"slices": 3, "size": _LARGE},
    {"bframes": 2, "zerolatency": False, "preset": "veryfast"},
    {"intra_refresh": True},
    {"size": _LARGE},
)


@cache
def _film(codec: str, encoding: int, first: int) -> tuple[list[AccessUnit], dict[int, U8]]:
    """A film, and the pictures that it decodes to where nothing is lost."""
    settings = {"size": _SMALL, "bitrate": 250_000, **_ENCODINGS[encoding]}
    units = encode(codec, range(first, first + _FRAMES), key_every=8, **settings)
    return units, dict(decoded(units, codec))


@dataclass(frozen=True)
class Case:
    codec: str
    packets: list[Packet]
    truth: dict[int, U8]
    whole: list[Packet]  # before the network
    keys: frozenset[int]
    faults: tuple[str, ...]


def draw_case(seed: int) -> Case:
    rng = random.Random(seed)
    codec = rng.choice(("h264", "h265"))
    first, other = rng.randrange(len(_ENCODINGS)), rng.randrange(len(_ENCODINGS))
    units, truth = _film(codec, first, 0)
    settings: dict[str, Any] = {"mtu": rng.choice((120, 200, 400, 1400))}
    settings |= {"aggregate": rng.random() < 0.8, "report_every": rng.choice((0, 10))}
    faults = []
    start = {"seq": rng.randrange(MAX_SEQ), "timestamp": rng.randrange(MAX_TIMESTAMP)}
    if rng.random() < 0.3:
        faults.append("numbers wrap")
        start = {"seq": MAX_SEQ - rng.randrange(60), "timestamp": MAX_TIMESTAMP - 3000 * 10}
    if rng.random() < 0.15:
        faults.append("pictures never sent")
        units = [unit for unit in units if rng.random() > 0.1]
    if rng.random() < 0.2:
        faults.append("other size")
        more, more_truth = _film(codec, other, 100)
        units, truth = joined_units(units, more), {**truth, **more_truth}
    packets = rtp_packets(units, codec, **start, **settings)
    if rng.random() < 0.25:
        faults.append("restart")
        more, more_truth = _film(codec, other, 200)
        anew = rtp_packets(more, codec, ssrc=rng.randrange(1 << 32), seq=rng.randrange(MAX_SEQ))
        gap_s = rng.choice((0.0, 0.04, 0.5, 3.0))
        packets, truth = follow(packets, anew, gap_s=gap_s), {**truth, **more_truth}
    if rng.random() < 0.1:
        faults.append("second stream")
        more, more_truth = _film(codec, other, 300)
        beside = rtp_packets(more, codec, ssrc=rng.randrange(1 << 32), start=0.01)
        packets, truth = merged(packets, beside), {**truth, **more_truth}
    whole = packets
    if rng.random() < 0.3:
        faults.append("joined")
        packets = cut(packets, rng.randrange(len(packets)))
    network = Network(
        seed=seed,
        loss=rng.choice((0.0, 0.0, 0.002, 0.01, 0.05, 0.3)),
        burst=rng.choice((1.0, 1.0, 4.0, 12.0)),
        reorder=rng.choice((0.0, 0.0, 0.01, 0.1)),
        reorder_by=rng.choice((1, 3, 20)),
        duplicate=rng.choice((0.0, 0.05)),
        garbage=rng.choice((0.0, 0.0, 0.02, 0.2)),
    )
    names = ("loss", "reorder", "duplicate", "garbage")
    faults += [name for name in names if getattr(network, name)]
    keys = frozenset(unit.number for unit in units if unit.key)
    return Case(codec, network.over(packets), truth, whole, keys, tuple(faults))


def read(packets: list[Packet], codec: str) -> Iterator[tuple[float, Reading]]:
    """What the reader makes of a capture by the packets' own times, and when."""
    stream = RtpStream(CODECS[codec])
    for packet in packets:
        try:
            while (due := stream.due()) <= packet.t:
                yield from ((due, reading) for reading in stream.expired(due))
            yield from ((packet.t, each) for each in stream.datagram(packet.data, packet.t))
        except StreamLostError:  # its session is begun anew
            stream = RtpStream(CODECS[codec])
    if packets:
        end = packets[-1].t + 1.0
        yield from ((end, reading) for reading in stream.expired(end))


@dataclass
class Counted:
    """What came of streams."""

    streams: int = 0
    sent: int = 0  # pictures
    whole: int = 0  # pictures delivered, bit for bit as the lossless stream decodes to
    missing: int = 0  # readings without a picture
    damaged: int = 0  # pictures delivered that are not what was sent
    first_s: list[float] = field(default_factory=list)
    """From the first packet of a stream, or of its first whole key picture, to the first one."""
    worst: tuple[int, tuple[str, ...]] | None = None

    def take(self, picture: U8 | None, truth: dict[int, U8]) -> None:
        """Count a reading: it is whole where it is, in every pixel, the one whose number it has."""
        self.missing += picture is None
        if picture is not None:
            expected = truth.get(-1 if (number := number_of(picture)) is None else number)
            whole = expected is not None and picture.tobytes() == expected.tobytes()
            self.whole, self.damaged = self.whole + whole, self.damaged + (not whole)

    def count(self, seed: int, case: Case) -> None:
        """Read one capture."""
        self.streams += 1
        self.sent += len({packet.number for packet in case.whole} - {None})
        first = None
        for at, reading in read(case.packets, case.codec):
            shown = reading.picture
            if shown is not None and first is None:
                first = at
            self.take(None if shown is None else shown.to_ndarray(format="yuv420p"), case.truth)
            if self.damaged and self.worst is None:
                self.worst = seed, case.faults
        alone = not {"restart", "second stream", "other size", "reorder"} & set(case.faults)
        if alone and first is not None and (began := first_key(case)) is not None:
            self.first_s.append(first - began)


def first_key(case: Case) -> float | None:
    """When the first stream's first key picture of which every packet came began; None without."""
    needed = Counter(packet.number for packet in case.whole if packet.number is not None)
    got: Counter[int] = Counter()
    began: dict[int, float] = {}
    seen = set()
    for packet in case.packets:
        number = packet.number
        if number in case.keys and packet.data not in seen:
            seen.add(packet.data)
            began.setdefault(number, packet.t)
            got[number] += 1
            if got[number] == needed[number]:
                return began[number]
    return None


def count_captures(captures: int, first: int = 0) -> Counted:
    counted = Counted()
    for seed in range(first, first + captures):
        counted.count(seed, draw_case(seed))
    return counted


@dataclass(frozen=True)
class Share:
    bitrate: int
    packets_a_picture: float
    whole: float  # share of the pictures
    intact: float  # share of those that came whole themselves, whatever was lost before them


def judged_share(
    bitrate: int, loss: float, captures: int, size: tuple[int, int], frames: int, codec: str
) -> Share:
    """The share of the pictures that are shown, with a key picture each second."""
    units = encode(codec, frames, size, key_every=30, bitrate=bitrate)
    packets = rtp_packets(units, codec)
    needed = Counter(packet.number for packet in packets)
    whole = intact = 0
    for seed in range(captures):
        came = Network(seed, loss=loss).over(packets)
        whole += sum(reading.picture is not None for _, reading in read(came, codec))
        left = Counter(packet.number for packet in came)
        intact += sum(left[number] == sent for number, sent in needed.items())
    sent = captures * frames
    return Share(bitrate, len(packets) / frames, whole / sent, intact / sent)
