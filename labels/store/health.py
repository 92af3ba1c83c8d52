"""Health of a workspace's label store, for `tokt doctor`: damage, format, number of events."""

import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path

from tokt.features.common.errors import FAULT, NOTE, OK, Finding, ToktError
from tokt.features.common.sqlite_copy import copy_database, damage

from .schema import format_of
from .store import FILE_NAME, LabelStore
from .write_ahead_log import check_log

NAME = "labels"


def label_store_finding(workspace: Path) -> Finding:
    """Examine a copy of the label store; opening it would create files beside it.

    Raises ToktError or OSError if its file cannot be read.
    """
    file = workspace / FILE_NAME
    if not file.exists():
        return Finding(NAME, NOTE, f"no labels yet ({file})")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        copy = Path(folder) / FILE_NAME
        copy_database(file, copy)
        try:
            check_log(copy)  # first: what follows plays the log into the copy
            broken = damage(copy)
            if broken:
                return Finding(NAME, FAULT, f"{file} is damaged: {broken}")
            with closing(sqlite3.connect(copy)) as connection:
                version = format_of(connection)  # opening the copy below brings it up to date
            LabelStore(copy, create=False).close()
        except ToktError as error:
            return Finding(NAME, FAULT, str(error).replace(str(copy), str(file)))
        with closing(sqlite3.connect(copy)) as connection:
            events = connection.execute("SELECT COUNT(*) FROM events").fetchone()[0]
    figures = {"events": events, "format": version}
    return Finding(NAME, OK, f"{file}: {events} events, format {version}", figures)
