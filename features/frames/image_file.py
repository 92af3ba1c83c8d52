"""Read one image file whole, or say why not.

OpenCV decodes a truncated JPEG without complaint: the missing part comes out flat gray, which
a texture model takes for open water. So the end of the image is looked for before decoding.
"""

import hashlib
import re
from pathlib import Path

import cv2
import numpy as np

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, os_errors_as

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".ppm"})

_JPEG_START = b"\xff\xd8"
_JPEG_SCAN = 0xDA
_JPEG_END = 0xD9
# In entropy-coded data FF 00 is a stuffed byte, FF D0..D7 a restart and FF FF a fill byte.
_JPEG_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_PNG_START = b"\x89PNG\r\n\x1a\n"
_MAX_PIXELS = 100_000_000
"""No camera gives more, and a PNG of some kilobytes can say that it does."""


def _jpeg_is_whole(data: bytes) -> bool:
    """Walk the segments of a JPEG to its end-of-image marker (ITU-T T.81, annex B)."""
    position = 2
    while position + 4 <= len(data) or data[position : position + 2] == b"\xff\xd9":
        if data[position] != 0xFF:
            return False
        marker = data[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        if marker == _JPEG_END:
            return True
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == _JPEG_SCAN:
            found = _JPEG_MARKER.search(data, position)
            if found is None:
                return False
            position = found.start()
    return False


def _png_is_whole(data: bytes) -> bool:
    """Walk the chunks of a PNG to its IEND chunk (PNG specification, section 5)."""
    position = len(_PNG_START)
    while position + 12 <= len(data):
        if data[position + 4 : position + 8] == b"IEND":
            return True
        position += 12 + int.from_bytes(data[position : position + 4], "big")
    return False


def _png_pixels(data: bytes) -> int:
    """Width times height from the header (PNG specification, section 11.2.2)."""
    return int.from_bytes(data[16:20], "big") * int.from_bytes(data[20:24], "big")


def decode_image(data: bytes, name: str) -> U8:
    """Decode an image as the camera gave it.

    Parameters
    ----------
    data : bytes
        A whole image file.
    name : str
        What to call it in an error.

    Returns
    -------
    numpy.ndarray
        uint8, (height, width) for a gray file or (height, width, 3) in BGR order.

    Raises
    ------
    FrameError
        If the file is empty, truncated or not an image.
    """
    if not data:
        raise FrameError(f"{name}: the file is empty")
    if data.startswith(_JPEG_START) and not _jpeg_is_whole(data):
        raise FrameError(f"{name}: the JPEG is truncated")
    if data.startswith(_PNG_START) and not _png_is_whole(data):
        raise FrameError(f"{name}: the PNG is truncated")
    if data.startswith(_PNG_START) and _png_pixels(data) > _MAX_PIXELS:
        raise FrameError(f"{name}: the PNG says that it has {_png_pixels(data)} pixels")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR)
    except cv2.error as error:
        raise FrameError(f"{name}: cannot be decoded ({error.err})") from None
    if image is None:
        raise FrameError(f"{name}: not an image that can be decoded")
    return np.asarray(image, np.uint8)


def read_image(path: Path) -> U8:
    """Read and decode one file; see `decode_image`.

    Raises
    ------
    FrameError
        If the file cannot be read, or `decode_image` refuses it.
    """
    with os_errors_as(str(path), FrameError):
        data = path.read_bytes()
    return decode_image(data, str(path))


def pixel_sha256(image: U8) -> str:
    """SHA-256 (hex) of an image's shape and pixels, however its file was compressed."""
    digest = hashlib.sha256(repr(image.shape).encode("ascii"))
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
