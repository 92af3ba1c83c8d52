"""A GenTL buffer: the picture in it, when it was taken, and whether it is all there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.camera_frame import MOSAIC_FORMATS, PIXEL_FORMATS
from tokt.inference.reason import Fault, Reason

_NS_PER_S = 1_000_000_000
_COLOUR_BYTES = 3
_PART_IS_IMAGE = 1  # GenTL's PART_DATATYPE_2D_IMAGE


class NoPictureError(Exception):
    """A buffer without a picture that can be used.

    Parameters
    ----------
    fault : Fault
    """

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault)
        self.fault = fault


@dataclass(frozen=True)
class Pixels:
    """A picture in a buffer, as the camera gave it.

    Parameters
    ----------
    height, width : int
    pixel_format : str
        One of `tokt.features.frames.camera_frame.PIXEL_FORMATS`.
    data : array of uint8, shape (n_bytes,)
        Without padding. The buffer's own memory wherever that has none: gone when it is queued.
    """

    height: int
    width: int
    pixel_format: str
    data: NDArray[np.uint8]


def pixels_of(buffer: Any, format_name: Callable[[int], str]) -> Pixels:
    """The picture in a raw buffer of harvesters; of one with several parts the first image.

    Not by harvesters' own components: they leave padding in, and raise for a pixel format that
    they do not know without giving the buffer back.

    Parameters
    ----------
    buffer : genicam.gentl.Buffer
    format_name : callable
        The name of a pixel format's number.

    Raises
    ------
    NoPictureError
        If it is not all there, or not of a format that tokt reads.
    """
    image, offset = _image(buffer)
    height, width = int(image.height), int(image.width)
    pixel_format = format_name(
        read_property(image, "pixel_format", read_property(image, "data_format", 0))
    )
    row = width * bytes_per_pixel(pixel_format)
    padding = int(read_property(image, "padding_x", read_property(image, "x_padding", 0)))
    lines = int(read_property(buffer, "delivered_image_height", height)) or height
    size = height * (row + padding)
    filled = read_property(buffer, "size_filled", offset + size)
    if lines < height:
        raise _incomplete(f"{lines} of {height} rows came")
    # The last row's padding may be left out.
    if filled < offset + size - padding:
        raise _incomplete(f"{max(filled - offset, 0)} of {size} bytes came")
    raw = np.frombuffer(buffer.raw_buffer, np.uint8, size - padding, offset)
    if padding:
        rows = np.lib.stride_tricks.as_strided(
            raw, (height, row), (row + padding, 1), writeable=False
        )
        raw = np.ascontiguousarray(rows).reshape(-1)
    return Pixels(height, width, pixel_format, raw)


def _image(buffer: Any) -> tuple[Any, int]:
    """What describes the picture, and where it begins, in bytes."""
    for part in read_property(buffer, "parts", ()):
        if read_property(part, "data_type", 0) == _PART_IS_IMAGE:
            return part, int(read_property(part, "data_offset", 0))
    return buffer, int(read_property(buffer, "image_offset", 0))


def bytes_per_pixel(pixel_format: str) -> int:
    """Bytes a pixel.

    Raises
    ------
    NoPictureError
        If it is not one of the formats that tokt reads.
    """
    if pixel_format not in PIXEL_FORMATS:
        known = ", ".join(PIXEL_FORMATS)
        words = (
            f"the camera sends {pixel_format} pixels, which tokt does not read (it reads {known})"
        )
        raise NoPictureError(Fault(Reason.UNREADABLE, words))
    return 1 if pixel_format in MOSAIC_FORMATS else _COLOUR_BYTES


def _incomplete(words: str) -> NoPictureError:
    return NoPictureError(Fault(Reason.INCOMPLETE, f"incomplete frame: {words}"))


def taken_s(buffer: Any, ticks_per_s: float | None) -> float | None:
    """When it was taken, in seconds of the camera's clock.

    Parameters
    ----------
    buffer : genicam.gentl.Buffer
    ticks_per_s : float or None
        Of the camera's clock, for producers that give its ticks only.

    Returns
    -------
    float or None
        None where the producer does not say, or gives ticks of unknown length.
    """
    # Nanoseconds are GenTL's; a time stamp of 0 is a camera's way to have none.
    nanoseconds = read_property(buffer, "timestamp_ns", 0)
    if nanoseconds:
        return float(nanoseconds / _NS_PER_S)
    ticks = read_property(buffer, "timestamp", 0)
    return float(ticks / ticks_per_s) if ticks and ticks_per_s else None


def read_property(module: Any, name: str, otherwise: Any) -> Any:
    """A property of a GenTL module; `otherwise` where the module does not have it."""
    from genicam.gentl import ClosedException, GenericException, InvalidHandleException

    try:
        return getattr(module, name)
    except AttributeError:
        return otherwise
    except (ClosedException, InvalidHandleException):
        raise
    except GenericException:
        return otherwise
