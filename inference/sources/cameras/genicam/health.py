"""The doctor's check of GenICam cameras: harvesters, the vendors' producers, their cameras."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from tokt.features.common.errors import ToktError
from tokt.features.common.finding import FAULT, NOTE, OK, Finding

from .listing import list_cameras
from .producers import producer_files

NAME = "genicam cameras"
_TIMEOUT_S = 30.0


def genicam_finding(timeout_s: float = _TIMEOUT_S) -> Finding:
    """The GenICam cameras that there are, or what is missing.

    Looked for in another process: producers are native code of the vendors.

    Parameters
    ----------
    timeout_s : float
        How long the producers may take, in seconds.
    """
    try:
        harvesters = f"harvesters {version('harvesters')} with genicam {version('genicam')}"
    except PackageNotFoundError as error:
        return Finding(NAME, NOTE, f"no {error.name}; GenICam cameras need tokt[genicam]")
    try:
        producer_files()
    except ToktError as error:
        return Finding(NAME, NOTE, f"{harvesters}, but {error}")
    try:
        listing = list_cameras(timeout_s)
    except ToktError as error:
        return Finding(NAME, FAULT, f"{harvesters}: {error}")
    figures = {
        "producers": list(listing.producers),
        "cameras": [camera.place.device for camera in listing.cameras],
    }
    sound = listing.cameras and not listing.complaints
    state = OK if sound else FAULT if listing.complaints else NOTE
    return Finding(NAME, state, f"{harvesters}: {listing.in_words()}", figures)
