"""What an encoder makes of the pictures, in this process, and what a decoder gives of it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import av
import numpy as np

from tokt.features.common.arrays import U8

from .pictures import i420

CODECS = {"h264": "libx264", "h265": "libx265"}
CLOCK_HZ = 90_000
"""Of the times of network video."""


@dataclass(frozen=True)
class AccessUnit:
    """One encoded picture: Annex B bytes, in the order of decoding."""

    data: bytes
    key: bool
    number: int  # of the picture
    pts: int  # its time, in 1/90000 s


def encode(
    codec: str = "h264",
    frames: Iterable[int] | int = 60,
    size: tuple[int, int] = (320, 240),
    rate: int = 30,
    key_every: int = 30,
    bitrate: int = 400_000,
    **settings: Any,
) -> list[AccessUnit]:
    """Encode pictures by their numbers, with the parameter sets in front of each key picture.

    Settings are those of `open_encoder`.
    """
    numbers = list(range(frames)) if isinstance(frames, int) else list(frames)
    encoder = open_encoder(codec, size, rate, key_every, bitrate, **settings)
    packets = []
    for place, number in enumerate(numbers):
        frame = av.VideoFrame.from_ndarray(i420(number, size), format="yuv420p")
        frame.pts, frame.time_base = place, Fraction(1, rate)
        packets += encoder.encode(frame)
    packets += encoder.encode(None)
    ticks = CLOCK_HZ // rate
    return [
        AccessUnit(bytes(packet), packet.is_keyframe, numbers[packet.pts], packet.pts * ticks)
        for packet in packets
    ]


def open_encoder(
    codec: str,
    size: tuple[int, int],
    rate: int,
    key_every: int,
    bitrate: int,
    *,
    zerolatency: bool = True,
    bframes: int = 0,
    slices: int = 1,
    intra_refresh: bool = False,
    preset: str = "ultrafast",
) -> av.VideoCodecContext:
    """An encoder of one thread, as cameras have: no look-ahead unless it is asked for."""
    encoder: Any = av.CodecContext.create(CODECS[codec], "w")
    encoder.width, encoder.height = size
    encoder.pix_fmt, encoder.framerate = "yuv420p", Fraction(rate)
    encoder.time_base = Fraction(1, rate)
    encoder.bit_rate, encoder.gop_size, encoder.max_b_frames = bitrate, key_every, bframes
    settings = {
        "keyint": key_every,
        "min-keyint": 1 if intra_refresh else key_every,
        "scenecut": 0,
        "bframes": bframes,
        "slices": slices,
        "repeat-headers": 1,
        "vbv-maxrate": max(1, bitrate // 1000),
        "vbv-bufsize": max(1, bitrate // 2000),
    }
    if intra_refresh:
        settings["intra-refresh"] = 1
    if codec == "h265":
        settings |= {"log-level": "none", "pools": 1, "frame-threads": 1, "aud": 0}
    else:
        settings |= {"threads": 1, "sliced-threads": 0}
    name = "x264-params" if codec == "h264" else "x265-params"
    encoder.options = {
        "preset": preset,
        name: ":".join(f"{key}={value}" for key, value in settings.items()),
        **({"tune": "zerolatency"} if zerolatency else {}),
    }
    encoder.thread_count = 1
    return encoder


def decoder_of(codec: str) -> Any:
    decoder: Any = av.CodecContext.create({"h264": "h264", "h265": "hevc"}[codec], "r")
    decoder.thread_count = 1
    return decoder


def decoded(
    units: Iterable[AccessUnit], codec: str = "h264", form: str = "yuv420p"
) -> Iterator[tuple[int, U8]]:
    """The pictures that a stream decodes to where nothing is lost, with the number of each.

    The number is by the encoder's order, not read from the picture. I420, as `pictures.i420`, or
    another of FFmpeg's pixel formats.
    """
    decoder, names = decoder_of(codec), {}

    def shown(frames: list[Any]) -> Iterator[tuple[int, U8]]:
        for frame in frames:
            yield names[frame.pts], np.asarray(frame.to_ndarray(format=form), np.uint8)

    for unit in units:
        packet = av.Packet(unit.data)
        packet.pts = unit.pts
        packet.time_base = Fraction(1, CLOCK_HZ)
        names[unit.pts] = unit.number
        yield from shown(decoder.decode(packet))
    yield from shown(decoder.decode(None))
