"""The drivers of network video and USB cameras: what their processes are told."""

from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.sources.cameras.capture import CameraDriver
from tokt.inference.sources.cameras.process_driver import ProcessDriver

from .address import VideoAddress


def open_drivers(addresses: Sequence[VideoAddress], clock: Clock) -> list[CameraDriver]:
    """Drivers of a camera, or of a left and a right one; nothing is opened yet.

    ToktError if what reads video is not installed.
    """
    if not (find_spec("av") and find_spec("aiortsp")):
        raise ToktError("network video needs the extra 'video'")
    return [
        ProcessDriver("video", side, at.name, {"address": asdict(at.with_environment())}, clock)
        for side, at in enumerate(addresses)
    ]
