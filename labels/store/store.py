"""The label store: everything anybody said, in one SQLite file that only grows."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partialmethod
from pathlib import Path
from typing import Any, ClassVar
from weakref import WeakSet

from tokt.features.common.errors import ToktError, check_format, counted, os_words
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import FolderMission, Mission
from tokt.labels.record import HUMAN, MODEL, SETTLED, Cell, LabelRecord, NoLabelsError

from .actions import REDO, UNDO, Action, ActionHead, ActionLog, ActionResult, UndoHistory
from .schema import (
    APPLICATION_ID,
    AT,
    CELL,
    COLUMNS,
    FORMAT,
    LAST_EVENT,
    VALUES,
    create,
    format_of,
    upgrade,
)
from .write_ahead_log import BUSY_S, check_log, fold, has_log

FILE_NAME = "labels.db"

_RETRY_S = 0.02  # between two tries to be the one who writes
_PRIMARY = 0xFF  # of an SQLite error code: the rest tells kinds of it apart
_CHUNK = 20_000  # events read at once; others use the store between two chunks

# SQLite would prepare a statement anew for each value of `source`, as one index is of one alone.
_BY_CELL = "events INDEXED BY events_by_cell"
_LAST = f"""SELECT {{what}} FROM {_BY_CELL} WHERE mission = {{of}}mission AND camera = {{of}}camera
    AND frame = {{of}}frame AND grid = {{of}}grid AND row = {{of}}row AND col = {{of}}col
    AND annotator = {{of}}annotator AND source = {{of}}source {{more}} ORDER BY id DESC LIMIT 1"""
_SAID = "label, CASE source WHEN 'model' THEN model_version END"

# A person who says the same again, or a model version that suggests the same again, adds nothing.
# Nor does what was said already, in the same words at the same time: an older file must not bring
# back what has been changed since.
_ADD = f"""INSERT INTO events ({COLUMNS}) SELECT {VALUES}
    WHERE (:label, CASE :source WHEN 'model' THEN :model_version END) IS NOT (
        {_LAST.format(what=_SAID, of=":", more="")})
    AND NOT EXISTS (SELECT 1 FROM {_BY_CELL} WHERE {AT} AND annotator = :annotator
        AND source = :source AND label IS :label AND time = :time
        AND model_version IS :model_version)"""

# A settlement that holds already adds nothing, nor does one that was reopened since: its file
# knows nothing of the newer opinion.
_SETTLE = f"""INSERT INTO events ({COLUMNS}) SELECT {VALUES}
    WHERE :label IS NOT (SELECT CASE source WHEN 'settled' THEN label END FROM events
        WHERE {AT} AND source <> 'model' ORDER BY id DESC LIMIT 1)
    AND (:label, :annotator, :time) IS NOT (SELECT label, annotator, time FROM events
        WHERE {AT} AND source = 'settled' ORDER BY id DESC LIMIT 1)"""

_COUNT_ADDED = f"""SELECT source, ({
    _LAST.format(what="label", of="added.", more="AND id < added.id")
}) IS NOT NULL, COUNT(*), SUM(annotator = ?) FROM events AS added WHERE id > ? GROUP BY 1, 2"""

# By number, whatever SQLite thinks of the index by mission.
_AFTER = """SELECT id, camera, frame, row, col, label, annotator, source,
    model_version, blind FROM events NOT INDEXED
    WHERE id > ? AND mission = ? AND grid = ? AND source <> 'model' ORDER BY id LIMIT ?"""

_IS_SEEN = """SELECT 1 FROM seen
    WHERE mission = ? AND camera = ? AND frame = ? AND annotator = ?"""
_MARK_SEEN = """INSERT OR IGNORE INTO seen (mission, camera, frame, annotator, time)
    VALUES (?, ?, ?, ?, ?)"""

# A redo says what the first action said.
_STATEMENTS = f"""SELECT label, events.annotator, events.source, events.time,
    CASE actions.kind WHEN 'redo' THEN first.kind ELSE actions.kind END
    FROM events LEFT JOIN actions ON actions.id = events.action
    LEFT JOIN actions AS first ON first.id = actions.first
    WHERE {" AND ".join(f"events.{name} = :{name}" for name in CELL.split(", "))}
    AND events.source <> 'model' ORDER BY events.id"""

EventRow = tuple[int, str, int, int, int, str | None, str, str, str | None, bool]
"""Event number, camera, frame, row, col, label, annotator, source, model version, blind."""

StatementRow = tuple[str | None, str, str, str, str | None]
"""Label, annotator, source, time, and the kind of action; no kind where a file brought it."""


def _add_newer(table: str, place: str, value: str, more: str, before: str = "NULL") -> str:
    """An INSERT, unless the newest row on a place (`before`, where there is none) has the value."""
    columns = f"{place}, {value}, {more}"
    on_place = " AND ".join(f"{name} IS :{name}" for name in place.split(", "))
    return f"""INSERT INTO {table} ({columns}) SELECT :{columns.replace(", ", ", :")}
        WHERE :{value} IS NOT COALESCE((SELECT {value} FROM {table} WHERE {on_place}
        ORDER BY id DESC LIMIT 1), {before})"""


_BOTH = f"""(SELECT {COLUMNS} FROM said_last WHERE label IS NOT NULL
    UNION ALL SELECT {COLUMNS} FROM settled_now) WHERE TRUE"""

_NOTE_PLACE = "mission, camera, frame, grid, row, col, annotator"
_ADD_NOTE = _add_newer("notes", _NOTE_PLACE, "text", "time", "''")
_NOTES = """SELECT id, camera, frame, grid, row, col, text, annotator, time FROM notes
    WHERE mission = ? AND id > ? ORDER BY id"""
_ADD_BLINDNESS = _add_newer("blindness", "mission, annotator", "blind", "time", "FALSE")
_BLINDNESS = "SELECT annotator, blind FROM blindness WHERE mission = ? ORDER BY id"
_ADD_SETTING = _add_newer("settings", "mission, name", "value", "annotator, time")
_SETTINGS = "SELECT name, value FROM settings WHERE mission = ? ORDER BY id"


@dataclass(frozen=True)
class Note:
    """What an annotator wrote about a patch, or about a frame where `grid`, `row`, `col` are None.

    The newest one of an annotator on a place counts; an empty text takes it back.
    """

    mission: str
    camera: str
    frame: int
    grid: Grid | None
    row: int | None
    col: int | None
    text: str
    annotator: str
    time: str

    @property
    def place(self) -> tuple[object, ...]:
        """What it is on; of a patch, its `Cell`."""
        return self.mission, self.camera, self.frame, self.grid, self.row, self.col


@dataclass(frozen=True)
class AddResult:
    """What one `LabelStore.add_counted` did."""

    new: int  # labels on patches where that annotator had none
    changed: int  # labels that replaced another one of the same annotator, or took it back
    suggestions: int  # of models
    unchanged: int  # records that said what the store holds already; they write nothing
    settled: int = 0  # settlements

    @property
    def events(self) -> int:
        """Number of events written."""
        return self.new + self.changed + self.suggestions + self.settled


@dataclass(frozen=True)
class AnnotatorStats:
    """How much one annotator labelled in one mission."""

    mission: str
    annotator: str
    frames: int  # that have a label of this annotator now
    patches: int  # that have one
    blind: int  # of these, labelled blind
    events: int  # everything this annotator ever said there, corrections included
    counts: dict[str, int] = field(default_factory=dict)  # patches by label, ``unsure`` included


def _files_of(records: Iterable[LabelRecord]) -> dict[tuple[str, str, int], str]:
    """File names by mission, camera and frame; ToktError where a frame has two."""
    found: dict[tuple[str, str, int], str] = {}
    for one in records:
        if one.file:
            first = found.setdefault((one.mission, one.camera, one.frame), one.file)
            if Path(first).stem != Path(one.file).stem:
                raise ToktError(
                    f"{one.camera} frame {one.frame} of {one.mission} is {first!r} and {one.file!r}"
                )
    return found


class LabelStore:
    """Append-only history of label events; the labels in force are derived from it.

    Each annotator's labels are kept apart: the label in force is the last one *that annotator* said
    of the patch. Model suggestions are kept, and never count as anybody's label. What somebody
    settled where annotators disagree stands beside their labels and overwrites none. A method that
    returned has its events on disk (``synchronous=FULL``); a killed process leaves each `add`,
    `apply`, `undo` and `redo` whole or absent. Several processes and threads may use one file at
    once. It is created with its folder when it is not there, unless `create` is ``False``.

    Raises ToktError if the file is not a label store, has a newer format, or cannot be opened; or
    if the log beside it is another file's.
    """

    _open_here: ClassVar[WeakSet[LabelStore]] = WeakSet()

    def __init__(self, path: Path, *, create: bool = True) -> None:
        self.path = path
        self._lock = threading.RLock()
        if not create and not path.is_file():
            raise NoLabelsError(
                f"no label store {path}: tokt label DIR or tokt labels import FILE fills one"
            )
        with self._user_errors():
            path.parent.mkdir(parents=True, exist_ok=True)
            # Where this process has it open, closing another look would take its locks off (POSIX).
            if path not in {store.path for store in self._open_here}:
                check_log(path)
            self._connection = sqlite3.connect(
                path, timeout=BUSY_S, isolation_level=None, check_same_thread=False
            )
            self._actions = ActionLog(self._connection)
            try:
                self._open()
            except BaseException:
                self._connection.close()
                raise
        self._open_here.add(self)

    def __enter__(self) -> LabelStore:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; the store cannot be used afterwards."""
        with self._lock:
            self._connection.close()
        self._open_here.discard(self)

    def fold_log(self) -> None:
        """Bring what was written last into the file itself, in case somebody copies it.

        Nobody who reads or writes waits for it. Where it cannot be done now, nothing is lost.
        """
        with self._user_errors():
            if has_log(self.path):
                fold(self.path)

    def add(self, records: Iterable[LabelRecord]) -> int:
        """Append `records` in one transaction: all of them, or none when it is interrupted.

        Records that say what the annotator's label in force says already are skipped, and so are
        those that the store has already, with the same time: importing a file again changes
        nothing, also where its labels have been changed since.

        Returns the number of events written; they are on disk. ToktError if the file cannot be
        written (disk full, or another process writes for a minute).
        """
        return self.add_counted(records).events

    def add_counted(
        self, records: Iterable[LabelRecord], *, dry: bool = False, assumed: str = ""
    ) -> AddResult:
        """`add`, telling new labels from changed ones; `dry` tells it and adds none.

        `assumed` is an annotator whom nothing but the name of a file says: tools give the files of
        all people one name. Raises ToktError where labels of that one would change.
        """
        given = self._by_file(list(records))

        def rows(*, settled: bool) -> Iterator[dict[str, Any]]:
            for record in given:
                if (record.source == SETTLED) == settled:
                    yield {**vars(record), "grid": str(record.grid)}

        with self._transaction():
            last = self._one(LAST_EVENT)
            self._connection.execute("SAVEPOINT empty")
            self._keep_files(_files_of(given))
            self._connection.executemany(_ADD, rows(settled=False))
            # After the opinions they settle: an opinion that is newer opens the question again.
            self._connection.executemany(_SETTLE, rows(settled=True))
            counts = self._connection.execute(_COUNT_ADDED, (assumed, last)).fetchall()
            by_kind = {(source, bool(had)): n for source, had, n, _ in counts}
            if replaced := sum(n for source, had, _, n in counts if source == HUMAN and had):
                raise ToktError(
                    f"{counted(replaced, 'patch')} would change that {assumed!r} labelled, and the"
                    " file does not say who made it. Give --annotator NAME, the same name if it is"
                    " the same person"
                )
            if dry:
                self._connection.execute("ROLLBACK TO empty")
        return AddResult(
            new=by_kind.get((HUMAN, False), 0),
            changed=by_kind.get((HUMAN, True), 0),
            suggestions=sum(n for (source, _), n in by_kind.items() if source == MODEL),
            unchanged=len(given) - sum(by_kind.values()),
            settled=sum(n for (source, _), n in by_kind.items() if source == SETTLED),
        )

    def _in_force(
        self,
        table: str,
        mission: str | None = None,
        annotator: str | None = None,
        grid: Grid | None = None,
        *,
        camera: str | None = None,
        frame: int | None = None,
    ) -> list[LabelRecord]:
        """Records by mission, camera, frame, grid, row, col and annotator.

        Each argument that is given narrows the choice.
        """
        wanted = {"mission": mission, "annotator": annotator, "camera": camera, "frame": frame}
        wanted["grid"] = None if grid is None else str(grid)
        given = {name: value for name, value in wanted.items() if value is not None}
        where = "".join(f" AND {name} = :{name}" for name in given)
        sql = f"SELECT {COLUMNS} FROM {table}{where} ORDER BY {CELL}, source, annotator"
        rows = self._rows(sql, given)
        grids = {text: Grid.parse(text) for text in {row[3] for row in rows}}
        files = self.files(mission)
        return [
            LabelRecord(
                *(mission, camera, frame, grids[grid], row, col),
                *(*said, bool(blind), files.get((mission, camera, frame), "")),
            )
            for mission, camera, frame, grid, row, col, *said, blind in rows
        ]

    def files(self, mission: str | None = None) -> dict[tuple[str, str, int], str]:
        """File names by mission, camera and frame, as far as they are known."""
        where = "" if mission is None else " WHERE mission = :mission"
        rows = self._rows(
            f"SELECT mission, camera, frame, file FROM frame_files{where}", {"mission": mission}
        )
        return {(name, camera, frame): file for name, camera, frame, file in rows}

    def _by_file(self, records: list[LabelRecord]) -> list[LabelRecord]:
        """Records with the number by which the store knows their frame's file."""
        if not any(record.file for record in records):
            return records
        known = {
            (*key[:2], Path(file).stem): key[2]
            for mission in {record.mission for record in records}
            for key, file in self.files(mission).items()
        }
        numbers = (
            known.get((one.mission, one.camera, Path(one.file).stem), one.frame)
            if one.file
            else one.frame
            for one in records
        )
        return [
            one if number == one.frame else replace(one, frame=number)
            for one, number in zip(records, numbers, strict=True)
        ]

    def keep_files(self, mission: Mission) -> None:
        """Keep the names of the files that a mission's frames are.

        Frames are numbered as their files are known.

        Raises ToktError where the labels of a frame are of another file.
        """
        if isinstance(mission, FolderMission):
            known: dict[str, dict[str, int]] = {}
            for (_, camera, number), name in self.files(mission.name).items():
                known.setdefault(camera, {})[name] = number
            mission.keep_numbers(known)
        with self._transaction():
            self._keep_files(
                {
                    (mission.name, camera, frame): file
                    for camera in mission.cameras
                    for frame in mission.frames(camera)
                    if (file := mission.file_name(frame, camera))
                }
            )

    def _keep_files(self, files: Mapping[tuple[str, str, int], str]) -> None:
        known: dict[tuple[str, str, int], str] = {}
        for mission in {name for name, _, _ in files}:
            known |= self.files(mission)
        for key, file in files.items():
            if Path(known.get(key, file)).stem != Path(file).stem:  # converted, it is the same
                name, camera, frame = key
                raise ToktError(
                    f"{camera} frame {frame} of {name} is the file {file!r}, and its labels in"
                    f" {self.path} are of {known[key]!r}. Give back its name, or label it as"
                    " another mission (NAME=DIR)"
                )
        rows = [(*key, file) for key, file in files.items() if key not in known]
        self._connection.executemany("INSERT INTO frame_files VALUES (?, ?, ?, ?)", rows)

    current = partialmethod(_in_force, "said_last WHERE label IS NOT NULL")
    """The human labels in force. What was taken back and what models suggested is not among them.
    """

    settled = partialmethod(_in_force, "settled_now WHERE TRUE")
    """The settlements in force.

    A settlement holds until it is taken back, or anybody says anything newer of its patch: that
    opens the question again. `annotator` is who settled.
    """

    current_and_settled = partialmethod(_in_force, _BOTH)
    """`current` and `settled` together, as a dataset or a full export needs them.

    A settlement stands behind the opinions on its patch.
    """

    def apply(self, action: Action) -> ActionResult:
        """Write an action in one transaction; it is on disk when this returns.

        A patch where something else than the change's ``base`` and ``label`` holds for this
        annotator (or as the settlement) is left as it is, and reported as a conflict. A patch
        where ``label`` holds already is left as it is. An action whose key is known writes
        nothing and gets the first time's answer.

        Raises ToktError if the file cannot be written, or the key was another action's.
        """
        with self._transaction():
            return self._actions.apply(action)

    def reverse(
        self,
        way: str,
        annotator: str,
        mission: str,
        grid: Grid,
        key: str,
        time: str,
        target: str | None = None,
    ) -> ActionResult | None:
        """Take back the last action of this annotator that is not undone yet, without limit.

        Where the label that the action set no longer holds, nothing is changed and a conflict is
        reported. The inverse changes are new events; they are on disk when this returns. A new
        action makes what was undone before it impossible to redo.

        `way` is `UNDO`; or `REDO`, which does again what was undone last. `key` is of this undo:
        the same key twice counts once. `time` is as `record.utc_text` writes it, and `target` the
        key of the action that the caller means. None when there is nothing to undo.

        Raises ToktError if the next action to undo is not `target`, or as for `apply`.
        """
        with self._transaction():
            history = UndoHistory(annotator, mission, grid)
            return self._actions.reverse(history, way, key, time, target)

    undo, redo = partialmethod(reverse, UNDO), partialmethod(reverse, REDO)

    def history_top(
        self, annotator: str, mission: str, grid: Grid
    ) -> tuple[ActionHead | None, ActionHead | None]:
        """What `undo` and what `redo` would act on."""
        with self._lock, self._user_errors():
            return self._actions.heads(UndoHistory(annotator, mission, grid))

    def rows_after(self, event: int, mission: str, grid: Grid) -> Iterator[EventRow]:
        """What people said and settled after an event, in order, read bit by bit."""
        while True:
            rows = self._rows(_AFTER, (event, mission, str(grid), _CHUNK))
            yield from ((*row[:-1], row[-1] == 1) for row in rows)
            if len(rows) < _CHUNK:
                return
            event = rows[-1][0]

    def last_event(self) -> int:
        """Highest event number; 0 in an empty store."""
        return int(self._rows(LAST_EVENT)[0][0])

    def data_version(self) -> int:
        """A number that changes whenever anybody, also another process, has written."""
        with self._lock, self._user_errors():
            return int(self._one("PRAGMA data_version")) + self._connection.total_changes

    def check_writable(self) -> None:
        """Write one page that changes nothing; ToktError as `apply` where writing does not work."""
        with self._transaction():
            version = format_of(self._connection)
            self._connection.execute(f"PRAGMA user_version = {version}")

    def mark_seen(self, mission: str, camera: str, frame: int, annotator: str, time: str) -> None:
        """Keep that this annotator opened a frame; the first time counts."""
        row = (mission, camera, frame, annotator)
        if not self._rows(_IS_SEEN, row):  # which waits for nobody who writes
            with self._transaction():
                self._connection.execute(_MARK_SEEN, (*row, time))

    def seen(self, mission: str, annotator: str) -> set[tuple[str, int]]:
        """Frames (camera and number) that this annotator opened."""
        sql = "SELECT camera, frame FROM seen WHERE mission = ? AND annotator = ?"
        return set(self._rows(sql, (mission, annotator)))

    def add_note(self, note: Note) -> None:
        """Keep a note; what its annotator wrote there before stays in the file."""
        grid = None if note.grid is None else str(note.grid)
        with self._transaction():
            self._connection.execute(_ADD_NOTE, {**vars(note), "grid": grid})

    def notes_after(self, number: int, mission: str) -> list[tuple[int, Note]]:
        """Notes with a number higher than `number`, each with its own, in order."""
        return [
            (found, Note(mission, camera, frame, grid and Grid.parse(grid), *said))
            for found, camera, frame, grid, *said in self._rows(_NOTES, (mission, number))
        ]

    def notes(self, mission: str) -> dict[tuple[tuple[object, ...], str], str]:
        """Texts of the notes in force, by place and annotator."""
        newest = {(note.place, note.annotator): note for _, note in self.notes_after(0, mission)}
        return {by: note.text for by, note in newest.items() if note.text}

    def set_blind(self, mission: str, annotator: str, *, blind: bool, time: str) -> None:
        """Keep that an annotator labels a mission blind from now on, or no longer does."""
        row = {"mission": mission, "annotator": annotator, "blind": blind, "time": time}
        with self._transaction():
            self._connection.execute(_ADD_BLINDNESS, row)

    def blind_annotators(self, mission: str) -> frozenset[str]:
        """Who labels this mission blind."""
        now = dict(self._rows(_BLINDNESS, (mission,)))
        return frozenset(who for who, blind in now.items() if blind)

    def set_setting(self, mission: str, name: str, value: str, annotator: str, time: str) -> None:
        """Keep a setting of a mission, which is everybody's."""
        row = dict(mission=mission, name=name, value=value, annotator=annotator, time=time)
        with self._transaction():
            self._connection.execute(_ADD_SETTING, row)

    def settings(self, mission: str) -> dict[str, str]:
        """The settings of a mission by name."""
        return dict(self._rows(_SETTINGS, (mission,)))

    def statements(self, cell: Cell) -> list[StatementRow]:
        """What people said of one patch and how, in order."""
        return self._rows(_STATEMENTS, {**cell._asdict(), "grid": str(cell.grid)})

    def labels_ever(self) -> set[str]:
        """Every label that was ever said, also what was changed or taken back since."""
        return set(self._column("SELECT DISTINCT label FROM events WHERE label IS NOT NULL"))

    def missions(self) -> list[str]:
        """Missions that have events, by name."""
        return self._column("SELECT DISTINCT mission FROM events ORDER BY 1")

    def grids(self, mission: str) -> list[str]:
        """Grids in which people labelled a mission, as text and in its order."""
        sql = "SELECT DISTINCT grid FROM events WHERE mission = ? AND source <> 'model' ORDER BY 1"
        return self._column(sql, (mission,))

    def annotators(self) -> list[str]:
        """People who said something, by name; models are not among them."""
        sql = "SELECT DISTINCT annotator FROM events WHERE source = 'human' ORDER BY 1"
        return self._column(sql)

    def stats(self) -> list[AnnotatorStats]:
        """How much each annotator labelled, by mission and annotator."""
        counts: dict[tuple[str, str], dict[str, int]] = {}
        totals = self._rows(
            "SELECT mission, annotator, COUNT(DISTINCT camera || frame) FILTER"
            " (WHERE label IS NOT NULL), COUNT(label), COUNT(label) FILTER (WHERE blind),"
            " (SELECT COUNT(*) FROM events AS said WHERE"
            " said.mission = said_last.mission AND said.annotator = said_last.annotator"
            " AND source = 'human') FROM said_last GROUP BY mission, annotator ORDER BY 1, 2"
        )
        for mission, annotator, label, n in self._rows(
            "SELECT mission, annotator, label, COUNT(*) FROM said_last"
            " WHERE label IS NOT NULL GROUP BY 1, 2, 3 ORDER BY 1, 2, 3"
        ):
            counts.setdefault((mission, annotator), {})[label] = n
        return [
            AnnotatorStats(mission, who, *(*numbers, counts.get((mission, who), {})))
            for mission, who, *numbers in totals
        ]

    def _open(self) -> None:
        self._connection.execute("PRAGMA synchronous = FULL")
        if not self._is_ours() or format_of(self._connection) < FORMAT:
            # Two processes may come here at once; the second one finds it done.
            with self._transaction():
                if not self._is_ours():
                    if self._one("SELECT COUNT(*) FROM sqlite_master"):
                        raise ToktError(
                            f"{self.path} is not a label store but another kind of database"
                        )
                    create(self._connection)
                upgrade(self._connection)
        check_format(format_of(self._connection), FORMAT, f"label store {self.path}")
        self._use_write_ahead_log()

    def _is_ours(self) -> bool:
        return bool(self._one("PRAGMA application_id") == APPLICATION_ID)

    def _use_write_ahead_log(self) -> None:
        # SQLite does not wait for others here, whatever its time-out. Where the file system
        # cannot hold a write-ahead log it answers with another mode, which is as safe.
        deadline = time.monotonic() + BUSY_S
        while True:
            try:
                self._connection.execute("PRAGMA journal_mode = WAL").fetchone()
                return
            except sqlite3.OperationalError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(_RETRY_S)

    def _one(self, sql: str) -> Any:
        return self._connection.execute(sql).fetchone()[0]

    def _rows(self, sql: str, values: Sequence[Any] | dict[str, Any] = ()) -> list[Any]:
        with self._lock, self._user_errors():
            return self._connection.execute(sql, values).fetchall()

    def _column(self, sql: str, values: Sequence[Any] = ()) -> list[str]:
        return [row[0] for row in self._rows(sql, values)]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._user_errors("; nothing was stored"):
            self._begin()
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                # A full disk may have ended the transaction already.
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
            finally:
                self._lock.release()

    def _begin(self) -> None:
        """Take the lock and begin to write.

        While another process writes, such as a long import, other threads must be able to read:
        SQLite would wait for it with the lock held.
        """
        deadline = time.monotonic() + BUSY_S
        while True:
            late = time.monotonic() > deadline
            with self._lock:
                self._connection.execute("PRAGMA busy_timeout = 0")
                try:
                    self._connection.execute("BEGIN IMMEDIATE")
                except sqlite3.OperationalError as error:
                    busy = error.sqlite_errorcode & _PRIMARY == sqlite3.SQLITE_BUSY
                    if not busy or late:
                        raise
                finally:
                    self._connection.execute(f"PRAGMA busy_timeout = {BUSY_S * 1000:.0f}")
                if self._connection.in_transaction:
                    self._lock.acquire()  # once more: held until the transaction ends
                    return
            time.sleep(_RETRY_S)

    @contextmanager
    def _user_errors(self, state: str = "") -> Iterator[None]:
        try:
            yield
        except (sqlite3.IntegrityError, sqlite3.ProgrammingError):
            raise
        except sqlite3.DatabaseError as error:
            raise ToktError(f"label store {self.path}: {error}{state}") from error
        except UnicodeDecodeError:  # SQLite does not look at the bytes of a text
            raise ToktError(f"label store {self.path} is damaged: a text is not UTF-8") from None
        except OSError as error:
            raise ToktError(f"label store {self.path}: {os_words(error)}{state}") from error
