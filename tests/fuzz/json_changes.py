"""Changes to JSON values: other types, impossible numbers and texts, unknown keys, great depth."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from .bytes_changes import NUMBERS

_RAW = "\ue000raw:"
"""Begins a text that `text_of` writes without quotation marks: numbers that Python cannot hold."""
_RAW_TEXT = re.compile(r'"\\ue000raw:((?:[^"\\]|\\.)*)"')

TEXTS = (
    *("", " ", "a", "ocean", "left", "\0", "\n", "a\nb", "\r", "\t", "\x1b[2J", "\x7f", "\x85"),
    *("\ud800", "a\udfff", "\u2028", "\u202e", "\ufeff", "ø", "\U0001f300", "é" * 300),
    *("x" * 100_000, "../../evil", "/etc/passwd", "C:\\evil", "..", ".", "a/b", "a@b", "%s", "{0}"),
    *("<b>", "&amp;", "nan", "1", "1e999", "true", "null", "None", "__class__", "0" * 64, "f" * 64),
    "2016-04-20",
)  # fmt: skip


def _nested(rng: Random) -> Any:
    value: Any = rng.choice((0, [], {}))
    for _ in range(rng.choice((2, 20, 100))):
        value = [value] if rng.random() < 0.5 else {"a": value}
    return value


def odd_value(rng: Random) -> Any:
    """Any JSON value, rather a strange one."""
    return rng.choice(_ODD)(rng)


_ODD: tuple[Callable[[Random], Any], ...] = (
    lambda rng: None,
    lambda rng: rng.random() < 0.5,
    lambda rng: rng.choice(TEXTS),
    lambda rng: rng.choice(TEXTS),
    lambda rng: _RAW + rng.choice(NUMBERS),
    lambda rng: _RAW + rng.choice(NUMBERS),
    lambda rng: rng.choice((0, 1, -1, 2, 3, 10, 60, 61, 255, 2**31, 2**63, 2**64, 10**30)),
    lambda rng: rng.choice((0.0, -0.0, 0.5, -1.5, 1e-320, 1e308, -1e308, math.nan, math.inf)),
    lambda rng: [],
    lambda rng: {},
    lambda rng: [rng.choice(TEXTS) for _ in range(rng.choice((1, 3, 500)))],
    lambda rng: {rng.choice(TEXTS): 1},
    lambda rng: [[]] * rng.choice((1, 100)),
    _nested,
)


def _places(value: Any, found: list[tuple[Any, Any]]) -> None:
    """Every (container, key) inside a value."""
    if isinstance(value, dict):
        for key in value:
            found.append((value, key))
            _places(value[key], found)
    elif isinstance(value, list):
        for index in range(len(value)):
            found.append((value, index))
            _places(value[index], found)


def _near(value: Any, rng: Random) -> Any:
    """A value of the same type, most of the time."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((value + 1, value - 1, -value, value * 2, value * 1000, 0, float(value)))
    if isinstance(value, float):
        return rng.choice((-value, value * 1e6, value * 1e-6, 0, 1 - value, value + 1))
    if isinstance(value, str):
        at = rng.randrange(len(value) + 1)
        return rng.choice(
            (value + value, value[:at], value[:at] + rng.choice(TEXTS) + value[at:], value.upper())
        )
    if isinstance(value, list):
        return rng.choice((value[:-1], value + value, value[::-1], [value], [*value, None]))
    if isinstance(value, dict):
        return rng.choice((list(value), {**value, rng.choice(TEXTS): odd_value(rng)}, {"": value}))
    return odd_value(rng)


def _change(root: list[Any], rng: Random) -> None:
    places: list[tuple[Any, Any]] = []
    _places(root, places)
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
        other = rng.choice(places)
        holder[key] = copy.deepcopy(other[0][other[1]])
    elif kind in (4, 5):
        holder[key] = _near(holder[key], rng)
    else:
        holder[key] = odd_value(rng)


def changed_json(value: Any, rng: Random) -> Any:
    """A copy of the value after one to four changes."""
    root = [copy.deepcopy(value)]
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        _change(root, rng)
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
    if kind == 2 and text.startswith(b"{"):
        key = rng.choice(list(chosen)) if isinstance(chosen, dict) and chosen else "a"
        return b"{" + text_of(key) + b":" + text_of(odd_value(rng)) + b"," + text[1:]
    return text
