"""Label files: CSV with one row a patch, in and out."""

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from sys import intern

from tokt.features.common.errors import ToktError, naming
from tokt.features.common.names import same_text
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.labels.record import HUMAN, MODEL, SETTLED, LabelRecord, utc_now, utc_text
from tokt.labels.taxonomy import Taxonomy, UnknownClassError

from .options import Notes, Remarks, in_order
from .text_file import read_rows, save_table, whole

COLUMNS = ("mission", "camera", "frame", "row", "col", "label")
MORE_COLUMNS = ("annotator", "time", "grid", "source", "model_version", "blind", "note", "file")
_BLIND = {"": False, "yes": True}
AUDIT_COLUMNS = ("suggested", "margin", "reason")
"""What a label audit says beside each label; passed over when a file is read."""
_READ = frozenset(COLUMNS + MORE_COLUMNS + AUDIT_COLUMNS)
_grid = lru_cache(Grid.parse)


def read_label_csv(
    path: Path,
    taxonomy: Taxonomy,
    annotator: str | None = None,
    grid: Grid = DEFAULT_GRID,
    classes: Mapping[str, str] | None = None,
    remarks: Remarks | None = None,
) -> list[LabelRecord]:
    """Read a label file.

    It is UTF-8 text (with or without byte order mark, any line ends) whose first line names the
    `COLUMNS` in any order, and any of `MORE_COLUMNS` and `AUDIT_COLUMNS`. What it says of annotator
    and grid goes before the arguments, which are those of `ReadOptions`. Records come in the file's
    order; without a time column they carry the present moment. `remarks` gets what is passed over:
    notes, which stay where they were written, further columns, and rows with a mistake. Without
    `remarks` a mistake refuses the file.

    A mistake is a patch outside the grid, a number that is none, and what else cannot be. Where
    the same annotator labels a patch twice, or it is settled twice, and not alike, neither counts.

    Raises ToktError for missing columns, an unknown class, or mistakes in most of the rows.
    """
    lines = read_rows(path)
    rows = _RowReader(taxonomy, annotator or path.stem, grid, classes or {})
    told = Remarks(strict=True) if remarks is None else remarks
    fault = None
    try:
        _, header = next(lines, ("line 1", []))
        with naming("line 1"):
            _check_header(header, refuse_others=told.strict)
        told.pass_over(header, _READ)
        for where, values in lines:
            with told.entry(where):
                rows.add(header, values, where)
        for where, error in rows.contradictions.values():
            with told.group(where):
                raise error
    except ToktError as error:
        fault = error
    if rows.unknown:
        raise UnknownClassError(f"{path} {next(iter(rows.unknown.values()))}", rows.unknown)
    try:
        if fault:
            raise fault
        told.refuse_mostly_odd()
    except ToktError as error:
        raise ToktError(f"{path} {error}") from None
    records = rows.chosen()
    if not records:
        raise ToktError("; ".join([f"{path} has no labels in it", *told.lines()]))
    for name, n in rows.left_out.items():
        told["label", f"left out by --map: class {name!r}"] += n
    told["note", "left out: notes stay in the workspace they were written in"] += rows.notes
    return records


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
        self._records: list[LabelRecord] = []
        self.contradictions: dict[tuple[object, ...], tuple[str, ToktError]] = {}
        self.unknown: dict[str, str] = {}  # what is said of each class that is none
        self.notes = 0
        self.left_out: Counter[str] = Counter()  # by class, as --map says
        self._files: dict[tuple[str, str, int], str] = {}
        self._taxonomy = taxonomy
        self._classes = classes
        self._defaults = {
            **dict.fromkeys(MORE_COLUMNS, ""),
            **{"annotator": annotator, "time": utc_now(), "grid": str(grid), "source": HUMAN},
        }
        self._lines: dict[tuple[object, ...], tuple[str, str | None]] = {}

    def add(self, header: list[str], values: list[str], line: str) -> None:
        if len(values) != len(header) and (len(values) < len(header) or any(values[len(header) :])):
            raise ToktError(f"{len(values)} fields where the first line names {len(header)}")
        row = {**self._defaults, **dict(zip(header, values, strict=False))}
        self.notes += bool(row["note"])
        if row["blind"] not in _BLIND:
            raise ToktError(f"blind {row['blind']!r} is neither yes nor empty")
        name = same_text(row["label"])
        label = self._classes.get(name, name)
        if not label and row["label"]:
            self.left_out[row["label"]] += 1
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
            file=intern(row["file"]),
        )
        if record.file:
            file = self._files.setdefault(
                (record.mission, record.camera, record.frame), record.file
            )
            if file != record.file:
                raise ToktError(f"frame {record.frame} is {record.file!r} here, and {file!r} above")
        key = _key(record)
        first, said = self._lines.setdefault(key, (line, record.label))
        if first == line:
            self._records.append(record)
        elif said != record.label:
            done = "settled" if record.source == SETTLED else "labelled"
            words = f"{record.cell} is {done} on {first} already as {said}: neither counts"
            self.contradictions.setdefault(key, (line, ToktError(words)))

    def chosen(self) -> list[LabelRecord]:
        """The records but those that others contradict."""
        if not self.contradictions:
            return self._records
        return [record for record in self._records if _key(record) not in self.contradictions]


def _key(record: LabelRecord) -> tuple[object, ...]:
    """Return the patch and who labelled it, as a file says it once; a patch is settled once."""
    settled = record.source == SETTLED
    who = SETTLED if settled else HUMAN, "" if settled else record.annotator
    return (*record.cell[:3], str(record.grid), record.row, record.col, *who)


def _check_header(header: list[str], *, refuse_others: bool) -> None:
    known = ", ".join(COLUMNS)
    missing = [name for name in COLUMNS if name not in header]
    unknown = [name for name in header if name not in _READ]
    twice = [name for name, times in Counter(header).items() if times > 1]
    if not header:
        raise ToktError(f"the file is empty; a label file begins with {known}")
    if missing:
        raise ToktError(f"no column {', '.join(missing)}; a label file has {known}")
    if unknown and refuse_others:
        raise ToktError(
            f"unknown column {', '.join(map(repr, unknown))};"
            f" besides {known} there may be {', '.join(MORE_COLUMNS)}"
        )
    if twice:
        raise ToktError(f"column {twice[0]} is there twice")


def _integer(row: dict[str, str], name: str) -> int:
    return whole(row[name].strip(), name)


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
