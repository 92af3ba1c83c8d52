"""Zip files as no honest program writes them.

The layout is written here by hand (PKWARE's APPNOTE.TXT, sections 4.3.7, 4.3.12 and 4.3.16), since
`zipfile` refuses to write most of what is tried.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from random import Random

_LOCAL = struct.Struct("<4sHHHHHLLLHH")
_CENTRAL = struct.Struct("<4sHHHHHHLLLHHHHHLL")
_END = struct.Struct("<4sHHHHLLH")
_WORDS = (0, 1, 2, 8, 9, 12, 14, 20, 45, 93, 99, 255, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF)
_LONGS = (0, 1, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF, 1 << 26, (1 << 26) + 1)
_STORED, _DEFLATED = 0, 8


@dataclass(frozen=True)
class Entry:
    """One member as it will be written: what the two headers say, and the bytes behind."""

    name: bytes
    data: bytes
    method: int = _STORED
    flags: int = 0
    raw: bytes | None = None
    crc: int | None = None
    size: int | None = None
    extra: bytes = b""
    local: Mapping[int, int] = field(default_factory=dict)
    central: Mapping[int, int] = field(default_factory=dict)
    hidden: bool = False
    """Whether it is left out of the central directory."""
    over_the_one_before: bool = False
    """Whether it has no bytes of its own: its directory entry points at those of the one before."""


def entries_of(members: Mapping[str, bytes]) -> list[Entry]:
    """Plain entries."""
    return [Entry(name.encode(), data) for name, data in members.items()]


def _packed(layout: struct.Struct, values: list[int | bytes], changes: Mapping[int, int]) -> bytes:
    """The record with fields changed by position; a value that does not fit is cut."""
    widths = [4 if code == "L" else 2 for code in layout.format.removeprefix("<4s")]
    for position, value in changes.items():
        values[position] = value & ((1 << 8 * widths[position - 1]) - 1)
    return layout.pack(*values)


def zip_bytes(entries: list[Entry], comment: bytes = b"", end: Mapping[int, int] = {}) -> bytes:
    """A zip file of these entries; `end` changes fields of the end record by position."""
    body, directory, listed, offset = b"", b"", 0, 0
    for entry in entries:
        raw = entry.data if entry.raw is None else entry.raw
        crc = zlib.crc32(entry.data) if entry.crc is None else entry.crc
        size = len(entry.data) if entry.size is None else entry.size
        shared: list[int | bytes] = [entry.flags, entry.method, 0, 33, crc, len(raw), size]
        lengths: list[int | bytes] = [len(entry.name), len(entry.extra)]
        if not entry.over_the_one_before:
            offset = len(body)
            head: list[int | bytes] = [b"PK\3\4", 20, *shared, *lengths]
            body += _packed(_LOCAL, head, entry.local) + entry.name + entry.extra + raw
        if not entry.hidden:
            listed += 1
            row: list[int | bytes] = [b"PK\1\2", 20, 20, *shared, *lengths, 0, 0, 0, 0, offset]
            directory += _packed(_CENTRAL, row, entry.central) + entry.name + entry.extra
    tail: list[int | bytes] = [b"PK\5\6", 0, 0, listed, listed, len(directory), len(body)]
    return body + directory + _packed(_END, [*tail, len(comment)], end) + comment


@cache
def _bomb(megabytes: int) -> bytes:
    """So many megabytes of zeros, deflated."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(megabytes)) + packer.flush()


def _deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(6, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush()


_NAMES: tuple[Callable[[bytes], bytes], ...] = (
    lambda name: b"../" + name[:1000],
    lambda name: b"../" * 12 + b"evil",
    lambda name: b"/" + name[:1000],
    lambda name: b"/tmp/tokt-fuzz-evil",
    lambda name: b"..\\..\\" + name[:1000],
    lambda name: b"C:\\evil",
    lambda name: name[:1000] + b"\0.txt",
    lambda name: b"\0",
    lambda name: b"",
    lambda name: name[:1000] + b"/",
    lambda name: b"./" + name[:1000],
    lambda name: name.upper(),
    lambda name: (name * 3000)[:0xFFFF],
    lambda name: b"\xff\xfe" + name[:1000],
    lambda name: "ø".encode() + name[:1000],
    lambda name: b"a\nb",
    lambda name: b"signature.json",
    lambda name: b"distribution.npz",
    lambda name: b"__MACOSX/._" + name[:1000],
)


def _zip64(rng: Random) -> bytes:
    """The extra field that holds sizes of 64 bits."""
    return struct.pack(
        "<HHQQQ", 1, 24, *(rng.choice((0, 1, 2**32, 2**63, 2**64 - 1)) for _ in "abc")
    )


def _any(rng: Random) -> int:
    return rng.choice((*_WORDS, *_LONGS))


_ODD: tuple[Callable[[Entry, Random], Entry], ...] = (
    lambda entry, rng: replace(entry, name=rng.choice(_NAMES)(entry.name)),
    lambda entry, rng: replace(entry, name=rng.choice(_NAMES)(entry.name)),
    lambda entry, rng: replace(entry, central={rng.randrange(1, 17): _any(rng)}),
    lambda entry, rng: replace(entry, central={rng.randrange(1, 17): _any(rng)}),
    lambda entry, rng: replace(entry, local={rng.randrange(1, 11): _any(rng)}),
    lambda entry, rng: replace(entry, size=_any(rng)),
    lambda entry, rng: replace(entry, crc=_any(rng)),
    lambda entry, rng: replace(entry, flags=rng.choice((1, 8, 32, 64, 0x800, 0x2000, 0xFFFF))),
    lambda entry, rng: replace(entry, method=_DEFLATED, raw=_deflated(entry.data)),
    lambda entry, rng: replace(entry, method=_DEFLATED, raw=_bomb(96), size=96 << 20, crc=0),
    lambda entry, rng: replace(entry, method=rng.choice(_WORDS)),
    lambda entry, rng: replace(entry, extra=_zip64(rng)),
    lambda entry, rng: replace(entry, extra=_zip64(rng), central={9: 2**32 - 1, 8: 2**32 - 1}),
    lambda entry, rng: replace(entry, extra=rng.randbytes(rng.choice((1, 3, 4, 60)))),
    lambda entry, rng: replace(entry, hidden=True),
    lambda entry, rng: replace(entry, data=b""),
    lambda entry, rng: replace(entry, over_the_one_before=True),
)


def changed_zip(members: Mapping[str, bytes], rng: Random) -> bytes:
    """A zip of these members, spoilt in one to three of the ways above."""
    entries = entries_of(members)
    end: dict[int, int] = {}
    comment = b""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        place = rng.randrange(len(entries))
        kind = rng.randrange(14)
        if kind < 8:
            entries[place] = rng.choice(_ODD)(entries[place], rng)
        elif kind == 8:
            entries.append(replace(entries[place], data=rng.choice((entries[place].data, b"{}"))))
        elif kind == 9:
            del entries[place]
            entries = entries or [Entry(b"manifest.json", b"{}")]
        elif kind == 10:
            rng.shuffle(entries)
        elif kind == 11:
            end[rng.randrange(1, 8)] = rng.choice((*_WORDS, *_LONGS))
        elif kind == 12:
            comment = rng.choice((b"x" * 65000, b"PK\5\6" * 10, b"\0"))
        else:
            count = rng.choice((10, 10, 300, 300, 3000))
            entries += [Entry(b"%d" % n, b"", over_the_one_before=n > 0) for n in range(count)]
    data = zip_bytes(entries, comment, end)
    return rng.choice((data, data, data, b"MZ" + data, data + b"\0" * 30, data + data))
