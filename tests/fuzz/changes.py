"""Changes to bytes that know nothing of what they mean, to JSON values, and to whole files."""

import copy
import json
import math
import re
from collections.abc import Iterable, Sequence
from random import Random
from typing import Any

LONGEST = 1 << 20  # bytes; a change that makes more is cut there, so that a case stays quick

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
TEXTS = (
    *("", " ", "a", "ocean", "left", "\0", "\n", "a\nb", "\r", "\t", "\x1b[2J", "\x7f", "\x85"),
    *("\ud800", "a\udfff", "\u2028", "\u202e", "\ufeff", "ø", "\U0001f300", "é" * 300),
    *("x" * 100_000, "../../evil", "/etc/passwd", "C:\\evil", "..", ".", "a/b", "a@b", "%s", "{0}"),
    *("<b>", "&amp;", "nan", "1", "1e999", "true", "null", "None", "__class__", "0" * 64, "f" * 64),
    "2016-04-20",
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_TIMES = (1, 1, 1, 2, 2, 3, 4)  # how many changes are made to one input


def chance(rng: Random, percent: int) -> bool:
    return rng.randrange(100) >= 100 - percent  # 0, to which hypothesis shrinks, is no


def _span(data: bytes, rng: Random) -> tuple[int, int]:
    start = rng.randrange(len(data) + 1)
    length = rng.choice((1, 2, 4, 8, 16, rng.randrange(1, 65), rng.randrange(1, len(data) + 2)))
    return start, min(start + length, len(data))


def _changed_once(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Bits flipped, a stretch overwritten, a piece of another file, another number or line."""
    start, end = _span(data, rng)
    before, after = data[:start], data[end:]
    kind = rng.randrange(13)
    if kind < 2:
        changed, odd = bytearray(data), rng.choice((None, 0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x0A))
        for _ in range(rng.choice((1, 1, 2, 8, 64))):
            at, bit = rng.randrange(len(data)), 1 << rng.randrange(8)
            changed[at] = changed[at] ^ bit if odd is None or chance(rng, 50) else odd
        return bytes(changed)
    if kind < 9:
        piece = rng.choice((*rng.choices(PIECES, k=2), rng.randbytes(rng.choice((1, 2, 8, 40)))))
        times = min(rng.choice((1, 1, 2, 3, 50, 2000)), LONGEST // max(end - start, 1))
        middles = (b"", data[start:end] * (1 + times), bytes(end - start), piece + data[start:end])
        some = before + piece[:64] + data[start + len(piece[:64]) :]
        return rng.choice((*(before + one + after for one in middles), some, before, data[start:]))
    if kind == 9:
        other = rng.choice(others)
        one, two = _span(other, rng)
        return rng.choice((before + other[one:], before + other[one:two] + after, other + data))
    if kind < 12:
        spans = [match.span() for match in _NUMBER.finditer(data[:200_000])]
        start, end = rng.choice(spans or [(start, end)])
        return data[:start] + rng.choice(NUMBERS).encode() + data[end:]
    lines = data.splitlines(keepends=True)
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[two] = lines[two], rng.choice((lines[one], lines[two], b"", b"\n"))
    return b"".join(lines)


def changed_bytes(data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """The data after one to four changes; `others` are files to splice with."""
    for _ in range(rng.choice(_TIMES)):
        data = _changed_once(data, rng, others)[:LONGEST] if data else data
    return data


_RAW = "\ue000raw:"
"""Begins a text that `text_of` writes without quotation marks: numbers that Python cannot hold."""
_RAW_TEXT = re.compile(r'"\\ue000raw:((?:[^"\\]|\\.)*)"')
_INTEGERS = (0, 1, -1, 2, 3, 10, 60, 61, 255, 2**31, 2**63, 2**64, 10**30)
_FLOATS = (0.0, -0.0, 0.5, -1.5, 1e-320, 1e308, -1e308, math.nan, math.inf)


def odd_value(rng: Random) -> Any:
    text, kind = rng.choice(TEXTS), rng.randrange(12)
    if kind < 2:
        return text
    if kind < 4:
        return _RAW + rng.choice(NUMBERS)
    if kind < 6:
        return rng.choice(_INTEGERS if kind == 4 else _FLOATS)
    if kind == 6:
        return [rng.choice(TEXTS) for _ in range(3)] * rng.choice((1, 150))
    if kind == 7:
        nested: Any = rng.choice((0, [], {}))
        for level in range(rng.choice((2, 20, 100))):
            nested = [nested] if level % 2 else {"a": nested}
        return nested
    return rng.choice((None, True, False, [], {}, {text: 1}, [[]] * rng.choice((1, 100))))


def _places(value: Any) -> list[tuple[Any, Any]]:
    keys: Iterable[Any] = value if isinstance(value, dict) else ()
    if isinstance(value, list):
        keys = range(len(value))
    return [place for key in keys for place in ((value, key), *_places(value[key]))]


def _near(value: Any, rng: Random) -> Any:
    text, odd = rng.choice(TEXTS), odd_value(rng)
    if isinstance(value, (int, float)):
        more = (value + 1, value - 1, -value, value * 1000, value * 1e-6, 0, 1 - value, not value)
    elif isinstance(value, str):
        at = rng.randrange(len(value) + 1)
        more = (value * 2, value[:at], value[:at] + text + value[at:], value.upper())
    elif isinstance(value, list):
        more = (value[:-1], value * 2, value[::-1], [value], [*value, None])
    elif isinstance(value, dict):
        more = (list(value), {**value, text: odd}, {"": value})
    else:
        more = (odd,)
    return rng.choice(more)


def changed_json(value: Any, rng: Random) -> Any:
    root = [copy.deepcopy(value)]
    for _ in range(rng.choice(_TIMES)):
        places = _places(root)
        # Mostly not the root, which the first check refuses.
        holder, key = rng.choice(places[1:] or places)
        kind = rng.randrange(8)
        if kind == 0 and isinstance(holder, dict):
            del holder[key]
        elif kind == 1 and isinstance(holder, dict):
            holder[rng.choice((*TEXTS, key + "2", key.upper()))] = holder.pop(key)
        elif kind == 2 and isinstance(holder, list) and holder is not root:
            holder.insert(key, copy.deepcopy(rng.choice(holder)))
        elif kind == 3:
            other, at = rng.choice(places)
            holder[key] = copy.deepcopy(other[at])
        else:
            holder[key] = _near(holder[key], rng) if kind in (4, 5) else odd_value(rng)
    return root[0]


def text_of(value: Any) -> bytes:
    """The value as JSON, with the numbers that only a text can hold."""
    text = json.dumps(value, allow_nan=True)
    return _RAW_TEXT.sub(lambda match: match[1].replace('\\"', '"'), text).encode()


def changed_text(value: Any, rng: Random, others: Sequence[Any] = ()) -> bytes:
    """A changed value as a JSON file; of `others` one may take its place."""
    chosen = rng.choice([value, *others])
    text = text_of(changed_json(chosen, rng))
    kind = rng.randrange(12)
    if kind == 0:
        return b"\xef\xbb\xbf" + text
    if kind == 1:
        return text.decode().encode(rng.choice(("utf-16", "utf-32", "utf-8")))
    if kind == 2 and text.startswith(b"{"):  # a key twice
        key = rng.choice(list(chosen)) if isinstance(chosen, dict) and chosen else "a"
        return b"{" + text_of(key) + b":" + text_of(odd_value(rng)) + b"," + text[1:]
    return text


def _changed_lines(data: bytes, rng: Random) -> bytes:
    values = [json.loads(line) for line in data.splitlines()]
    for at in rng.choices(range(len(values)), k=rng.choice((1, 1, 2))):
        values[at] = changed_json(values[at], rng)
    return b"\n".join(map(text_of, values)) + rng.choice((b"\n", b"\n", b"", b"\n\n"))


def changed_file(name: str, data: bytes, rng: Random, others: Sequence[bytes] = ()) -> bytes:
    """A file changed by its JSON values, if it has any, for the most part; else by its bytes."""
    if name.endswith(".jsonl"):
        data = _changed_lines(data, rng)
        return changed_bytes(data, rng, [data]) if chance(rng, 30) else data
    if data[:1] in (b"{", b"[") and chance(rng, 70):
        return changed_text(json.loads(data), rng)
    return changed_bytes(data, rng, [data, *others])
