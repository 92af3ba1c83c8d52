"""Open live cameras as a user names them: ``pymba:ID[,ID]`` or ``genicam:ID[,ID]``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.events import Event

if TYPE_CHECKING:
    from .live_source import CameraSource
    from .options import CameraOptions

PYMBA, GENICAM = "pymba:", "genicam:"


def is_camera_source(text: str) -> bool:
    """Whether this names live cameras, and not a folder or a file."""
    return text.startswith((PYMBA, GENICAM))


def open_camera_source(
    text: str, clock: Clock, options: CameraOptions, on_event: Callable[[Event], None]
) -> CameraSource:
    """Open live cameras; they deliver from now on.

    Parameters
    ----------
    text : str
        ``pymba:`` or ``genicam:`` and the left camera's ID; for two a comma and the right one's.
    clock : Clock
    options : CameraOptions
    on_event : callable
        Given each `Event`, on a thread of a camera's.

    Raises
    ------
    ToktError
        If it names no such cameras, what drives them is missing, or they cannot be opened.
    """
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
    source = CameraSource(open_drivers(ids, options, clock), clock, on_event, options.wait)
    source.start()
    return source
