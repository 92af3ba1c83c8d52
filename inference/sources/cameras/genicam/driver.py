"""The drivers of GenICam cameras: what their processes are told.

When `deliver` is slow the camera's process waits, and its producer overwrites what nobody took.
"""

from collections.abc import Sequence
from dataclasses import asdict

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.capture import CameraDriver
from tokt.inference.sources.cameras.process_driver import ProcessDriver

from .producers import is_index, list_cameras


def open_drivers(ids: Sequence[str], options: SourceConfig, clock: Clock) -> list[CameraDriver]:
    """Drivers of the cameras that a user named: left, and right where there are two.

    Each by its device ID, serial number or name, or its index in what the producers list. An index
    is looked up now and never again: with a camera unplugged it would be another's.

    ToktError if there is no such camera, saying which there are, unless it is to be waited for; if
    two are the same; or if nothing is installed that could drive one.
    """
    listing = list_cameras()
    places: list[dict[str, str] | None] = []
    for text in ids:
        try:
            places.append(asdict(listing.camera(text).place))
        except ToktError:
            # A number would be whichever camera is first to come.
            if not options.wait or is_index(text):
                raise
            places.append(None)
    if len(set(ids)) < len(ids) or any(at and places.count(at) > 1 for at in places):
        raise ToktError(f"{' and '.join(ids)} are the same camera: {listing.in_words()}")
    told = {"options": asdict(options), "share": 1 / len(ids)}
    return [
        ProcessDriver("cameras.genicam", side, text, {**told, "name": text, "place": place}, clock)
        for side, (text, place) in enumerate(zip(ids, places, strict=True))
    ]
