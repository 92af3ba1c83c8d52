"""Access units become pictures, by FFmpeg; one that is not what was sent is none.

FFmpeg fills in what is missing and seldom says so: a lost fragment, slice or picture leaves wrong
pixels in all that follows, up to the next key picture. So nothing is decoded from where something
is missing up to there. What the decoder itself finds wrong counts as missing as well.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from av import Packet, VideoFrame
from av.codec.context import Flags
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext

from tokt.inference.reason import NO_FAULT, Fault, Reason

from .access_units import AccessUnit, Codec
from .frame_numbers import FrameNumbers

_WAITS = "waiting for the next key picture"
_MAX_PIXELS, _MAX_DELAY = 100_000_000, 64  # of a picture; pictures that a decoder may hold back


@dataclass(frozen=True)
class Decoded:
    """What came of an access unit: its picture, or why there is none."""

    unit: AccessUnit
    frame: VideoFrame | None
    fault: Fault = NO_FAULT


def open_codec(name: str) -> VideoCodecContext:
    """A decoder of FFmpeg's that gives each picture as soon as it can.

    One thread: two gain 0.5 ms of 2 for pictures in slices, and cost a picture's time otherwise.
    """
    codec = VideoCodecContext.create(name, "r")
    assert isinstance(codec, VideoCodecContext)
    codec.thread_count = 1
    codec.flags |= Flags.low_delay
    codec.options = {"err_detect": "explode", "max_pixels": str(_MAX_PIXELS)}
    return codec


class VideoDecoder:
    """Decode one stream of H.264 or H.265, access unit by access unit."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._decoder = open_codec(codec.name)
        self._numbers = FrameNumbers() if codec.name == "h264" else None
        self._broken = "the stream is joined"
        self._inside: dict[int, AccessUnit] = {}
        self._count = 0

    def feed(self, unit: AccessUnit) -> list[Decoded]:
        """Take the next one; what is known by that."""
        gap = self._numbers is not None and self._numbers.gap(unit.units)
        if unit.fault:
            return [self._break(unit, unit.fault)]
        if unit.key:
            self._broken = ""
        elif not any(map(self.codec.is_picture, unit.units)):  # which FFmpeg calls invalid
            self.take_sets(unit.units)
            return []
        elif gap and not self._broken:
            return [self._break(unit, "pictures before it are missing")]
        if self._broken:
            self.take_sets(unit.units)
            return [Decoded(unit, None, Fault(Reason.DAMAGED, f"{self._broken}: {_WAITS}"))]
        return self._decode(unit)

    def take_sets(self, units: Iterable[bytes]) -> None:
        """Take the parameter sets among NAL units: they are whole, and may not come again."""
        header, is_set = self.codec.header, self.codec.is_set
        sets = tuple(each for each in units if len(each) > header and is_set(each))
        if sets:
            if self._numbers is not None:
                self._numbers.gap(sets)
            with suppress(FFmpegError):
                self._decoder.decode(Packet(AccessUnit(sets, 0, 0.0, False).data))

    def _decode(self, unit: AccessUnit) -> list[Decoded]:
        self._count += 1
        packet = Packet(unit.data)
        packet.pts = self._count
        self._inside[self._count] = unit
        self._inside.pop(self._count - _MAX_DELAY, None)
        done: list[Decoded] = []
        try:
            for frame in self._decoder.decode(packet):
                assert isinstance(frame, VideoFrame)
                of = self._inside.pop(frame.pts or 0, unit)
                if frame.is_corrupt:
                    return [*done, self._break(of, "it cannot be decoded whole")]
                done.append(Decoded(of, frame))
        except FFmpegError as error:
            return [*done, self._break(unit, f"it cannot be decoded ({error.strerror})")]
        return done

    def _break(self, unit: AccessUnit, words: str) -> Decoded:
        """Something is missing: nothing is decoded up to the next key picture."""
        self._broken = self._broken or f"a picture is not whole ({words})"
        self._decoder.flush_buffers()
        self._inside.clear()
        self.take_sets(unit.units)
        return Decoded(unit, None, Fault(Reason.INCOMPLETE, f"{words}: {_WAITS}"))
