"""Zip, npz and PNG files as no honest program writes them: sums that fit, content that does not."""

import io
import struct
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from functools import cache
from random import Random
from typing import Any

import cv2
import numpy as np

from tests.models.parts import unpack

from .changes import chance, changed_bytes

_WORDS = (0, 1, 2, 8, 9, 12, 14, 20, 45, 93, 99, 255, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF)
_LONGS = (0, 1, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF, 1 << 26, (1 << 26) + 1)
_FIELDS = {
    b"PK\3\4": "4:H 6:H 8:H 10:H 12:H 14:L 18:L 22:L 26:H 28:H",
    b"PK\1\2": "4:H 6:H 8:H 10:H 16:L 20:L 24:L 28:H 30:H 32:H 34:H 36:H 38:L 42:L",
    b"PK\5\6": "4:H 6:H 8:H 10:H 12:L 16:L 20:H",
}
"""Fields of a zip's three records, by offset and width (PKWARE's APPNOTE.TXT, 4.3.7 to 4.3.16)."""
_NAMES = ("../" * 12 + "evil", "/tmp/tokt-fuzz-evil", "C:\\evil", "\0", "", "a\nb")
_NAMES += ("signature.json", "distribution.npz")
_BEFORE = ("../", "/", "..\\..\\", "./", "ø", "\ufffe", "__MACOSX/._")


def zip_bytes(members: Mapping[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def _odd_name(name: str, rng: Random) -> str:
    before = [start + name for start in _BEFORE]
    after = (f"{name}\0.txt", f"{name}/", name.upper(), (name * 3000)[:0xFFFF])
    return rng.choice((*_NAMES, *before, *after))


def _odd_members(members: Mapping[str, bytes], rng: Random) -> list[tuple[zipfile.ZipInfo, bytes]]:
    found = [(zipfile.ZipInfo(name), data) for name, data in members.items()]
    place, kind = rng.randrange(len(found)), rng.randrange(16)
    info, data = found[place]
    if kind < 2:
        info.filename = _odd_name(info.filename, rng)
    elif kind == 2:
        found.append((zipfile.ZipInfo(info.filename), rng.choice((data, b"{}"))))
    elif kind == 3:
        del found[place]
    elif kind == 4:
        rng.shuffle(found)
    elif kind == 5:
        count = rng.choice((10, 10, 300, 300, 3000))
        found += [(zipfile.ZipInfo(str(number)), b"") for number in range(count)]
    elif kind == 6:
        wide = [rng.choice((0, 1, 2**32, 2**63, 2**64 - 1)) for _ in range(3)]
        info.extra = rng.choice((struct.pack("<HHQQQ", 1, 24, *wide), rng.randbytes(60), b"\1"))
    elif kind < 9:
        info.compress_type = zipfile.ZIP_DEFLATED
        if chance(rng, 10):
            data = bytes(96 << 20)  # a bomb
        found[place] = info, rng.choice((data, b""))
    return found


def _odd_row(listed: list[zipfile.ZipInfo], rng: Random) -> None:
    """Have the directory leave out a member, or say of it what its own header does not."""
    place, kind = rng.randrange(len(listed)), rng.randrange(6)
    if kind == 0:
        del listed[place]
    elif kind == 1:  # over the bytes of others
        for info in listed[place:]:
            info.header_offset = listed[place].header_offset
    elif kind < 4:
        setattr(listed[place], ("file_size", "CRC")[kind - 2], rng.choice((*_WORDS, *_LONGS)))


def changed_zip(members: Mapping[str, bytes], rng: Random) -> bytes:
    out = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w") as archive:
        warnings.simplefilter("ignore")  # of names that are there twice
        for info, data in _odd_members(members, rng):
            archive.writestr(info, data)
        if archive.filelist:
            _odd_row(archive.filelist, rng)
        if chance(rng, 10):
            archive.comment = rng.choice((b"x" * 65000, b"PK\5\6" * 10, b"\0"))
    found = bytearray(out.getvalue())
    for _ in range(rng.choice((0, 1, 1, 2, 3))):
        record = rng.choice(list(_FIELDS))
        at, width = rng.choice(_FIELDS[record].split()).split(":")
        # Not those of a zip that is a member itself: its sum would tell.
        after = rng.randrange(archive.start_dir, len(found))
        begins = [info.header_offset for info in archive.filelist] or [0]
        start = rng.choice(begins) if record == b"PK\3\4" else found.find(record, after)
        if 0 <= start <= len(found) - int(at) - 4:
            number = rng.choice((*_WORDS, *_LONGS) if width == "L" else _WORDS)
            struct.pack_into(f"<{width}", found, start + int(at), number)
    data = bytes(found)
    return rng.choice((data, data, data, b"MZ" + data, data + b"\0" * 30, data + data))


_HEADERS = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '<f8', 'fortran_order': True, 'shape': (%s, %s), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '|V%s', 'fortran_order': False, 'shape': (2,), }",
    "{'descr': '<U%s', 'fortran_order': False, 'shape': (2,), }",
    "{'descr': [('a', '<f8'), ('b', '|O')], 'fortran_order': False, 'shape': (%s,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (), }",
    "{'descr': '>f8', 'fortran_order': 0, 'shape': [%s], }",
    "{'descr': '<f8', 'shape': (%s,)}",
    "{'descr': '<M8[%s]', 'fortran_order': False, 'shape': (1,), }",
    "__import__('os').system('touch /tmp/tokt-fuzz-evil')",
    "[" * 900 + "%s",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), } # \0",
    "(" + "-" * 3000 + "1,)",
)
_COUNTS = ("0", "1", "-1", "2", "100", str(2**31), str(2**40), str(2**62), str(2**64), "1" * 4500)
_COUNTS += ("1.5", "None", "'a'", "True", "10**9", "1e3", "(1,)")
_VALUES = (0.0, -0.0, 1e-320, 1e308, -1e308, float("nan"), float("inf"), -float("inf"), 1.0)
_TYPES = ("<f4", ">f8", "<i8", "|b1", "|u1", "<u8", "<c16", "O", "<U3", "<M8[s]", "<f8")
_SHAPES = ((-1,), (1, -1), (-1, 1), (1, 1, -1), (-1, 1, 1, 1))


def npz_bytes(arrays: Mapping[str, Any]) -> bytes:
    return zip_bytes({f"{name}.npy": _npy_bytes(array) for name, array in arrays.items()})


def _npy_bytes(array: Any) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array))
    return out.getvalue()


def _with_header(data: bytes, rng: Random) -> bytes:
    text = rng.choice(_HEADERS)
    text = text % tuple(rng.choice(_COUNTS) for _ in range(text.count("%s")))
    header = (text + "\n").encode("latin-1")
    version = rng.choice(((1, 0), (1, 0), (2, 0), (3, 0), (9, 9)))
    length = rng.choice((len(header), len(header), len(header), 0, 0xFFFF, 10))
    packed = struct.pack("<H" if version == (1, 0) else "<L", length & 0xFFFF)
    return b"\x93NUMPY" + bytes(version) + packed + header + data[-64:]


def _other_array(array: Any, rng: Random) -> Any:
    match rng.randrange(6):
        case 0:
            with np.errstate(all="ignore"):
                return array.astype(rng.choice(_TYPES))
        case 1:
            return array.reshape(rng.choice(_SHAPES))
        case 2:
            return array[:0] if array.ndim and chance(rng, 50) else array.ravel()[:-1]
        case 3:
            return np.concatenate([array, array]) if array.ndim else array
        case 4:
            return np.asfortranarray(np.broadcast_to(array, (2, *array.shape)).copy())
    flat = array.ravel().copy()
    if flat.size:
        at = rng.randrange(flat.size)
        if flat.dtype.kind == "f":
            flat[at] = rng.choice((*_VALUES, flat[at] * 1.0000001, -flat[at]))
        elif flat.dtype.kind in "iu":
            most = int(np.iinfo(flat.dtype).max)
            flat[at] = rng.choice((0, 1, most, most // 2, int(flat[at]) ^ 1))
        else:
            flat[at] = not flat[at]
    return flat.reshape(array.shape)


def changed_npz(data: bytes, rng: Random) -> bytes:
    sound = unpack(data)
    arrays = dict(sound)
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(list(sound))
        kind = rng.randrange(12)
        if kind < 4:
            arrays[name] = _with_header(sound[name], rng)
        elif kind < 8:
            array = np.lib.format.read_array(io.BytesIO(sound[name]))
            arrays[name] = _npy_bytes(_other_array(array, rng))
        elif kind == 8:
            arrays[name] = changed_bytes(sound[name], rng, list(sound.values()))
        elif kind == 9 and len(arrays) > 1:
            arrays.pop(name, None)
        elif kind == 10:
            arrays[rng.choice(("more.npy", "../evil.npy", "weights", ""))] = sound[name]
        else:
            return changed_zip(arrays, rng)
    return zip_bytes(arrays)


@cache
def _zeros(megabytes: int) -> bytes:
    packer, block = zlib.compressobj(9), bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(megabytes)) + packer.flush()


_START = b"\x89PNG\r\n\x1a\n"
_SIDES = (0, 1, 2, 3, 7, 35, 37, 1000, 30_000, 65_535, 1_000_000, 0x7FFFFFFF, 0xFFFFFFFF)
_SIZES = ((1, 1), (1, 300), (300, 1), (3, 3), (8, 12), (9, 9), (33, 48), (90, 120), (5, 1000))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))


def _bomb(rng: Random) -> bytes:
    """A small file that says it is a huge picture; some hold all of its pixels."""
    side, depth, colour = rng.choice(((12_000, 8, 0), (20_000, 16, 2), (60_000, 1, 0)))
    head = struct.pack(">LLBBBBB", side, side, depth, colour, 0, 0, 0)
    pixels = _zeros(140 if side == 12_000 else 1)
    return _START + _chunk(b"IHDR", head) + _chunk(b"IDAT", pixels) + _chunk(b"IEND", b"")


def some_picture(rng: Random) -> bytes:
    """A sound PNG of a size, depth and number of channels that no camera gives."""
    channels = rng.choice((1, 1, 3, 4))
    shape = rng.choice(_SIZES) + ((channels,) if channels > 1 else ())
    pixels = np.random.default_rng(rng.randrange(2**32)).integers(0, 255, shape)
    kind = rng.choice((np.uint8, np.uint8, np.uint16))
    return cv2.imencode(".png", pixels.astype(kind))[1].tobytes()


def changed_png(data: bytes, rng: Random) -> bytes:
    """Another picture, or this one with a header or chunks that do not fit, the sums made to."""
    kind = rng.randrange(6)
    if kind == 0:
        return some_picture(rng)
    if kind == 1:
        head, at = bytearray(data[16:29]), rng.randrange(8)
        if at < 2:
            head[4 * at : 4 * at + 4] = struct.pack(">L", rng.choice(_SIDES))
        else:
            head[6 + min(at, 6)] = rng.choice((0, 1, 2, 3, 4, 6, 7, 8, 16, 255))
        return _START + _chunk(b"IHDR", bytes(head)) + data[33:]
    if kind == 2:
        extra = rng.choice((b"tEXt", b"acTL", b"eXIf", b"PLTE", b"tRNS", b"iCCP", b"IHDR", b"IDAT"))
        body = rng.randbytes(rng.choice((0, 1, 3, 8, 300)))
        return data[:33] + _chunk(extra, body) + data[33:]
    if kind == 3:
        return data[:33] + _chunk(b"IDAT", zlib.compress(rng.randbytes(64))) + data[-12:]
    if kind == 4 and chance(rng, 5):
        return _bomb(rng)
    at = rng.randrange(8, len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
