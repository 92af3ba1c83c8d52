"""Read one image file whole, or say why not.

OpenCV decodes a truncated JPEG without complaint: the missing part comes out flat gray, which
a texture model takes for open water. So the end of the image is looked for before decoding.

A frame has 8 bits. 16 are seen by their upper 8, always alike: a scale taken from a frame's own
levels would differ from frame to frame. What that would make nearly black is refused.
"""

import hashlib
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8
from tokt.features.common.errors import FrameError, os_errors_as
from tokt.features.common.held_files import file_bytes

SUFFIXES = frozenset(
    {".jpg", ".jpeg", ".jfif", ".png", ".bmp", ".tif", ".tiff", ".pgm", ".ppm"}
    | {".webp", ".jp2", ".gif"}
)
OTHER_PICTURES = frozenset(
    {".heic", ".heif", ".avif", ".jxl", ".dng", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".orf"}
    | {".rw2", ".raf", ".psd", ".exr", ".tga"}
)
"""Endings of pictures that OpenCV does not read: told where they lie among frames."""

_JPEG_START = b"\xff\xd8"
_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # headers with the picture's size
_JPEG_SCAN = 0xDA
_JPEG_END = 0xD9
# In entropy-coded data FF 00 is a stuffed byte, FF D0..D7 a restart and FF FF a fill byte.
_JPEG_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_PNG_START = b"\x89PNG\r\n\x1a\n"
_SHOWN_OTHERWISE = {b"tRNS", b"acTL", b"eXIf"}
"""PNG chunks by which a browser may show something else: transparency, animation, a turn."""
_PNM_MAXIMUM = re.compile(rb"P[2356](?:(?:\s|#[^\r\n]*[\r\n])+(\d{1,9})){3}")
_FEW_BITS_GREY = 16
"""12 bits in 16 reach this grey level at most (OpenCV rounds some); what stays below is dark."""
_REMEDY = "convert it to 8 bits, all files alike (12-bit levels: divided by 16)"
_MAX_PIXELS = 100_000_000  # no camera gives more, and a file of some kilobytes can say that it does


def _jpeg_fault(data: bytes) -> str:
    """Walk the segments of a JPEG to its end-of-image marker (ITU-T T.81, annex B)."""
    position = 2
    while position + 4 <= len(data) or data[position : position + 2] == b"\xff\xd9":
        if data[position] != 0xFF:
            break
        marker = data[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        if marker == _JPEG_END:
            return ""
        if marker in _JPEG_FRAMES and (pixels := _product(data, position + 5, 2)) > _MAX_PIXELS:
            return f"the JPEG says that it has {pixels} pixels"
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if marker == _JPEG_SCAN:
            found = _JPEG_MARKER.search(data, position)
            if found is None:
                break
            position = found.start()
    return "the JPEG is truncated"


def _png_chunks(data: bytes) -> set[bytes]:
    """Names of a PNG's chunks, with IEND where it is whole (PNG specification, section 5)."""
    position, names = len(_PNG_START), set()
    while position + 12 <= len(data) and b"IEND" not in names:
        names.add(data[position + 4 : position + 8])
        position += 12 + int.from_bytes(data[position : position + 4], "big")
    return names


def _product(data: bytes, at: int, size: int) -> int:
    """Width times height, two numbers of so many bytes."""
    first, second = data[at : at + size], data[at + size : at + 2 * size]
    return int.from_bytes(first, "big") * int.from_bytes(second, "big")


def decode_image(data: bytes, name: str) -> U8:
    """Decode an image as the camera gave it, turned as its EXIF says.

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
        If the file is empty, truncated or not an image; or if its levels are not of 8 or 16 bits,
        or of 16 of which no pixel uses the upper ones.
    """
    if not data:
        raise FrameError(f"{name}: the file is empty")
    if data.startswith(_JPEG_START) and (fault := _jpeg_fault(data)):
        raise FrameError(f"{name}: {fault}")
    if data.startswith(_PNG_START) and b"IEND" not in _png_chunks(data):
        raise FrameError(f"{name}: the PNG is truncated")
    if data.startswith(_PNG_START) and (pixels := _product(data, 16, 4)) > _MAX_PIXELS:
        raise FrameError(f"{name}: the PNG says that it has {pixels} pixels")
    maximum = _PNM_MAXIMUM.match(data)
    if maximum and int(maximum[1]) not in (255, 65535):
        words = f"{int(maximum[1])}, not 255 or 65535"
        raise FrameError(f"{name}: its brightest level is {words}; {_REMEDY}")
    image = _decoded(data, name, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
    if image.dtype == np.uint8:
        return np.asarray(image, np.uint8)
    if image.itemsize != 2:
        raise FrameError(f"{name}: its pixels are {image.dtype}; {_REMEDY}")
    levels = int(image.max()) >> 8
    image = np.asarray(_decoded(data, name, cv2.IMREAD_ANYCOLOR), np.uint8)
    # OpenCV gives levels of some TIFFs wrong at their full depth, of others upside down.
    check_bits(min(levels, int(image.max())), name)
    return image


def _decoded(data: bytes, name: str, way: int) -> NDArray[Any]:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), way)
    except cv2.error as error:
        raise FrameError(f"{name}: cannot be decoded ({error.err})") from None
    if image is None:
        raise FrameError(f"{name}: not an image that can be decoded")
    return image


def check_bits(brightest: int, name: str) -> None:
    """Refuse a picture of 16 bits that is nearly black by its upper 8: others may hold it.

    FrameError if its brightest grey level, of 0 to 255, is what 12 bits can reach.
    """
    if brightest <= _FEW_BITS_GREY:
        words = "leave the upper bits empty, and would be nearly black"
        raise FrameError(f"{name}: its 16-bit pixels {words}; {_REMEDY}")


def is_shown_alike(data: bytes) -> bool:
    """Whether browsers show a whole JPEG or PNG by the very pixels that `decode_image` gives."""
    if not data.startswith(_PNG_START):
        return data.startswith(_JPEG_START)
    depth, colour_type = data[24], data[25]
    return depth <= 8 and colour_type <= 3 and not _png_chunks(data) & _SHOWN_OTHERWISE


def read_image(path: Path) -> U8:
    """Read and decode one file; FrameError if it cannot be read, or as `decode_image`."""
    with os_errors_as(str(path), FrameError):
        data = file_bytes(path)
    return decode_image(data, str(path))


def pixel_sha256(image: U8) -> str:
    """SHA-256 (hex) of an image's shape and pixels, however its file was compressed."""
    digest = hashlib.sha256(repr(image.shape).encode("ascii"))
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
