"""Text and numbers out of files that anybody may have written, or an error in plain words."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import ToktError, os_errors_as, os_words
from tokt.features.common.spreadsheet import guarded, unguarded
from tokt.labels.record import utc_text

if TYPE_CHECKING:
    from .options import Remarks

T = TypeVar("T")
Rows = Iterator[tuple[str, list[str]]]
"""The rows of a CSV file, each with its line for error messages."""
_KINDS: dict[type, str] = {list: "a list", dict: "an object", str: "text"}
_WHOLE = re.compile(r"(-?[0-9]{1,19})(?:\.0*)?")
_MAX_EXACT = 2**53
_LARGEST = 10**300  # what a float can hold, with room to calculate
_SEPARATOR_LINE = re.compile(r"\s*sep=(.)\r?\n")
"""The first line by which Excel is told what separates cells."""
_MILLISECONDS_FROM = 10**11  # s: the year 5138, so that a larger number counts milliseconds


def read_utf8(path: Path) -> str:
    """A whole file as text; ToktError if it cannot be read, or is not UTF-8."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ToktError(f"label file {path} does not exist") from None
    except OSError as error:
        raise ToktError(f"label file {path}: {os_words(error)}") from None
    except UnicodeDecodeError:
        what = "it is not UTF-8 text; in Excel, save it as CSV UTF-8"
        raise ToktError(f"{path} is not a label file: {what}") from None


def csv_rows(text: str) -> Rows:
    """Rows that a spreadsheet may have written, empty ones left out; ToktError if it is no CSV.

    Separated by what a line ``sep=;`` says, else by ``,``, or by ``;`` where the first line has
    more of these. Cells lose the quotation mark that `guarded` puts before them.
    """
    said = _SEPARATOR_LINE.match(text)
    first = text.lstrip().partition("\n")[0]
    delimiter = said[1] if said else ";" if first.count(";") > first.count(",") else ","
    source = io.StringIO(text, newline="")
    if said:
        source.readline()
    reader = csv.reader(source, delimiter=delimiter, strict=True)
    skipped, has_quotes = int(said is not None), "'" in text
    try:
        for values in reader:
            if any(values):
                cells = list(map(unguarded, values)) if has_quotes else values
                yield f"line {reader.line_num + skipped}", cells
    except csv.Error as error:
        raise ToktError(f"line {max(1, reader.line_num + skipped)}: {error}") from None


def read_rows(path: Path) -> Rows:
    """The rows of a file; ToktError as `read_utf8` now, as `csv_rows` later."""
    return csv_rows(read_utf8(path))


def by_name(
    rows: Rows, columns: Iterable[str], known: Iterable[str], remarks: Remarks
) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows by the names, in small letters, that the first one has; ToktError without `columns`.

    `remarks` are told of names that are not among the known ones.
    """
    names = [name.strip().lower() for name in next(rows, ("", []))[1]]
    remarks.pass_over(names, frozenset(known))
    for column in columns:
        if names.count(column) != 1:
            what = f"{names.count(column)} columns {column!r} where there must be one"
            raise ToktError(f"line 1: {what}")
    for where, values in rows:
        row = dict(zip(names, values, strict=False))
        with remarks.group(where):
            if not row.keys() >= set(columns):
                raise ToktError(f"{len(row)} fields, too few")
            yield where, row


def save_table(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as CSV, as `save_text` writes."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    quoting = csv.writer(out, lineterminator="\n", quoting=csv.QUOTE_ALL)
    for cells in rows:
        row = [guarded(cell) if isinstance(cell, str) else cell for cell in cells]
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
    with os_errors_as(f"cannot write {path}"):
        write_text(path, text)


def save_json(path: Path, value: Any) -> None:
    """Write a value as JSON without blanks, as `save_text` writes."""
    save_text(path, json.dumps(value, ensure_ascii=False, separators=(",", ":")) + "\n")


def finite(value: Any, what: str) -> float:
    """A finite number, from JSON or as text; ToktError if it is none."""
    try:
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            number = float(value)
            if math.isfinite(number):
                return number
    except (ValueError, OverflowError):
        pass
    raise ToktError(f"{what} {ascii(value)[:40]} is not a number")


def finite_list(value: Any, what: str) -> list[float]:
    """The finite numbers of a JSON list; ToktError as `finite`."""
    return [finite(part, what) for part in of_kind(value, list, what)]


def whole(value: Any, what: str) -> int:
    """A whole number, also written ``3.0`` or as text; ToktError if it is none."""
    if type(value) is int and abs(value) < _LARGEST:
        return value
    if type(value) is float and value.is_integer() and abs(value) < _MAX_EXACT:
        return int(value)
    match = _WHOLE.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ToktError(f"{what} {ascii(value)[:40]} is not a whole number")
    return int(match[1])


def utc_time(value: str | float | None) -> str | None:
    """As `utc_text`, of a time that is in UTC where it names no zone; None where there is none.

    A number counts seconds since 1970, or milliseconds where it is too large for that.
    """
    if isinstance(value, int | float):
        try:
            seconds = value / 1000 if value >= _MILLISECONDS_FROM else value
            return utc_text(datetime.fromtimestamp(seconds, UTC).isoformat())
        except (ValueError, OverflowError, OSError):
            raise ToktError(f"time {value!r:.40} is no number of seconds since 1970") from None
    try:
        return utc_text(value) if value else None
    except ToktError:
        return utc_text(f"{value}Z")


def of_kind(value: Any, kind: type[T], what: str) -> T:
    """A JSON list, object (dict) or text (str); ToktError if it is another kind of value."""
    if not isinstance(value, kind):
        raise ToktError(f"{what} is not {_KINDS[kind]}")
    return value


def listed(value: Any, what: str, each: str) -> Iterator[tuple[str, Any]]:
    """The entries of a JSON list, each with its place for error messages; as `of_kind`."""
    for n, entry in enumerate(of_kind(value, list, what), 1):
        yield f"{each} {n}", entry


def objects(value: Any, what: str, each: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The objects of a JSON list, each with its place for error messages; as `of_kind`."""
    for where, entry in listed(value, what, each):
        yield where, of_kind(entry, dict, where)
