"""A copy of a SQLite database to examine, so that the original stays untouched.

Opening a database, even to read, may write beside it: a write-ahead log is created, recovered or
folded in. Copying its files writes nothing.
"""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

from .errors import ToktError

_SIDE_FILES = ("", "-wal", "-journal")
_ATTEMPTS = 5


def _state(source: Path) -> list[tuple[int, int]]:
    files = [source.with_name(source.name + side) for side in _SIDE_FILES]
    stats = [file.stat() if file.is_file() else None for file in files]
    return [(-1, -1) if stat is None else (stat.st_mtime_ns, stat.st_size) for stat in stats]


def copy_database(source: Path, target: Path) -> None:
    """Copy a database with what is in its logs, as it was at one instant.

    Raises ToktError if somebody keeps writing to it; OSError if a file cannot be read, or there is
    no room for the copy.
    """
    for _ in range(_ATTEMPTS):
        before = _state(source)
        for side in _SIDE_FILES:
            copy = target.with_name(target.name + side)
            copy.unlink(missing_ok=True)
            try:
                shutil.copyfile(source.with_name(source.name + side), copy)
            except FileNotFoundError:
                if not side:
                    raise
        if _state(source) == before:
            return
    raise ToktError(f"{source} is being written to; look again later")


def damage(database: Path) -> str:
    """What SQLite finds wrong with a database, in one line; empty if nothing."""
    try:
        with closing(sqlite3.connect(database)) as connection:
            found = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    except sqlite3.DatabaseError as error:
        return str(error)
    return "" if found == "ok" else " ".join(found.split())
