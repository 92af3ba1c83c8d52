"""USB cameras by Video4Linux, through FFmpeg's input device."""

import sys
from collections.abc import Iterator
from typing import Any

import av
from av.error import FFmpegError

from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.reason import Fault, Reason

from .access_units import CODECS, access_unit, nal_units
from .address import VideoAddress
from .decoder import VideoDecoder
from .mjpeg import JpegDecoder, jpeg_decoder
from .modes import describe_camera
from .newest import NewestReading, Reading, StreamLostError
from .rtp import RTP_HZ, Delay

_FORMATS = {"mjpeg": "mjpeg", "yuyv": "yuyv422", "h264": "h264"}
"""FFmpeg's names, by those that addresses have; the first that a camera has is taken by default."""
_OPTIONS = {"size": "video_size", "rate": "framerate"}
_MAX_QUEUED_S = 0.1  # in the driver's queue, beyond the least: newer ones wait there
_MAX_AGE_S = 10.0
_DAMAGED = "the driver says that it is damaged"


def read_v4l2(address: VideoAddress, newest: NewestReading) -> None:
    """Read a camera until stopped: MJPEG where it has that and nothing else is asked for.

    StreamLostError if it is not there, is in use, cannot be set as asked, or was pulled out.
    """
    if sys.platform != "linux":
        raise StreamLostError("Video4Linux is Linux's: there is none here")
    asked = address.options
    options = {_OPTIONS[key]: value for key, value in asked.items() if key in _OPTIONS}
    try:
        have = describe_camera(address.device)[1]
        chosen = asked.get("format") or next((name for name in _FORMATS if name in have), "")
        if chosen and have and chosen not in have:
            raise StreamLostError(f"the camera has no {chosen} (it has {', '.join(have)})")
        if chosen:
            options["input_format"] = _FORMATS[chosen]
        options |= {"probesize": "32", "fflags": "noparse"}
        with (
            av.open(address.device, format="v4l2", options=options) as opened,
            jpeg_decoder() as decode,
        ):
            sent = opened.streams.video[0]
            name, size = sent.codec_context.name, f"{sent.width}x{sent.height}"
            sends = (chosen, "yuyv" if name == "rawvideo" else name), (asked.get("size"), size)
            for wanted, has in sends:
                if wanted and wanted != has:  # drivers choose what is nearest
                    raise StreamLostError(f"the camera sends {has}, not {wanted}")
            for reading in _readings(opened.demux(video=0), name, decode, newest):
                newest.put(reading)
    except (FFmpegError, OSError) as error:
        more = " (is the user in the group video?)" if isinstance(error, PermissionError) else ""
        raise StreamLostError(f"{address.device}: {error.strerror}{more}") from None


def _readings(
    packets: Iterator[Any], name: str, decode: JpegDecoder, newest: NewestReading
) -> Iterator[Reading]:
    """What came of a camera's packets, until stopped.

    Nothing that a slow computer left in the driver's queue looks new: the driver says when it had
    each picture.
    """
    codec, delay = CODECS["h264"], Delay()
    decoder = VideoDecoder(codec)
    for packet in packets:
        newest.alive()
        if newest.stopped.is_set():
            return
        now = SYSTEM_CLOCK.monotonic()
        # The driver's clock stands still in a suspend.
        told_s = now
        if packet.pts is not None:
            told_s = float(packet.pts * packet.time_base) + SYSTEM_CLOCK.suspended()
        taken_s = told_s if 0 <= now - told_s < _MAX_AGE_S else now  # by another clock
        damaged = _DAMAGED if packet.is_corrupt or not packet.size else ""
        if name == "h264":
            timestamp = round(taken_s * RTP_HZ)
            unit = access_unit(codec, nal_units(bytes(packet)), timestamp, taken_s, damaged)
            for done in decoder.feed(unit):
                at = done.unit.arrived
                yield Reading(done.frame, at, done.fault, at)
        elif damaged:
            yield Reading(None, taken_s, Fault(Reason.INCOMPLETE, damaged), taken_s)
        elif now - delay.undelayed(taken_s, now) > _MAX_QUEUED_S:
            continue
        elif name == "mjpeg":
            picture, fault = decode(bytes(packet))
            yield Reading(picture, taken_s, fault, taken_s)
        else:
            for frame in packet.decode():
                assert isinstance(frame, av.VideoFrame)
                yield Reading(frame, taken_s, taken_s=taken_s)
