"""Open live cameras as a user names them: ``pymba:ID[,ID]`` or ``genicam:ID[,ID]``."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import PIXEL_FORMATS
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.report import Event

if TYPE_CHECKING:
    from .live_source import CameraSource

PYMBA, GENICAM = "pymba:", "genicam:"

_MIN_PACKET, _MAX_PACKET = 500, 16_384  # bytes; what GigE cameras' GevSCPSPacketSize spans
_POSITIVE = {
    "exposure_us": "an exposure is a positive number of microseconds",
    "bandwidth": "a bandwidth is a positive number of bytes per second",
    "camera_rate": "a frame rate is a positive number of frames per second",
}


def is_camera_source(text: str) -> bool:
    """Whether this names live cameras, and not a folder or a file."""
    return text.startswith((PYMBA, GENICAM))


def check_camera_options(wanted: SourceConfig) -> None:
    """Check what a user asks of cameras, before one is touched; ToktError if it cannot be meant.

    What is None leaves a camera as it is: a camera that has no such setting refuses what was asked
    for, and takes no notice of defaults.
    """
    for name, words in _POSITIVE.items():
        value = getattr(wanted, name)
        if value is not None and not 0 < value < math.inf:
            raise ToktError(f"{words}, not {value}")
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

    Parameters
    ----------
    wanted : SourceConfig
        Its `source` is ``pymba:`` or ``genicam:`` and the left camera's ID; for two a comma and the
        right one's.
    clock : Clock
    on_event : callable
        Given each `Event`, on a thread of a camera's.

    Raises
    ------
    ToktError
        If it names no such cameras or asks them for what cannot be meant, what drives them is
        missing, or they cannot be opened.
    """
    check_camera_options(wanted)
    text = wanted.source
    prefix = PYMBA if text.startswith(PYMBA) else GENICAM
    ids = [part.strip() for part in text.removeprefix(prefix).split(",")]
    if not is_camera_source(text) or len(ids) > 2 or not all(ids):
        raise ToktError(f"live cameras are {prefix}ID or {prefix}LEFT,RIGHT, not {text!r}")
    if len(set(ids)) < len(ids):
        raise ToktError(f"the left and the right camera are both {ids[0]!r}")
    from .live_source import CameraSource

    if prefix == PYMBA:
        from tokt.inference.sources.cameras.vimba.driver import open_drivers
    else:
        from tokt.inference.sources.cameras.genicam.driver import open_drivers
    source = CameraSource(open_drivers(ids, wanted, clock), clock, on_event, wanted.wait)
    source.start()
    return source
