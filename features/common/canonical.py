"""Canonical JSON and its SHA-256: equal values have equal text and equal hashes."""

import hashlib
import json
from typing import Any

MAX_EXACT = 2**53
"""Every whole number up to here is a floating-point number, which all readers of JSON keep."""


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no spaces; NaN and infinity are refused (ValueError)."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def exact_numbers(value: Any) -> Any:
    """Return a JSON value whose whole numbers beyond `MAX_EXACT` are text.

    Other programs, browsers among them, read such numbers as floating-point ones and change them.
    """
    if isinstance(value, dict):
        return {key: exact_numbers(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [exact_numbers(each) for each in value]
    return str(value) if type(value) is int and abs(value) > MAX_EXACT else value


def printable_json(data: bytes) -> Any:
    """What JSON's bytes say.

    Raises ValueError or RecursionError if it is none, or its text could not be printed or written:
    half a surrogate pair is JSON.
    """
    value = json.loads(data)
    json.dumps(value, ensure_ascii=False).encode("utf-8")
    return value


def json_sha256(value: Any) -> str:
    """SHA-256 (hex) of a value's canonical JSON."""
    return hashlib.sha256(canonical_json(value).encode("utf-8")).hexdigest()
