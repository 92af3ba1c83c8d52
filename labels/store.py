"""The label store: everything anybody said, in one SQLite file that only grows."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from ..features.errors import ToktError
from ..features.grid import Grid
from .record import HUMAN, Cell, LabelRecord

FILE_NAME = "labels.db"

FORMAT = 1
"""Format of the file, kept as its ``user_version``.

To change it: raise the number, let `LabelStore` bring a file of each older format up to date in
one transaction, and keep the test that builds yesterday's file from literal SQL.
"""

_APPLICATION_ID = 0x746F6B74  # "tokt": tells our file from any other program's database
_BUSY_S = 60.0  # how long to wait for another process that is writing
_CELL = "mission, camera, frame, grid, row, col"
_COLUMNS = f"{_CELL}, label, annotator, time, source, model_version"

_SCHEMA = (
    """CREATE TABLE events (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        grid TEXT NOT NULL,
        row INTEGER NOT NULL,
        col INTEGER NOT NULL,
        label TEXT,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL,
        source TEXT NOT NULL CHECK (source IN ('human', 'model')),
        model_version TEXT
    )""",
    f"CREATE INDEX events_by_cell ON events ({_CELL}, annotator, source)",
    """CREATE TRIGGER events_keep_update BEFORE UPDATE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never changed'); END""",
    """CREATE TRIGGER events_keep_delete BEFORE DELETE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never deleted'); END""",
    # SQLite takes the columns beside a single MAX() from the row that has the maximum. The order
    # of writing decides, not the time: a ship's clock may be set back.
    f"""CREATE VIEW said_last AS
        SELECT {_COLUMNS}, MAX(id) AS id FROM events WHERE source = 'human'
        GROUP BY {_CELL}, annotator""",
    f"PRAGMA application_id = {_APPLICATION_ID}",
    f"PRAGMA user_version = {FORMAT}",
)

_LAST = """SELECT {what} FROM events WHERE mission = {of}mission AND camera = {of}camera
    AND frame = {of}frame AND grid = {of}grid AND row = {of}row AND col = {of}col
    AND annotator = {of}annotator AND source = {of}source {more} ORDER BY id DESC LIMIT 1"""

# A person who says the same again, or a model version that suggests the same again, adds nothing.
_ADD = f"""INSERT INTO events ({_COLUMNS})
    SELECT :mission, :camera, :frame, :grid, :row, :col, :label, :annotator, :time, :source,
        :model_version
    WHERE (:label, CASE :source WHEN 'model' THEN :model_version END) IS NOT (
        {
    _LAST.format(what="label, CASE source WHEN 'model' THEN model_version END", of=":", more="")
})"""

_COUNT_ADDED = f"""SELECT source, ({
    _LAST.format(what="label", of="added.", more="AND id < added.id")
}) IS NOT NULL, COUNT(*) FROM events AS added WHERE id > ? GROUP BY 1, 2"""


@dataclass(frozen=True)
class Added:
    """What one `LabelStore.add_counted` did.

    Attributes
    ----------
    new : int
        Labels on patches where that annotator had none.
    changed : int
        Labels that replaced another one of the same annotator, or took it back.
    suggestions : int
        Model suggestions.
    unchanged : int
        Records that said what the store holds already; they write nothing.
    """

    new: int
    changed: int
    suggestions: int
    unchanged: int

    @property
    def events(self) -> int:
        """Number of events written."""
        return self.new + self.changed + self.suggestions


@dataclass(frozen=True)
class AnnotatorStats:
    """How much one annotator labelled in one mission.

    Attributes
    ----------
    frames, patches : int
        Frames and patches that have a label of this annotator now.
    counts : dict of str to int
        Patches by label, ``unsure`` included.
    events : int
        Everything this annotator ever said there, corrections included.
    """

    mission: str
    annotator: str
    frames: int
    patches: int
    events: int
    counts: dict[str, int] = field(default_factory=dict)


class LabelStore:
    """Append-only history of label events; the labels in force are derived from it.

    Each annotator's labels are kept apart: the label in force is the last one *that annotator*
    said of the patch. Model suggestions are kept, and never count as anybody's label. A method
    that returned has its events on disk (``synchronous=FULL``); a killed process leaves each
    `add` whole or absent. Several processes and threads may use one file at once.

    Parameters
    ----------
    path : Path
        The file, created with its folder when it is not there.
    create : bool
        ``False`` refuses a path where there is no file.

    Raises
    ------
    ToktError
        If the file is not a label store, has a newer format, or cannot be opened.
    """

    def __init__(self, path: Path, *, create: bool = True) -> None:
        self.path = path
        self._lock = threading.RLock()
        if not create and not path.is_file():
            raise ToktError(f"no label store {path}; labels come in by tokt labels import FILE")
        with self._user_errors():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._connection = sqlite3.connect(
                path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False
            )
            try:
                self._open()
            except BaseException:
                self._connection.close()
                raise

    def __enter__(self) -> LabelStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; the store cannot be used afterwards."""
        with self._lock:
            self._connection.close()

    def add(self, records: Iterable[LabelRecord]) -> int:
        """Append `records` in one transaction: all of them, or none when it is interrupted.

        Records that say what the annotator's label in force says already are skipped, so
        importing a file twice changes nothing.

        Returns
        -------
        int
            Number of events written; they are on disk.

        Raises
        ------
        ToktError
            If the file cannot be written (disk full, or another process writes for a minute).
        """
        return self.add_counted(records).events

    def add_counted(self, records: Iterable[LabelRecord]) -> Added:
        """`add`, telling new labels from changed ones."""
        given = 0

        def rows() -> Iterator[dict[str, Any]]:
            nonlocal given
            for given, record in enumerate(records, 1):  # noqa: B007 (read after the loop)
                yield {**vars(record), "grid": str(record.grid)}

        with self._transaction():
            last = self._one("SELECT COALESCE(MAX(id), 0) FROM events")
            self._connection.executemany(_ADD, rows())
            counts = self._connection.execute(_COUNT_ADDED, (last,)).fetchall()
        by_kind = {(source, had): n for source, had, n in counts}
        new, changed = by_kind.get((HUMAN, 0), 0), by_kind.get((HUMAN, 1), 0)
        suggestions = sum(by_kind.values()) - new - changed
        return Added(new, changed, suggestions, given - sum(by_kind.values()))

    def current(
        self,
        mission: str | None = None,
        annotator: str | None = None,
        grid: Grid | None = None,
        *,
        camera: str | None = None,
        frame: int | None = None,
    ) -> list[LabelRecord]:
        """The human labels in force, by mission, camera, frame, grid, row, col and annotator.

        Each argument that is given narrows the choice. What was taken back and what models
        suggested is not among them.
        """
        wanted = {
            "mission": mission,
            "annotator": annotator,
            "grid": None if grid is None else str(grid),
            "camera": camera,
            "frame": frame,
        }
        given = {name: value for name, value in wanted.items() if value is not None}
        where = "".join(f" AND {name} = :{name}" for name in given)
        return self._records(
            f"SELECT {_COLUMNS} FROM said_last WHERE label IS NOT NULL{where}"
            f" ORDER BY {_CELL}, annotator",
            given,
        )

    def history(self, cell: Cell) -> list[LabelRecord]:
        """Everything ever said of one patch, by people and models, in the order it was said."""
        where = " AND ".join(f"{name} = :{name}" for name in Cell._fields)
        return self._records(
            f"SELECT {_COLUMNS} FROM events WHERE {where} ORDER BY id",
            {**cell._asdict(), "grid": str(cell.grid)},
        )

    def missions(self) -> list[str]:
        """Missions that have events, by name."""
        return [row[0] for row in self._rows("SELECT DISTINCT mission FROM events ORDER BY 1")]

    def annotators(self) -> list[str]:
        """People who said something, by name; models are not among them."""
        return [
            row[0]
            for row in self._rows(
                "SELECT DISTINCT annotator FROM events WHERE source = 'human' ORDER BY 1"
            )
        ]

    def stats(self) -> list[AnnotatorStats]:
        """How much each annotator labelled, by mission and annotator."""
        counts: dict[tuple[str, str], dict[str, int]] = {}
        totals = self._rows(
            "SELECT mission, annotator, COUNT(DISTINCT camera || frame) FILTER"
            " (WHERE label IS NOT NULL), COUNT(label), (SELECT COUNT(*) FROM events AS said WHERE"
            " said.mission = said_last.mission AND said.annotator = said_last.annotator"
            " AND source = 'human') FROM said_last GROUP BY mission, annotator ORDER BY 1, 2"
        )
        for mission, annotator, label, n in self._rows(
            "SELECT mission, annotator, label, COUNT(*) FROM said_last"
            " WHERE label IS NOT NULL GROUP BY 1, 2, 3 ORDER BY 1, 2, 3"
        ):
            counts.setdefault((mission, annotator), {})[label] = n
        return [
            AnnotatorStats(mission, who, frames, patches, events, counts.get((mission, who), {}))
            for mission, who, frames, patches, events in totals
        ]

    def _open(self) -> None:
        self._connection.execute("PRAGMA synchronous = FULL")
        if not self._is_ours():
            # Two processes may come here at once; the second one finds it done.
            with self._transaction():
                if not self._is_ours():
                    self._create()
        version = self._one("PRAGMA user_version")
        if version > FORMAT:
            raise ToktError(
                f"label store {self.path} has format {version}, newer than this tokt reads"
                f" ({FORMAT}); update tokt"
            )
        self._use_write_ahead_log()

    def _is_ours(self) -> bool:
        return bool(self._one("PRAGMA application_id") == _APPLICATION_ID)

    def _create(self) -> None:
        if self._one("SELECT COUNT(*) FROM sqlite_master"):
            raise ToktError(f"{self.path} is not a label store but another kind of database")
        for statement in _SCHEMA:
            self._connection.execute(statement)

    def _use_write_ahead_log(self) -> None:
        # SQLite does not wait for others here, whatever its time-out. Where the file system
        # cannot hold a write-ahead log it answers with another mode, which is as safe.
        deadline = time.monotonic() + _BUSY_S
        while True:
            try:
                self._connection.execute("PRAGMA journal_mode = WAL").fetchone()
                return
            except sqlite3.OperationalError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)

    def _one(self, sql: str) -> Any:
        return self._connection.execute(sql).fetchone()[0]

    def _rows(self, sql: str) -> list[Any]:
        with self._lock, self._user_errors():
            return self._connection.execute(sql).fetchall()

    def _records(self, sql: str, values: dict[str, Any]) -> list[LabelRecord]:
        with self._lock, self._user_errors():
            rows = self._connection.execute(sql, values).fetchall()
        grids = {text: Grid.parse(text) for text in {row[3] for row in rows}}
        return [
            LabelRecord(mission, camera, frame, grids[grid], row, col, *said)
            for mission, camera, frame, grid, row, col, *said in rows
        ]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._lock, self._user_errors():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                # A full disk may have ended the transaction already.
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    @contextmanager
    def _user_errors(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.IntegrityError, sqlite3.ProgrammingError):
            raise
        except sqlite3.DatabaseError as error:
            raise ToktError(f"label store {self.path}: {error}") from error
        except OSError as error:
            raise ToktError(f"label store {self.path}: {error.strerror or error}") from error
