"""Cameras through harvesters and the GenTL producers of their vendors (``genicam:ID[,ID]``)."""

from __future__ import annotations

from collections.abc import Sequence

from ...features.errors import ToktError
from ..clock import Clock
from .capture import CameraDriver
from .genicam_driver import GenicamDriver
from .genicam_listing import Listed, is_index, list_cameras
from .options import CameraOptions


def open_drivers(ids: Sequence[str], options: CameraOptions, clock: Clock) -> list[CameraDriver]:
    """Drivers of the cameras that a user named: left, and right where there are two.

    Parameters
    ----------
    ids : sequence of str
        Each a camera's device ID, serial number or name, or its index in what the producers list.
        An index is looked up now and never again: with a camera unplugged it would be another's.
    options : CameraOptions
    clock : Clock

    Raises
    ------
    ToktError
        If there is no such camera, saying which there are, unless it is to be waited for; if two
        are the same; or if nothing is installed that could drive one.
    """
    listing = list_cameras()
    found: list[Listed | None] = []
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
