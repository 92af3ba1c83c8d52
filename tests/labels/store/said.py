"""What a label store's file holds of one patch."""

import sqlite3
from contextlib import closing

from tokt.labels.record import LabelRecord
from tokt.labels.store.schema import AT, COLUMNS


def history(store, cell):
    """Everything ever said of a patch, by people and models, in the order it was said."""
    sql = f"SELECT {COLUMNS} FROM events WHERE {AT} ORDER BY id"
    with closing(sqlite3.connect(store.path)) as file:
        rows = file.execute(sql, {**cell._asdict(), "grid": str(cell.grid)}).fetchall()
    return [LabelRecord(*cell, *said, bool(blind)) for *said, blind in (row[6:] for row in rows)]
