"""Text and numbers out of files that anybody may have written, or an error in plain words."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import ToktError


def read_utf8(path: Path) -> str:
    """A whole file as text.

    Raises
    ------
    ToktError
        If it cannot be read, or is not UTF-8.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ToktError(f"label file {path} does not exist") from None
    except OSError as error:
        raise ToktError(f"label file {path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ToktError(f"{path} is not a label file: it is not UTF-8 text") from None


def parse_json(text: str, path: Path) -> Any:
    """The value of a JSON text; ToktError if it is none."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ToktError(f"{path} line {error.lineno}: not JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:  # a number of 5,000 digits, 10,000 brackets
        raise ToktError(f"{path}: JSON that cannot be read: {error}") from None


def save_text(path: Path, text: str) -> None:
    """Write a file whole or not at all; ToktError if it cannot be written."""
    try:
        write_text(path, text)
    except OSError as error:
        raise ToktError(f"cannot write {path}: {error.strerror or error}") from None


def finite(value: Any, what: str) -> float:
    """A finite number, from JSON or as text.

    Raises
    ------
    ToktError
        If it is none.
    """
    try:
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            number = float(value)
            if math.isfinite(number):
                return number
    except (ValueError, OverflowError):
        pass
    raise ToktError(f"{what} {ascii(value)[:40]} is not a number")


def listed(value: Any, what: str) -> list[Any]:
    """A JSON list; ToktError if it is none."""
    if not isinstance(value, list):
        raise ToktError(f"{what} is not a list")
    return value


def table(value: Any, what: str) -> dict[str, Any]:
    """A JSON object; ToktError if it is none."""
    if not isinstance(value, dict):
        raise ToktError(f"{what} is not an object")
    return value


def text_in(value: Any, what: str) -> str:
    """A JSON text; ToktError if it is none."""
    if not isinstance(value, str):
        raise ToktError(f"{what} is not text")
    return value
