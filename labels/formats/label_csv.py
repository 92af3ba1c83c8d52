"""Label files: CSV with one row a patch, in and out."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from sys import intern

from tokt.features.common.errors import ToktError, naming
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.labels.record import HUMAN, MODEL, SETTLED, LabelRecord, utc_now, utc_text
from tokt.labels.taxonomy import Taxonomy, UnknownClassError

from .options import Notes, Remarks, in_order
from .text_file import read_rows, save_table

COLUMNS = ("mission", "camera", "frame", "row", "col", "label")
MORE_COLUMNS = ("annotator", "time", "grid", "source", "model_version", "blind", "note")
_BLIND = {"": False, "yes": True}
AUDIT_COLUMNS = ("suggested", "margin", "reason")
"""What a label audit says beside each label; passed over when a file is read."""
_INTEGER = re.compile(r"-?[0-9]{1,18}")
_grid = lru_cache(Grid.parse)


def read_label_csv(
    path: Path,
    taxonomy: Taxonomy,
    annotator: str | None = None,
    grid: Grid = DEFAULT_GRID,
    classes: Mapping[str, str] | None = None,
    remarks: Remarks | None = None,
) -> list[LabelRecord]:
    """Read a whole label file, or refuse it with its first mistake and that line's number.

    It is UTF-8 text (with or without byte order mark, any line ends) whose first line names the
    `COLUMNS` in any order, and any of `MORE_COLUMNS` and `AUDIT_COLUMNS`. What it says of annotator
    and grid goes before the arguments, which are those of `ReadOptions`. Records come in the file's
    order; without a time column they carry the present moment. `remarks` gets what is passed over:
    notes stay where they were written.

    Raises ToktError for wrong columns, an unknown class, a patch outside the grid, a number that is
    none, a patch that the same annotator labels twice, or one that is settled twice.
    """
    lines = read_rows(path)
    rows = _RowReader(taxonomy, annotator or path.stem, grid, classes or {})
    fault = None
    try:
        _, header = next(lines, ("", []))
        with naming("line 1"):
            _check_header(header)
        for where, values in lines:
            with naming(where):
                rows.add(header, values, where)
    except ToktError as error:
        fault = error
    if rows.unknown:
        raise UnknownClassError(f"{path} {next(iter(rows.unknown.values()))}", rows.unknown)
    if fault:
        raise ToktError(f"{path} {fault}") from None
    if not rows.records:
        raise ToktError(f"{path} has no labels in it")
    if remarks is not None:
        remarks["note", "left out: notes stay in the workspace they were written in"] += rows.notes
    return rows.records


def write_label_csv(
    path: Path, records: Iterable[LabelRecord], *, full: bool = False, notes: Notes | None = None
) -> int:
    """Write `records` sorted by patch, whole or not at all; return how many.

    They are labels in force, as of `LabelStore.current`. With `full` nothing of a record is lost:
    the file has `MORE_COLUMNS`, and may have settlements (`LabelStore.current_and_settled`) and, by
    (patch, annotator), `notes`. Its folder is made when it is not there.

    Raises ToktError if the file cannot be written, or if without `full` there is more than one
    annotator, another grid than the default one, or a settlement: the six columns cannot say so.
    """
    columns = COLUMNS + MORE_COLUMNS if full else COLUMNS
    chosen = in_order(records)
    if not full:
        _check_six_columns_suffice(chosen)
    rows: list[Iterable[object]] = [columns]
    for record in chosen:
        note = (notes or {}).get((record.cell, record.annotator)) if record.source == HUMAN else ""
        said = {**vars(record), "blind": "yes" if record.blind else "", "note": note}
        rows.append([said[name] for name in columns])
    save_table(path, rows)
    return len(chosen)


class _RowReader:
    """Turns rows into records, remembering the line of each patch to find it again."""

    def __init__(
        self, taxonomy: Taxonomy, annotator: str, grid: Grid, classes: Mapping[str, str]
    ) -> None:
        self.records: list[LabelRecord] = []
        self.unknown: dict[str, str] = {}  # what is said of each class that is none
        self.notes = 0
        self._taxonomy = taxonomy
        self._classes = classes
        self._defaults = {
            **dict.fromkeys(MORE_COLUMNS, ""),
            **{"annotator": annotator, "time": utc_now(), "grid": str(grid), "source": HUMAN},
        }
        self._lines: dict[tuple[object, ...], str] = {}

    def add(self, header: list[str], values: list[str], line: str) -> None:
        if len(values) != len(header):
            raise ToktError(f"{len(values)} fields where the first line names {len(header)}")
        row = {**self._defaults, **dict(zip(header, values, strict=True))}
        self.notes += bool(row["note"])
        if row["blind"] not in _BLIND:
            raise ToktError(f"blind {row['blind']!r} is neither yes nor empty")
        label = self._classes.get(row["label"], row["label"])
        if not label and row["label"]:
            return
        try:
            self._taxonomy.check_label(label)
        except UnknownClassError as error:
            self.unknown.setdefault(row["label"], f"{line}: {error}")
        record = LabelRecord(
            mission=intern(row["mission"]),
            camera=intern(row["camera"]),
            frame=_integer(row, "frame"),
            grid=_grid(row["grid"]),
            row=_integer(row, "row"),
            col=_integer(row, "col"),
            label=intern(label),
            annotator=intern(row["annotator"]),
            time=utc_text(row["time"]),
            source=row["source"],
            model_version=row["model_version"] or None,
            blind=_BLIND[row["blind"]],
        )
        settled = record.source == SETTLED
        # A patch is settled once, whoever did it.
        who = SETTLED if settled else HUMAN, "" if settled else record.annotator
        key = (*record.cell[:3], str(record.grid), record.row, record.col, *who)
        first = self._lines.setdefault(key, line)
        if first != line:
            done = "settled" if settled else "labelled"
            raise ToktError(f"{record.cell} is {done} on {first} already")
        self.records.append(record)


def _check_header(header: list[str]) -> None:
    known = ", ".join(COLUMNS)
    missing = [name for name in COLUMNS if name not in header]
    unknown = [name for name in header if name not in COLUMNS + MORE_COLUMNS + AUDIT_COLUMNS]
    twice = [name for name, times in Counter(header).items() if times > 1]
    if not header:
        raise ToktError(f"the file is empty; a label file begins with {known}")
    if missing:
        raise ToktError(f"no column {', '.join(missing)}; a label file has {known}")
    if unknown:
        raise ToktError(
            f"unknown column {', '.join(map(repr, unknown))};"
            f" besides {known} there may be {', '.join(MORE_COLUMNS)}"
        )
    if twice:
        raise ToktError(f"column {twice[0]} is there twice")


def _integer(row: dict[str, str], name: str) -> int:
    if not _INTEGER.fullmatch(row[name]):
        raise ToktError(f"{name} {row[name]!r} is not a whole number")
    return int(row[name])


def _check_six_columns_suffice(records: list[LabelRecord]) -> None:
    annotators = sorted({record.annotator for record in records})
    grids = sorted({str(record.grid) for record in records})
    if any(record.source == SETTLED for record in records):
        raise ToktError("settled labels: only --full writes them, with the opinions they settle")
    if any(record.source == MODEL for record in records):
        raise ToktError("suggestions of a model: in six columns they would count as labels")
    if len(annotators) > 1:
        raise ToktError(
            f"labels by {len(annotators)} annotators ({', '.join(annotators)}): choose one with"
            " --annotator, or write all with --full"
        )
    if grids and grids != [str(DEFAULT_GRID)]:
        raise ToktError(
            f"labels on the grid {', '.join(grids)}: only --full writes a grid other than"
            f" {DEFAULT_GRID}"
        )
