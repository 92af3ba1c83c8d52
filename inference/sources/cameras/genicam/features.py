"""Setting a GenICam camera: what the user asked for, under the names that cameras have for it.

Names are of the Standard Features Naming Convention (SFNC 2), and the older ones that GigE cameras
still have. What was asked for and a camera does not have is refused; a default is left out.
"""

import time
from collections.abc import Iterable
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import PIXEL_FORMATS
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.capture import GIGABIT_BYTES_S, bandwidth_bytes_s

_GIGE = ("GEV", "GigEVision")
_FIXED_RATE = "FixedRate"
_FRAME_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
_PTP_S, _LOOK_S = 15.0, 0.1
_PTP_STATUS = ("PtpStatus", "GevIEEE1588Status")


class GenicamFeatures:
    """The features of one camera, by its ``genicam.genapi.NodeMap``; its name is for messages."""

    def __init__(self, nodes: Any, name: str) -> None:
        from genicam.genapi import EAccessMode, GenericException

        self._nodes = nodes
        self._name = name
        self._readable = (EAccessMode.RO, EAccessMode.RW)
        self._writable = (EAccessMode.WO, EAccessMode.RW)
        self._error = GenericException

    def set_up(self, options: SourceConfig, share: float, link: str) -> None:
        """Set what a user asked for; ToktError if the camera cannot be set so.

        `share` is its part of the bandwidth, `link` how it is connected, as its producer says.
        """
        self.give("AcquisitionMode", "Continuous")
        self._set_pixel_format(options.pixel_format)
        self._set_start(options)
        if options.exposure_us is not None:
            self.give("ExposureAuto", "Off")
            self.give("ExposureMode", "Timed")
            self._set(("ExposureTime", "ExposureTimeAbs"), options.exposure_us, "exposure time")
        if options.gain_db is not None:
            self.give("GainAuto", "Off")
            self._set(("Gain",), options.gain_db, "gain in dB")
        if options.packet_size is not None:
            self._set(("GevSCPSPacketSize",), options.packet_size, "packet size")
        bytes_s = bandwidth_bytes_s(options)
        asked_for = bytes_s != GIGABIT_BYTES_S
        # The default is a gigabit's: a camera on another link has a bandwidth of its own.
        if asked_for or link in _GIGE:
            self._set_bandwidth(bytes_s * share, asked_for)
        if options.ptp:
            self._share_clock()

    def period_s(self) -> float | None:
        """Seconds from one exposure to the next, or None where the camera does not say."""
        if self.value("TriggerMode") == "On" and self.value("TriggerSource") != _FIXED_RATE:
            return None
        names = ("AcquisitionResultingFrameRate", "ResultingFrameRate", *_FRAME_RATES)
        rate = next(filter(None, map(self.value, names)), None)
        return float(1 / rate) if rate else None

    def clock_is_shared(self) -> bool:
        """Whether the camera's clock follows the Precision Time Protocol, as of now."""
        latch = self._node("PtpDataSetLatch", self._writable)
        if latch is not None:
            latch.execute()
        return any(self.value(name) in ("Master", "Slave") for name in _PTP_STATUS)

    def value(self, name: str) -> Any:
        """A feature's value, or None where there is none to be read."""
        node = self._node(name, self._readable)
        return None if node is None else node.value

    def give(self, name: str, value: object) -> bool:
        """Set a feature where there is one that takes the value; whether there is."""
        node = self._node(name, self._writable)
        if node is None or (isinstance(value, str) and value not in getattr(node, "symbolics", ())):
            return False
        node.value = value
        return True

    def _set_pixel_format(self, wanted: str | None) -> None:
        node = self._node("PixelFormat", self._readable)
        if node is None:
            raise ToktError(f"camera {self._name} does not say its pixel format")
        offered = tuple(getattr(node, "symbolics", ()))
        if wanted is None and node.value in PIXEL_FORMATS:
            return
        plain = wanted and wanted.removesuffix("Packed")  # as it is spelt today
        spelt = [name for name in PIXEL_FORMATS if plain in (None, name.removesuffix("Packed"))]
        chosen = next((name for name in spelt if name in offered), None)
        if chosen is None:
            wanted = wanted or "pixel format that tokt reads"
            has = f"it has {', '.join(offered)} (tokt reads {', '.join(PIXEL_FORMATS)})"
            raise ToktError(f"camera {self._name} has no {wanted}; {has}")
        self._set(("PixelFormat",), chosen, "pixel format")

    def _set_start(self, options: SourceConfig) -> None:
        """What starts an exposure."""
        if options.trigger is None and options.camera_rate is None:
            return
        self.give("TriggerSelector", "FrameStart")
        if options.trigger is not None:
            self._set(("TriggerSource",), options.trigger, "trigger")
            self._set(("TriggerMode",), "On", "trigger")
            return
        # GigE cameras of Allied Vision keep a rate only where it is what triggers them.
        fixed = self.give("TriggerSource", _FIXED_RATE)
        self.give("TriggerMode", "On" if fixed else "Off")
        self.give("AcquisitionFrameRateMode", "On")
        self.give("AcquisitionFrameRateEnable", True)
        self.give("AcquisitionFrameRateEnabled", True)
        self._set(_FRAME_RATES, options.camera_rate, "frame rate")

    def _set_bandwidth(self, bytes_s: float, asked_for: bool) -> None:
        """At most what the camera can do, and at least what it must."""
        self.give("DeviceLinkThroughputLimitMode", "On")
        for name in ("DeviceLinkThroughputLimit", "StreamBytesPerSecond"):
            node = self._node(name, self._writable)
            if node is not None:
                lowest = int(node.min)
                step = int(getattr(node, "inc", 1)) or 1
                limited = max(lowest, min(int(bytes_s), int(node.max)))
                node.value = lowest + (limited - lowest) // step * step
                return
        if asked_for:
            raise ToktError(f"camera {self._name} has no bandwidth that could be set")

    def _share_clock(self) -> None:
        """Have its clock set by the Precision Time Protocol, and wait until it is."""
        if not self.give("PtpMode", "Auto"):
            self._set(("PtpEnable", "GevIEEE1588"), True, "Precision Time Protocol")
        until = time.monotonic() + _PTP_S
        while not self.clock_is_shared():
            if time.monotonic() > until:
                raise ToktError(f"camera {self._name}: no clock by PTP in {_PTP_S:g} s")
            time.sleep(_LOOK_S)

    def _set(self, names: Iterable[str], value: Any, what: str) -> None:
        """Set the first of these features that the camera has."""
        for name in names:
            node = self._node(name, self._writable)
            if node is None:
                continue
            try:
                node.value = value
            except (self._error, TypeError) as error:
                # What GenApi says, without the place in its own code.
                said = str(error).partition(" : ")[0].strip().rstrip(".")
                refused = f"camera {self._name} does not take {name} {value}"
                raise ToktError(f"{refused}: {said}") from None
            return
        raise ToktError(f"camera {self._name} has no {what} that could be set ({', '.join(names)})")

    def _node(self, name: str, access: tuple[Any, ...]) -> Any:
        """A feature, or None where the camera has none that can be used so."""
        node = getattr(self._nodes, name, None)
        return node if node is not None and node.get_access_mode() in access else None
