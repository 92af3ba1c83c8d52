"""The tables of a label store's file, and the upgrade of files of older formats."""

import sqlite3

FORMAT = 2
"""Format of the file, kept as its ``user_version``.

To change it: raise the number, let `upgrade` bring a file of each older format up to date, and
keep the tests that build yesterday's files from literal SQL.

1. Events of people and models.
2. Settlements, the actions that events belong to (undo), and the frames that were seen.
"""

APPLICATION_ID = 0x746F6B74  # "tokt": tells our file from any other program's database
CELL = "mission, camera, frame, grid, row, col"
COLUMNS = f"{CELL}, label, annotator, time, source, model_version"

_SAME_CELL = " AND ".join(f"other.{name} = events.{name}" for name in CELL.split(", "))

_TABLES = (
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
        source TEXT NOT NULL CHECK (source IN ('human', 'model', 'settled')),
        model_version TEXT,
        action INTEGER REFERENCES actions (id)
    )""",
    # Each history (annotator, mission, grid) has two stacks, undo and redo, kept as linked lists
    # of actions: the tops after an action are written with it, and so is the action below it in
    # the stack it lies on. Rows are never changed, and no stack is ever walked.
    """CREATE TABLE actions (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        key TEXT NOT NULL UNIQUE,
        annotator TEXT NOT NULL,
        mission TEXT NOT NULL,
        grid TEXT NOT NULL,
        kind TEXT NOT NULL,
        time TEXT NOT NULL,
        source TEXT NOT NULL CHECK (source IN ('human', 'settled')),
        blind INTEGER NOT NULL,
        reverses INTEGER REFERENCES actions (id),
        first INTEGER NOT NULL REFERENCES actions (id),
        below INTEGER REFERENCES actions (id),
        undo_top INTEGER REFERENCES actions (id),
        redo_top INTEGER REFERENCES actions (id),
        result TEXT NOT NULL
    )""",
    """CREATE TABLE seen (
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL,
        PRIMARY KEY (mission, annotator, camera, frame)
    ) WITHOUT ROWID""",
)

_REST = (
    f"CREATE INDEX events_by_cell ON events ({CELL}, annotator, source)",
    f"CREATE INDEX events_settled ON events ({CELL}) WHERE source = 'settled'",
    "CREATE INDEX events_by_action ON events (action) WHERE action IS NOT NULL",
    "CREATE INDEX actions_by_history ON actions (annotator, mission, grid)",
    """CREATE TRIGGER events_keep_update BEFORE UPDATE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never changed'); END""",
    """CREATE TRIGGER events_keep_delete BEFORE DELETE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never deleted'); END""",
    """CREATE TRIGGER actions_keep_update BEFORE UPDATE ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never changed'); END""",
    """CREATE TRIGGER actions_keep_delete BEFORE DELETE ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never deleted'); END""",
    # SQLite takes the columns beside a single MAX() from the row that has the maximum. The order
    # of writing decides, not the time: a ship's clock may be set back.
    f"""CREATE VIEW said_last AS
        SELECT {COLUMNS}, MAX(id) AS id FROM events WHERE source = 'human'
        GROUP BY {CELL}, annotator""",
    # A settlement holds until anybody says anything newer of the patch.
    f"""CREATE VIEW settled_now AS
        SELECT {COLUMNS}, id FROM events WHERE source = 'settled' AND label IS NOT NULL
        AND NOT EXISTS (SELECT 1 FROM events AS other WHERE {_SAME_CELL}
            AND other.source <> 'model' AND other.id > events.id)""",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {FORMAT}",
)

# SQLite cannot change a CHECK, so the events move to a new table. They keep their numbers.
_FROM_1 = (
    "DROP VIEW said_last",
    "DROP TRIGGER IF EXISTS events_keep_update",
    "DROP TRIGGER IF EXISTS events_keep_delete",
    "DROP INDEX IF EXISTS events_by_cell",
    "ALTER TABLE events RENAME TO events_1",
    *_TABLES,
    f"INSERT INTO events (id, {COLUMNS}) SELECT id, {COLUMNS} FROM events_1 ORDER BY id",
    "DROP TABLE events_1",
    *_REST,
)


def create(connection: sqlite3.Connection) -> None:
    """Make the tables in an empty database; the caller holds the transaction."""
    _run(connection, (*_TABLES, *_REST))


def upgrade(connection: sqlite3.Connection) -> None:
    """Bring a file of an older format up to date; the caller holds the transaction."""
    if format_of(connection) == 1:
        _run(connection, _FROM_1)


def format_of(connection: sqlite3.Connection) -> int:
    """The format that a file has."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _run(connection: sqlite3.Connection, statements: tuple[str, ...]) -> None:
    for statement in statements:
        connection.execute(statement)
