"""Open live cameras as users name them: ``pymba:``, ``vimbax:``, ``genicam:``, an address."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import PIXEL_FORMATS
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.report import Event
from tokt.inference.sources.video.address import is_video_source, parse_video_sources

if TYPE_CHECKING:
    from .cameras.capture import CameraDriver
    from .cameras.live_source import CameraSource

PYMBA, VIMBAX, GENICAM = PREFIXES = "pymba:", "vimbax:", "genicam:"

_MIN_PACKET, _MAX_PACKET = 500, 16_384  # bytes; what GigE cameras' GevSCPSPacketSize spans
_POSITIVE = {
    "exposure_us": "an exposure is a positive number of microseconds",
    "bandwidth": "a bandwidth is a positive number of bytes per second",
    "camera_rate": "a frame rate is a positive number of frames per second",
}


def is_camera_source(text: str) -> bool:
    """Whether this names live cameras or streams, and not a folder or a file."""
    return text.startswith(PREFIXES) or is_video_source(text)


def check_camera_options(wanted: SourceConfig) -> None:
    """Check what a user asks of cameras, before one is touched; ToktError if it cannot be meant.

    What is None leaves a camera as it is: a camera that has no such setting refuses what was asked
    for, and takes no notice of defaults.
    """
    for name, words in _POSITIVE.items():
        value = getattr(wanted, name)
        if value is not None and not 0 < value < math.inf:
            raise ToktError(f"{words}, not {value}")
    if wanted.split not in (None, "left-right"):
        raise ToktError(f"--split is left-right, not {wanted.split!r}")
    if wanted.gain_db is not None and not math.isfinite(wanted.gain_db):
        raise ToktError(f"a gain is a number of dB, not {wanted.gain_db}")
    if wanted.pixel_format is not None and wanted.pixel_format not in PIXEL_FORMATS:
        known = ", ".join(PIXEL_FORMATS)
        raise ToktError(f"unknown pixel format {wanted.pixel_format!r} (choose from {known})")
    size = wanted.packet_size
    if size is not None and not _MIN_PACKET <= size <= _MAX_PACKET:
        raise ToktError(f"a packet has {_MIN_PACKET} to {_MAX_PACKET} bytes, not {size}")
    if wanted.trigger is not None and not wanted.trigger.isidentifier():
        raise ToktError(f"a trigger is a name such as Line1, not {wanted.trigger!r}")
    if wanted.trigger is not None and wanted.camera_rate is not None:
        raise ToktError("choose a trigger or a frame rate: a triggered camera keeps no rate")


def open_camera_source(
    wanted: SourceConfig, clock: Clock, on_event: Callable[[Event], None]
) -> CameraSource:
    """Open live cameras; they deliver from now on.

    The wanted source is one of `PREFIXES` and the left camera's ID, or its video's address; for two
    a comma and the right one's. `on_event` is given each `Event`, on a thread of a camera's.

    ToktError if it names no such cameras or asks them for what cannot be meant, what drives them is
    missing, or they cannot be opened.
    """
    check_camera_options(wanted)
    from .cameras.live_source import CameraSource

    split = wanted.split is not None
    source = CameraSource(_drivers(wanted, clock), clock, on_event, wanted.wait, split)
    source.start()
    return source


def _drivers(wanted: SourceConfig, clock: Clock) -> Sequence[CameraDriver]:
    """The drivers of what a user named; nothing is opened yet."""
    text = wanted.source
    if is_video_source(text):
        from tokt.inference.sources.video import driver as video

        addresses = parse_video_sources(text)
        if wanted.split and len(addresses) > 1:
            raise ToktError("--split is for one source that holds both views, not for two")
        return video.open_drivers(addresses, clock)
    prefix = next((each for each in PREFIXES if text.startswith(each)), PYMBA)
    ids = [part.strip() for part in text.removeprefix(prefix).split(",")]
    if not is_camera_source(text) or len(ids) > 2 or not all(ids):
        raise ToktError(f"live cameras are {prefix}ID or {prefix}LEFT,RIGHT, not {text!r}")
    if len(set(ids)) < len(ids):
        raise ToktError(f"the left and the right camera are both {ids[0]!r}")
    if prefix == GENICAM:
        from tokt.inference.sources.cameras.genicam.driver import open_drivers

        return open_drivers(ids, wanted, clock)
    from tokt.inference.sources.cameras.vimba import driver as vimba

    return vimba.open_drivers(ids, wanted, clock, vimbax=prefix == VIMBAX)
