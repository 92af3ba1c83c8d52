"""PNG files whose sums fit and whose content does not."""

from __future__ import annotations

import struct
import zlib
from functools import cache
from random import Random

import cv2
import numpy as np

_START = b"\x89PNG\r\n\x1a\n"
_SIDES = (0, 1, 2, 3, 7, 35, 37, 1000, 30_000, 65_535, 1_000_000, 0x7FFFFFFF, 0xFFFFFFFF)


def chunk(kind: bytes, data: bytes) -> bytes:
    """One chunk with its length and sum."""
    return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))


def png(width: int, height: int, depth: int, colour: int, interlaced: int, pixels: bytes) -> bytes:
    """A PNG file of one IDAT chunk that holds `pixels`, deflated already."""
    head = struct.pack(">LLBBBBB", width, height, depth, colour, 0, 0, interlaced)
    return _START + chunk(b"IHDR", head) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


@cache
def _zeros(megabytes: int) -> bytes:
    packer = zlib.compressobj(9)
    block = bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(megabytes)) + packer.flush()


def bomb(rng: Random) -> bytes:
    """A small file that says it is a huge picture; some hold all of its pixels."""
    side, depth, colour = rng.choice(((12_000, 8, 0), (20_000, 16, 2), (60_000, 1, 0)))
    return png(side, side, depth, colour, 0, _zeros(140) if side == 12_000 else _zeros(1))


def some_picture(rng: Random) -> bytes:
    """A sound PNG of a size, depth and number of channels that no camera gives."""
    height, width = rng.choice(
        ((1, 1), (1, 300), (300, 1), (3, 3), (8, 12), (9, 9), (33, 48), (90, 120), (5, 1000))
    )
    channels = rng.choice((1, 1, 3, 4))
    kind = rng.choice((np.uint8, np.uint8, np.uint16))
    shape = (height, width) if channels == 1 else (height, width, channels)
    pixels = np.random.default_rng(rng.randrange(2**32)).integers(0, 255, shape).astype(kind)
    return cv2.imencode(".png", pixels)[1].tobytes()


def changed_png(data: bytes, rng: Random) -> bytes:
    """Another picture, or this one with a header or chunks that do not fit, the sums made to."""
    kind = rng.randrange(6)
    if kind == 0:
        return some_picture(rng)
    if kind == 1:
        head = bytearray(data[16:29])
        field = rng.randrange(8)
        if field < 2:
            head[4 * field : 4 * field + 4] = struct.pack(">L", rng.choice(_SIDES))
        else:
            head[6 + min(field, 6)] = rng.choice((0, 1, 2, 3, 4, 6, 7, 8, 16, 255))
        return _START + chunk(b"IHDR", bytes(head)) + data[33:]
    if kind == 2:
        extra = rng.choice((b"tEXt", b"acTL", b"eXIf", b"PLTE", b"tRNS", b"iCCP", b"IHDR", b"IDAT"))
        body = rng.randbytes(rng.choice((0, 1, 3, 8, 300)))
        return data[:33] + chunk(extra, body) + data[33:]
    if kind == 3:
        return data[:33] + chunk(b"IDAT", zlib.compress(rng.randbytes(64))) + data[-12:]
    if kind == 4 and rng.random() < 0.05:
        return bomb(rng)
    at = rng.randrange(8, len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
