"""Changes to bytes that know nothing of what the bytes mean."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

LONGEST = 1 << 20
"""Bytes; a change that makes more is cut there, so that a case stays quick."""

NUMBERS = (
    *("0", "-0", "-1", "1", "2", "3", "7", "64", "255", "256", "65535", "65536", "1000000"),
    *("2147483647", "2147483648", "-2147483649", "4294967295", "4294967296", "9007199254740993"),
    *("9223372036854775807", "9223372036854775808", "18446744073709551616", "1" + "0" * 30),
    *("1" * 400, "9" * 5000, "0.5", "-0.5", "1e-320", "1e308", "-1e308", "1e999", "-1e999"),
    *("nan", "NaN", "inf", "-inf", "Infinity", "0x10", "1_000", "٣", "1.", ".5", "+1", " 1 ", ""),
    *("[" * 3000, "[" * 900 + "]" * 900, '"' + "é" * 3000 + '"', "{a=" * 900 + "1" + "}" * 900),
)
PIECES = (
    *(b"\0", b"\xff", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b"\r\n\r\n", b"\x1b[2J", b'"'),
    *(b"'", b",", b";", b"\t", b"[", b"]", b"{", b"}", b"<", b">", b":", b"-", b"#", b"%", b"\\"),
    *(b"[" * 3000, b"{" * 3000, b'{"a":' * 2000, b"- " * 3000, b"<a>" * 1500, b"a" * 70000),
    *(b"../" * 8 + b"evil", b"/proc/self/mem", b"${HOME}", b"%s%n", b"\xed\xa0\x80", b"\xc0\xaf"),
    *("ø".encode(), "\u2028".encode(), "\u202e".encode(), "\U0001f300".encode()),
    *(b"null", b"true", b"!!python/object:os.system", b"&a [*a,*a]"),
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>",
    *(b"%YAML 1.0\n---\n", b"1e999", b"NaN", b"PK\x05\x06", b"PK\x03\x04", b"PK\x01\x02"),
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

Change = Callable[[bytes, Random, Sequence[bytes]], bytes]


def _span(data: bytes, rng: Random) -> tuple[int, int]:
    """A stretch of the data, mostly short, at any place."""
    start = rng.randrange(len(data) + 1)
    length = rng.choice((1, 2, 4, 8, 16, rng.randrange(1, 65), rng.randrange(1, len(data) + 2)))
    return start, min(start + length, len(data))


def _flip(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _byte(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 2, 4))):
        changed[rng.randrange(len(changed))] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x0A))
    return bytes(changed)


def _truncate(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    return data[: rng.randrange(len(data))]


def _behead(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    return data[rng.randrange(len(data)) :]


def _insert(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, _ = _span(data, rng)
    piece = rng.choice(
        (rng.choice(PIECES), rng.choice(PIECES), rng.randbytes(rng.randrange(1, 40)))
    )
    return data[:start] + piece + data[start:]


def _overwrite(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, _ = _span(data, rng)
    piece = rng.choice((rng.choice(PIECES)[:64], rng.randbytes(rng.choice((1, 2, 4, 8)))))
    return data[:start] + piece + data[start + len(piece) :]


def _remove(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + data[end:]


def _repeat(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, end = _span(data, rng)
    times = rng.choice((1, 1, 2, 3, 50, 2000))
    return data[:end] + data[start:end] * min(times, LONGEST // max(end - start, 1)) + data[end:]


def _zero(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, end = _span(data, rng)
    return data[:start] + bytes(end - start) + data[end:]


def _splice(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    start, end = _span(other, rng)
    here, there = _span(data, rng)
    return rng.choice(
        (data[:here] + other[start:], data[:here] + other[start:end] + data[there:], other + data)
    )


def _number(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    found = list(_NUMBER.finditer(data[:200_000]))
    if not found:
        return _byte(data, rng, others)
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(NUMBERS).encode() + data[match.end() :]


def _lines(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    lines = data.splitlines(keepends=True)
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[two] = lines[two], rng.choice((lines[one], lines[two], b"", b"\n"))
    return b"".join(lines)


CHANGES: tuple[Change, ...] = (
    *(_flip, _byte, _truncate, _behead, _insert, _overwrite, _remove, _repeat, _zero, _splice),
    *(_number, _number, _lines),
)


def changed_bytes(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """The data after one to four changes; `others` are files to splice with."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        if data:
            data = rng.choice(CHANGES)(data, rng, others)[:LONGEST]
    return data
