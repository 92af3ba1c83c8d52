"""Raw pixel data of a camera becomes a frame.

Formats go by their names in the GenICam Pixel Format Naming Convention. A trap: in a Bayer format
GenICam names the first two pixels of the first row, while OpenCV's two-letter names (such as
``COLOR_BayerBG2BGR``) name the second and third pixel of the second row. GenICam's ``BayerRG8`` is
OpenCV's ``BayerBG``, or ``BayerRGGB`` by its four-letter names, which are used here.
"""

import cv2
import numpy as np

from tokt.features.common.arrays import U8

_BAYER = {
    "BayerRG8": cv2.COLOR_BayerRGGB2BGR,
    "BayerGR8": cv2.COLOR_BayerGRBG2BGR,
    "BayerGB8": cv2.COLOR_BayerGBRG2BGR,
    "BayerBG8": cv2.COLOR_BayerBGGR2BGR,
}
_COLOUR = ("BGR8", "BGR8Packed", "RGB8", "RGB8Packed")

MOSAIC_FORMATS = ("Mono8", *_BAYER)
"""Formats of one byte a pixel."""

PIXEL_FORMATS = (*MOSAIC_FORMATS, *_COLOUR)
"""All formats that are known; ``Packed`` is how older cameras spell the same."""

_MIN_MOSAIC_PX = 3  # height and width below which OpenCV gives black instead of colours


def frame_from_camera(
    data: bytes | bytearray | memoryview | U8,
    height: int,
    width: int,
    pixel_format: str,
    given: bool = False,
) -> U8:
    """Copy a camera's pixel data into a frame, with its mosaic interpolated (bilinear).

    Parameters
    ----------
    data : bytes-like or array of uint8
        The pixels row by row, without padding. Never kept unless `given`: a camera's driver writes
        the next frame into the same buffer.
    height, width : int
        In pixels.
    pixel_format : str
        One of `PIXEL_FORMATS`.

    Returns
    -------
    numpy.ndarray
        uint8, shape (height, width) for Mono8, otherwise (height, width, 3) in BGR order.

    Raises
    ------
    ValueError
        If the format is not known, the data are not of exactly the size that it says, or a mosaic
        is under 3 pixels high or wide.
    """
    if pixel_format not in PIXEL_FORMATS:
        known = ", ".join(PIXEL_FORMATS)
        raise ValueError(f"unknown pixel format {pixel_format!r} (known: {known})")
    least = _MIN_MOSAIC_PX if pixel_format in _BAYER else 1
    if min(height, width) < least:
        raise ValueError(f"a {pixel_format} frame of {width}x{height} is too small ({least} px)")
    raw = _pixels(data, height, width, pixel_format)
    if pixel_format in _BAYER:
        return np.asarray(cv2.cvtColor(raw, _BAYER[pixel_format]), np.uint8)
    if pixel_format.startswith("RGB8"):
        return np.asarray(cv2.cvtColor(raw, cv2.COLOR_RGB2BGR), np.uint8)
    return raw if given else raw.copy()


def _pixels(
    data: bytes | bytearray | memoryview | U8, height: int, width: int, pixel_format: str
) -> U8:
    """The data as an array of pixels, still the caller's memory."""
    raw = data if isinstance(data, np.ndarray) else np.frombuffer(data, np.uint8)
    if raw.dtype != np.uint8:
        raise ValueError(f"pixel data are uint8, not {raw.dtype}")
    shape = (height, width, 3) if pixel_format in _COLOUR else (height, width)
    if raw.size != np.prod(shape):
        raise ValueError(
            f"a {pixel_format} frame of {width}x{height} has {np.prod(shape)} bytes, not {raw.size}"
        )
    return np.ascontiguousarray(raw).reshape(shape)
