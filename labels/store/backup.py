"""A copy of the label store in one file, also while others write to it."""

import sqlite3
from contextlib import closing
from pathlib import Path

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError, os_errors_as

from .store import LabelStore
from .write_ahead_log import BUSY_S


def back_up(store: LabelStore, target: Path) -> int:
    """Copy a store as it is at one instant, check the copy, and then give it its name.

    Returns the number of events in the copy. Raises ToktError if `target` is there already or
    cannot be written, or the copy is not what it should be.
    """
    if target.exists():
        raise ToktError(f"{target} is there already; a backup replaces no file")
    try:
        with os_errors_as(str(target)), atomic.scratch_folder(target) as folder:
            copy = folder / target.name
            events = _copy(store.path, copy)
            with closing(sqlite3.connect(copy)) as written:
                found = written.execute("PRAGMA integrity_check(1)").fetchone()[0], _events(written)
            if found != ("ok", events):
                raise ToktError(f"{target}: the copy is damaged ({found[0]}); nothing was written")
            atomic.rename(copy, target)
            atomic.fsync_folder(target.parent)
    except sqlite3.DatabaseError as error:
        raise ToktError(f"{target}: {error}; nothing was written") from None
    return events


def _copy(source: Path, target: Path) -> int:
    with (
        closing(sqlite3.connect(source, timeout=BUSY_S, isolation_level=None)) as read,
        closing(sqlite3.connect(target)) as written,
    ):
        read.execute("BEGIN")  # what is counted is what is copied
        events = _events(read)
        read.backup(written)
        # One file, which can also be read where nothing can be written.
        written.execute("PRAGMA journal_mode = DELETE")
    return events


def _events(connection: sqlite3.Connection) -> int:
    return int(connection.execute("SELECT COUNT(*) FROM events").fetchone()[0])
