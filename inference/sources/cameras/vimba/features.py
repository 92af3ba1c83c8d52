"""A Vimba camera's features: what a user asked for is set, and what its stream needs.

Names differ from camera to camera: GigE cameras of Allied Vision say ``ExposureTimeAbs`` where
USB ones say ``ExposureTime`` (GigE and USB Features References of Allied Vision).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.camera_frame import PIXEL_FORMATS
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.capture import bandwidth_bytes_s

_EXPOSURE = ("ExposureTimeAbs", "ExposureTime")
_FRAME_RATE = ("AcquisitionFrameRateAbs", "AcquisitionFrameRate")
_PACKET_SIZE = ("GVSPPacketSize", "GevSCPSPacketSize")
_BYTES_S, _LINK_LIMIT = "StreamBytesPerSecond", "DeviceLinkThroughputLimit"
_NS_PER_S = 1e9  # ticks of a camera that does not say how many it has a second: USB ones
_ADJUST_S, _PTP_S, _LOOK_S = 3.0, 15.0, 0.02


@dataclass(eq=False)
class VimbaFeatures:
    """The features of an opened camera, as ``pymba.camera.Camera`` has them."""

    camera: Any
    errors: tuple[type[Exception], ...]
    name: str  # the camera, for messages
    clock: Clock

    def __post_init__(self) -> None:
        self._names = set(self.camera.feature_names())

    def first(self, *names: str) -> str | None:
        """The first of these that the camera has."""
        return next((name for name in names if name in self._names), None)

    def get(self, *names: str) -> Any:
        """The value of the first of these that the camera has, or None."""
        name = self.first(*names)
        return None if name is None else self.camera.feature(name).value

    def entries(self, name: str) -> list[str]:
        """What can be chosen; nothing where the camera has no such feature."""
        return list(self.camera.feature(name).range) if name in self._names else []

    def nearest(self, value: float, name: str) -> int:
        """The whole number at or below a value that a feature can be set to."""
        feature = self.camera.feature(name)
        least, most = map(int, feature.range)
        step = getattr(feature, "step", 1)
        return least + (min(max(round(value), least), most) - least) // step * step

    def demand(self, what: str, value: Any, *names: str) -> None:
        """Set what the user asked for; ToktError if the camera has none of these, or refuses."""
        name = self.first(*names)
        if name is None:
            raise ToktError(f"camera {self.name} has no {' or '.join(names)}: no {what} to set")
        feature = self.camera.feature(name)
        # Some cameras take whole numbers only, where others take any.
        whole = isinstance(value, float) and isinstance(feature.value, int)
        try:
            feature.value = round(value) if whole else value
        except self.errors as error:
            allowed = ", ".join(map(str, feature.range or ()))
            refused = f"camera {self.name} refuses {name} = {value} (it has {allowed})"
            raise ToktError(f"{refused}: {error}") from error

    def offer(self, value: Any, *names: str) -> None:
        """Set what is good to have, where the camera has it."""
        if self.first(*names) is not None:
            self.demand("such thing", value, *names)

    def wait_for(self, done: Callable[[], bool], limit_s: float) -> bool:
        """Whether something comes true before the limit."""
        until = self.clock.monotonic() + limit_s
        while not done():
            if self.clock.monotonic() > until:
                return False
            self.clock.sleep(_LOOK_S)
        return True


def set_features(
    features: VimbaFeatures, options: SourceConfig, share: float
) -> tuple[float, float | None]:
    """Set an opened camera; ToktError if it cannot be set as asked.

    `share` is its part of the bandwidth. Gives the ticks a second of its time stamps, and the
    seconds between exposures, None where no rate was asked for.
    """
    _set_pixel_format(features, options.pixel_format)
    _set_network(features, options, share)
    if options.exposure_us is not None:
        features.offer("Off", "ExposureAuto")
        features.demand("exposure", options.exposure_us, *_EXPOSURE)
    if options.gain_db is not None:
        features.offer("Off", "GainAuto")
        features.demand("gain", options.gain_db, "Gain")
    _set_trigger(features, options)
    if options.ptp:
        features.demand("PTP", "Auto", "PtpMode")
        if not features.wait_for(lambda: features.get("PtpStatus") in ("Master", "Slave"), _PTP_S):
            raise ToktError(f"camera {features.name}: no clock was found by PTP in {_PTP_S:g} s")
    features.demand("acquisition mode", "Continuous", "AcquisitionMode")
    # What a camera that keeps no rate says of its rate is not to be relied on.
    rate = None if options.camera_rate is None else features.get(*_FRAME_RATE)
    ticks_per_s = float(features.get("GevTimestampTickFrequency") or _NS_PER_S)
    return ticks_per_s, 1 / rate if rate else None


def _set_pixel_format(features: VimbaFeatures, asked: str | None) -> None:
    offered = features.entries("PixelFormat")
    if asked is None:
        alike = [pixel_format for pixel_format in PIXEL_FORMATS if pixel_format in offered]
        if features.get("PixelFormat") in alike:
            return
    else:
        # GigE cameras say BGR8Packed where others say BGR8.
        spelt = asked, asked.removesuffix("Packed"), f"{asked}Packed"
        alike = [name for name in spelt if name in offered]
    if not alike:
        wanted = asked or f"of those that tokt reads ({', '.join(PIXEL_FORMATS)})"
        has = ", ".join(offered)
        raise ToktError(f"camera {features.name} has no pixel format {wanted}: it has {has}")
    features.demand("pixel format", alike[0], "PixelFormat")


def _set_network(features: VimbaFeatures, options: SourceConfig, share: float) -> None:
    if options.packet_size is not None:
        features.demand("packet size", options.packet_size, *_PACKET_SIZE)
    elif adjust := features.first("GVSPAdjustPacketSize"):
        camera = features.camera
        camera.run_feature_command(adjust)  # one that takes longer goes on meanwhile
        features.wait_for(lambda: bool(camera.feature_command_is_done(adjust)), _ADJUST_S)
    # The default is a gigabit's: of other cameras than GigE ones only what was asked for is set.
    gige = features.first(*_PACKET_SIZE) is not None
    newer = [_LINK_LIMIT] if gige or options.bandwidth is not None else []
    name = features.first(_BYTES_S, *newer)
    if name is not None:
        features.offer("On", f"{_LINK_LIMIT}Mode")
        bytes_s = features.nearest(bandwidth_bytes_s(options) * share, name)
        features.demand("bandwidth", bytes_s, name)


def _set_trigger(features: VimbaFeatures, options: SourceConfig) -> None:
    if options.trigger is None and options.camera_rate is None:
        return
    features.offer("FrameStart", "TriggerSelector")
    if options.trigger is not None:
        features.demand("trigger", options.trigger, "TriggerSource")
        features.demand("trigger", "On", "TriggerMode")
        return
    # GigE cameras keep a rate only where it is what triggers them; others where it is enabled.
    if "FixedRate" in features.entries("TriggerSource"):
        features.demand("frame rate", "FixedRate", "TriggerSource")
        features.demand("frame rate", "On", "TriggerMode")
    else:
        features.offer("Off", "TriggerMode")
    features.offer(True, "AcquisitionFrameRateEnable")
    features.demand("frame rate", options.camera_rate, *_FRAME_RATE)
