"""Label files: CSV with one row a patch, in and out."""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from sys import intern

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.labels.record import HUMAN, MODEL, SETTLED, LabelRecord, utc_now, utc_text
from tokt.labels.taxonomy import Taxonomy, UnknownClassError

from .options import Notes, Remarks
from .text_file import csv_rows, read_utf8, save_table

COLUMNS = ("mission", "camera", "frame", "row", "col", "label")
MORE_COLUMNS = ("annotator", "time", "grid", "source", "model_version", "blind", "note")
_BLIND = {"": False, "yes": True}
AUDIT_COLUMNS = ("suggested", "margin", "reason")
"""What a label audit says beside each label; passed over when a file is read."""
_INTEGER = re.compile(r"-?[0-9]{1,18}")


def read_label_csv(
    path: Path,
    taxonomy: Taxonomy,
    *,
    annotator: str | None = None,
    grid: Grid = DEFAULT_GRID,
    classes: Mapping[str, str] | None = None,
    remarks: Remarks | None = None,
) -> list[LabelRecord]:
    """Read a whole label file, or refuse it with its first mistake and that line's number.

    Parameters
    ----------
    path : Path
        UTF-8 text (with or without byte order mark, any line ends) whose first line names the
        `COLUMNS` in any order, and any of `MORE_COLUMNS` and `AUDIT_COLUMNS`.
    taxonomy : Taxonomy
        The classes a label may have, besides ``unsure``.
    annotator : str, optional
        Who labelled, where the file has no such column; the file's name without ending by
        default, which keeps second annotators' files apart.
    grid : Grid
        The grid, where the file has no such column.
    classes : mapping of str to str
        The file's name of a class to ours; to nothing for a class to leave out.
    remarks : Counter, optional
        Gets what of the file is passed over: notes stay where they were written.

    Returns
    -------
    list of LabelRecord
        In the file's order. Without a time column they carry the present moment.

    Raises
    ------
    ToktError
        For wrong columns, an unknown class, a patch outside the grid, a number that is none, a
        patch that the same annotator labels twice, or one that is settled twice.
    """
    reader = csv_rows(read_utf8(path))
    rows = _RowReader(taxonomy, annotator or path.stem, grid, classes or {})
    try:
        header: list[str] = next(reader, [])
        _check_header(header)
        for values in reader:
            if values:
                rows.add(header, values, reader.line_num)
    except (ToktError, csv.Error) as error:
        rows.check_classes(path)
        raise ToktError(f"{path} line {max(1, reader.line_num)}: {error}") from None
    rows.check_classes(path)
    if not rows.records:
        raise ToktError(f"{path} has no labels in it")
    if remarks is not None:
        remarks["note", "left out: notes stay in the workspace they were written in"] += rows.notes
    return rows.records


def write_label_csv(
    path: Path, records: Iterable[LabelRecord], *, full: bool = False, notes: Notes | None = None
) -> int:
    """Write `records` sorted by patch, whole or not at all; return how many.

    Parameters
    ----------
    path : Path
        The file; its folder is made when it is not there.
    records : iterable of LabelRecord
        Labels in force, as `LabelStore.current` returns them; with `full` also settlements, as
        `LabelStore.current_and_settled` does.
    full : bool
        Add `MORE_COLUMNS`; with them nothing of a record is lost.
    notes : mapping of (patch, annotator) to str, optional
        With `full`, an annotator's note stands beside that annotator's label.

    Raises
    ------
    ToktError
        If the file cannot be written, or if without `full` there is more than one annotator,
        another grid than the default one, or a settlement: the six columns cannot say so.
    """
    columns = COLUMNS + MORE_COLUMNS if full else COLUMNS
    chosen = sorted(
        records,
        key=lambda r: (
            *(r.mission, r.camera, r.frame, str(r.grid), r.row, r.col),
            *(r.source == SETTLED, r.annotator),
        ),
    )
    if not full:
        _check_six_columns_suffice(chosen)
    said = (
        {
            **vars(record),
            "blind": "yes" if record.blind else "",
            "note": (notes or {}).get((record.cell, record.annotator), "")
            * (record.source == HUMAN),
        }
        for record in chosen
    )
    save_table(path, [columns, *([one[name] for name in columns] for one in said)])
    return len(chosen)


class _RowReader:
    """Turns rows into records, remembering the line of each patch to find it again."""

    def __init__(
        self, taxonomy: Taxonomy, annotator: str, grid: Grid, classes: Mapping[str, str]
    ) -> None:
        self.records: list[LabelRecord] = []
        self._unknown: dict[str, tuple[int, ToktError]] = {}
        self.notes = 0
        self._taxonomy = taxonomy
        self._classes = classes
        self._defaults = {
            "annotator": annotator,
            "time": utc_now(),
            "grid": str(grid),
            "source": HUMAN,
            "model_version": "",
            "blind": "",
            "note": "",
        }
        self._grids = {str(grid): grid}
        self._lines: dict[tuple[object, ...], int] = {}

    def add(self, header: list[str], values: list[str], line: int) -> None:
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
            self._unknown.setdefault(row["label"], (line, error))
        record = LabelRecord(
            mission=intern(row["mission"]),
            camera=intern(row["camera"]),
            frame=_integer(row, "frame"),
            grid=self._grid(row["grid"]),
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
            raise ToktError(f"{record.cell} is {done} on line {first} already")
        self.records.append(record)

    def check_classes(self, path: Path) -> None:
        """Raise UnknownClassError if there were such labels so far; names them all."""
        if self._unknown:
            line, first = next(iter(self._unknown.values()))
            raise UnknownClassError(f"{path} line {line}: {first}", self._unknown)

    def _grid(self, text: str) -> Grid:
        if text not in self._grids:
            self._grids[text] = Grid.parse(text)
        return self._grids[text]


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
