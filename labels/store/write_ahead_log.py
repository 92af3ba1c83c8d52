"""The log beside a store's file: folded into it, and refused where it is another file's.

SQLite keeps what was written last in ``labels.db-wal``. It cannot tell whose log that is: it plays
any one into the file that it lies beside, and the labels that were there are gone.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

from tokt.features.common.errors import ToktError

from .schema import FIRST_COLUMNS

BUSY_S = 60.0
"""How long to wait for another process that is writing, in seconds."""

_LAST = f"SELECT id, {FIRST_COLUMNS} FROM events ORDER BY id DESC LIMIT 1"
_SAME = f"SELECT id, {FIRST_COLUMNS} FROM events WHERE id = ?"
_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)


def log_of(file: Path) -> Path:
    """Where the log of a database is."""
    return file.with_name(f"{file.name}-wal")


def has_log(file: Path) -> bool:
    """Whether the log may hold what the file does not."""
    log = log_of(file)
    return log.is_file() and log.stat().st_size > 0


def fold(file: Path) -> None:
    """Bring what the log holds into the file, and empty the log, unless somebody uses it just now.

    Nobody waits for it: what takes long locks nobody out, and the log is emptied only where
    nothing is left to bring over.

    Raises sqlite3.DatabaseError if it cannot be written. The log then holds it as before.
    """
    # A connection of its own: the store's would keep whoever labels waiting.
    with closing(sqlite3.connect(file, timeout=0, isolation_level=None)) as connection:
        _, pages, brought = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        if pages == brought:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()


def check_log(file: Path) -> None:
    """Refuse a log that does not go on from what the file holds; nothing is written.

    A store only grows: what its file holds by itself is there with its log, too.

    Raises ToktError if it is not, or the two together are damaged.
    """
    if not has_log(file):
        return
    fault = _fault(file)
    if fault:
        name, log = file.name, log_of(file).name
        raise ToktError(
            f"label store {file}: {log} is not of this file, or damaged ({fault}). Nothing was "
            f"changed. If {name} was copied here, move {log} away; else go back to a backup"
        )


def _fault(file: Path) -> str:
    if not file.is_file() or not file.stat().st_size:  # SQLite would remove the log
        return f"{file.name} is {'empty' if file.is_file() else 'missing'}"
    try:
        with closing(_reading(file, "&immutable=1")) as alone:
            last = alone.execute(_LAST).fetchone()
    except sqlite3.DatabaseError:  # a killed process had brought over a part of its log
        last = None
    try:
        with closing(_reading(file)) as whole:
            found = " ".join(str(whole.execute("PRAGMA integrity_check(1)").fetchone()[0]).split())
            if found != "ok":
                return found
            if last is not None and whole.execute(_SAME, last[:1]).fetchone() != last:
                return f"event {last[0]} is missing"
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF not in _DAMAGE:
            raise
        return str(error)
    return ""


def _reading(file: Path, more: str = "") -> sqlite3.Connection:
    """A connection that writes nothing, also when it is closed; ``immutable`` sees no log."""
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro{more}", uri=True, timeout=BUSY_S)
