"""Canonical JSON and its SHA-256: equal values have equal text and equal hashes."""

import hashlib
import json
from typing import Any


def canonical_json(value: Any) -> str:
    """JSON with sorted keys and no spaces; NaN and infinity are refused (ValueError)."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


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
