"""Camera options: what a user may ask for, checked before a camera is touched."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import PIXEL_FORMATS

GIGABIT_BYTES_S = 115_000_000.0
"""Image data that one gigabit link carries, in bytes a second: Vimba's own default."""

_MIN_PACKET, _MAX_PACKET = 500, 16_384  # bytes; what GigE cameras' GevSCPSPacketSize spans
_POSITIVE = {
    "exposure_us": "an exposure is a positive number of microseconds",
    "frame_rate": "a frame rate is a positive number of frames per second",
    "bandwidth_bytes_s": "a bandwidth is a positive number of bytes per second",
}


@dataclass(frozen=True)
class CameraOptions:
    """Settings of both cameras; None leaves a camera as it is.

    A camera that has no such setting refuses what was asked for, and takes no notice of defaults.

    Parameters
    ----------
    exposure_us : float, optional
        Exposure time in microseconds; the camera's own control of it is switched off.
    gain_db : float, optional
        Gain in dB; the camera's own control of it is switched off.
    pixel_format : str, optional
        One of `tokt.features.frames.camera_frame.PIXEL_FORMATS`. By default the camera's own where
        it is one of these, otherwise the first of these that it has.
    packet_size : int, optional
        Bytes of a packet of a GigE camera. By default the largest that the network lets through.
    bandwidth_bytes_s : float
        Bytes a second that all cameras send together: two on one link get half of it each. A
        camera that cannot send as fast is set to what it can.
    frame_rate : float, optional
        Frames a second.
    trigger : str, optional
        What starts each exposure, as the camera calls it (``Line1``). Two cameras see the same
        moment only where something starts both.
    ptp : bool
        Whether the cameras' clocks are to be set by the Precision Time Protocol. Otherwise the
        difference between them is estimated (`pairing`).
    wait : bool
        Whether a camera that is not there at the start is waited for, like one that is lost later.

    Raises
    ------
    ToktError
        If one of them cannot be meant.
    """

    exposure_us: float | None = None
    gain_db: float | None = None
    pixel_format: str | None = None
    packet_size: int | None = None
    bandwidth_bytes_s: float = GIGABIT_BYTES_S
    frame_rate: float | None = None
    trigger: str | None = None
    ptp: bool = False
    wait: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            positive = _POSITIVE.get(field.name)
            if positive and value is not None and not 0 < value < math.inf:
                raise ToktError(f"{positive}, not {value}")
        if self.gain_db is not None and not math.isfinite(self.gain_db):
            raise ToktError(f"a gain is a number of dB, not {self.gain_db}")
        if self.pixel_format is not None and self.pixel_format not in PIXEL_FORMATS:
            known = ", ".join(PIXEL_FORMATS)
            raise ToktError(f"unknown pixel format {self.pixel_format!r} (choose from {known})")
        size = self.packet_size
        if size is not None and not _MIN_PACKET <= size <= _MAX_PACKET:
            raise ToktError(f"a packet has {_MIN_PACKET} to {_MAX_PACKET} bytes, not {size}")
        if self.trigger is not None and not self.trigger.isidentifier():
            raise ToktError(f"a trigger is a name such as Line1, not {self.trigger!r}")
        if self.trigger is not None and self.frame_rate is not None:
            raise ToktError("choose a trigger or a frame rate: a triggered camera keeps no rate")
