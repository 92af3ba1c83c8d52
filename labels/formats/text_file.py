"""Text and numbers out of files that anybody may have written, or an error in plain words."""

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import ToktError
from tokt.labels.record import utc_text

T = TypeVar("T")
_KINDS: dict[type, str] = {list: "a list", dict: "an object", str: "text"}


@contextmanager
def naming(where: object) -> Iterator[None]:
    """Say where it is, such as in which file, before what a ToktError says is wrong there."""
    try:
        yield
    except ToktError as error:
        error.args = ToktError(f"{where}: {error}").args  # whatever kind of error it is
        raise


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
        what = "it is not UTF-8 text; in Excel, save it as CSV UTF-8"
        raise ToktError(f"{path} is not a label file: {what}") from None


def csv_rows(text: str) -> Any:
    """A reader of CSV that a spreadsheet may have written: separated by ``,``, or by ``;`` where
    the first line has more of these.
    """
    first = text.lstrip().partition("\n")[0]
    delimiter = ";" if first.count(";") > first.count(",") else ","
    return csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)


def read_table(path: Path, columns: Iterable[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """The rows of a CSV file, each with its line for error messages, by the first line's names.

    Raises
    ------
    ToktError
        If it is no CSV, or none of the names, in any case of letters, is one of `columns`.
    """
    reader = csv_rows(read_utf8(path))
    try:
        names = [name.strip().lower() for name in next(reader, [])]
        for column in columns:
            if names.count(column) != 1:
                raise ToktError(f"{names.count(column)} columns {column!r} where there must be one")
        for values in reader:
            if values:
                yield f"line {reader.line_num}", dict(zip(names, values, strict=False))
    except (ToktError, csv.Error) as error:
        raise ToktError(f"{path} line {max(1, reader.line_num)}: {error}") from None


def save_table(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as CSV, as `save_text` writes."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    quoting = csv.writer(out, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for row in map(list, rows):
        # By itself a writer quotes no "\r", which ends a line all the same.
        (quoting if any("\r" in str(value) for value in row) else writer).writerow(row)
    save_text(path, out.getvalue())


def read_json(path: Path) -> Any:
    """The value of a JSON file; ToktError as `read_utf8`, or if it is no JSON."""
    try:
        return json.loads(read_utf8(path))
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


def save_json(path: Path, value: Any) -> None:
    """Write a value as JSON without blanks, as `save_text` writes."""
    save_text(path, json.dumps(value, ensure_ascii=False, separators=(",", ":")) + "\n")


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


def utc_time(text: str) -> str:
    """As `utc_text`, of a time that is in UTC where it names no zone."""
    try:
        return utc_text(text)
    except ToktError:
        return utc_text(f"{text}Z")


def of_kind(value: Any, kind: type[T], what: str) -> T:
    """A JSON list, object (dict) or text (str); ToktError if it is another kind of value."""
    if not isinstance(value, kind):
        raise ToktError(f"{what} is not {_KINDS[kind]}")
    return value
