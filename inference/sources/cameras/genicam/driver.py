"""The driver of one GenICam camera: what its process is told.

When `deliver` is slow the camera's process waits, and its producer overwrites what nobody took.
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.config import SourceConfig
from tokt.inference.sources.cameras.capture import CameraDriver, Deliver
from tokt.inference.sources.cameras.process_driver import ProcessDriver

from .producers import ListedCamera, Place, check_installed, is_index, list_cameras


class GenicamDriver(ProcessDriver):
    """A `CameraDriver` through harvesters. Without a place it is looked for by its name at start.

    `share` is its part of the bandwidth.
    """

    kind = "cameras.genicam"

    def __init__(
        self,
        camera: int,
        name: str,
        place: Place | None,
        options: SourceConfig,
        share: float,
        clock: Clock,
        open_s: float = ProcessDriver.open_s,
    ) -> None:
        order = {
            "name": name,
            "place": None if place is None else asdict(place),
            "options": asdict(options),
            "share": share,
        }
        super().__init__(camera, name, order, clock, open_s)

    def start(self, deliver: Deliver) -> None:
        """Start the camera's process, and wait until it sends; ToktError as `ProcessDriver`."""
        check_installed()
        super().start(deliver)

    def answered(self, answer: dict[str, Any]) -> None:
        """Look for it at the same place from now on."""
        self.order["place"] = answer["place"]


def open_drivers(ids: Sequence[str], options: SourceConfig, clock: Clock) -> list[CameraDriver]:
    """Drivers of the cameras that a user named: left, and right where there are two.

    Parameters
    ----------
    ids : sequence of str
        Each a camera's device ID, serial number or name, or its index in what the producers list.
        An index is looked up now and never again: with a camera unplugged it would be another's.
    options : SourceConfig
    clock : Clock

    Raises
    ------
    ToktError
        If there is no such camera, saying which there are, unless it is to be waited for; if two
        are the same; or if nothing is installed that could drive one.
    """
    listing = list_cameras()
    found: list[ListedCamera | None] = []
    for text in ids:
        try:
            found.append(listing.camera(text))
        except ToktError:
            # A number would be whichever camera is first to come.
            if not options.wait or is_index(text):
                raise
            found.append(None)
    known = [camera.place for camera in found if camera is not None]
    if len(set(known)) < len(known) or len(set(ids)) < len(ids):
        raise ToktError(f"{' and '.join(ids)} are the same camera: {listing.in_words()}")
    share = 1 / len(ids)
    return [
        GenicamDriver(side, text, camera.place if camera else None, options, share, clock)
        for side, (text, camera) in enumerate(zip(ids, found, strict=True))
    ]
