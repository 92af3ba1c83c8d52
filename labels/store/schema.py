"""The tables of a label store's file, and the upgrade of files of older formats."""

import sqlite3

from tokt.features.common.names import same_text

FORMAT = 4
"""Format of the file, kept as its ``user_version``.

To change it: raise the number, let `upgrade` bring a file of each older format up to date, and
keep the tests that build yesterday's files from literal SQL.

1. Events of people and models.
2. Settlements, the actions that events belong to (undo), and the frames that were seen.
3. Whether each label was given blind, who labels blind when, notes, settings of missions.
4. The files of frames, by whose names frames are known; names of missions, annotators and
   classes in Unicode's form NFC.
"""

APPLICATION_ID = 0x746F6B74  # "tokt": tells our file from any other program's database
CELL = "mission, camera, frame, grid, row, col"
FIRST_COLUMNS = f"{CELL}, label, annotator, time, source, model_version"  # of every format
COLUMNS = f"{FIRST_COLUMNS}, blind"
VALUES = f":{COLUMNS.replace(', ', ', :')}"
AT = " AND ".join(f"{name} = :{name}" for name in CELL.split(", "))
LAST_EVENT = "SELECT COALESCE(MAX(id), 0) FROM events"

_SAME_CELL = " AND ".join(f"other.{name} = events.{name}" for name in CELL.split(", "))

_TABLES = (
    """CREATE TABLE IF NOT EXISTS events (
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
        blind INTEGER NOT NULL DEFAULT FALSE,
        action INTEGER REFERENCES actions (id)
    )""",
    # Each history (annotator, mission, grid) has two stacks, undo and redo, kept as linked lists
    # of actions: the tops after an action are written with it, and so is the action below it in
    # the stack it lies on. Rows are never changed, and no stack is ever walked.
    """CREATE TABLE IF NOT EXISTS actions (
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
    """CREATE TABLE IF NOT EXISTS seen (
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL,
        PRIMARY KEY (mission, annotator, camera, frame)
    ) WITHOUT ROWID""",
    # Of the next three the newest row of a kind holds. A note without grid, row and col is on the
    # whole frame.
    """CREATE TABLE IF NOT EXISTS notes (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        grid TEXT,
        row INTEGER,
        col INTEGER,
        text TEXT NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL
    )""",
    """CREATE TABLE IF NOT EXISTS blindness (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        annotator TEXT NOT NULL,
        blind INTEGER NOT NULL,
        time TEXT NOT NULL
    )""",
    """CREATE TABLE IF NOT EXISTS settings (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        name TEXT NOT NULL,
        value TEXT NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL
    )""",
    """CREATE TABLE IF NOT EXISTS frame_files (
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        file TEXT NOT NULL,
        PRIMARY KEY (mission, camera, frame)
    ) WITHOUT ROWID""",
)
_NAMED = ("events", "actions", "seen", "notes", "blindness", "settings")
"""Tables with names of missions and annotators."""

_APPEND_ONLY = {
    "events": "label events",
    "actions": "actions",
    "notes": "notes",
    "blindness": "times of blind labelling",
    "settings": "settings of missions",
}

_REST = (
    f"CREATE INDEX events_by_cell ON events ({CELL}, annotator, source)",
    f"CREATE INDEX events_settled ON events ({CELL}) WHERE source = 'settled'",
    "CREATE INDEX events_by_action ON events (action) WHERE action IS NOT NULL",
    "CREATE INDEX actions_by_history ON actions (annotator, mission, grid)",
    "CREATE INDEX notes_by_mission ON notes (mission)",
    *(
        f"""CREATE TRIGGER {table}_keep_{verb} BEFORE {verb} ON {table}
        BEGIN SELECT RAISE(ABORT, '{rows} are never {verb}d'); END"""
        for table, rows in _APPEND_ONLY.items()
        for verb in ("update", "delete")
    ),
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

# SQLite cannot change a CHECK, nor put a column before another one: the events move to a new
# table, whatever stood on the old one. They keep their numbers.
# Their index by cell is needed on the way, and goes with the old table.
_MADE_ANEW = """SELECT type, name FROM sqlite_master
    WHERE type <> 'table' AND sql IS NOT NULL AND name <> 'events_by_cell'"""
_MORE_OF_1, _MORE_OF_3 = "FALSE, NULL", "blind, action"
# An undo or a redo brings back a label that was given earlier, blind or not.
_GIVEN = _SAME_CELL.replace("events.", "old_events.")
_MORE_OF_2 = f"""COALESCE((SELECT actions.blind FROM old_events AS other
    LEFT JOIN actions ON actions.id = other.action
    WHERE {_GIVEN} AND other.annotator = old_events.annotator AND other.source = old_events.source
    AND other.label IS old_events.label AND other.id <= old_events.id AND actions.reverses IS NULL
    ORDER BY other.id DESC LIMIT 1), FALSE), action"""


def create(connection: sqlite3.Connection) -> None:
    """Make the tables in an empty database; the caller holds the transaction."""
    _run(connection, (*_TABLES, *_REST))


def upgrade(connection: sqlite3.Connection) -> None:
    """Bring a file of an older format up to date; the caller holds the transaction."""
    old = format_of(connection)
    if old >= FORMAT:
        return
    connection.create_function("nfc", 1, lambda text: text and same_text(text), deterministic=True)
    for kind, name in connection.execute(_MADE_ANEW).fetchall():
        connection.execute(f"DROP {kind} {name}")
    more = {1: _MORE_OF_1, 2: _MORE_OF_2, 3: _MORE_OF_3}[old]
    connection.execute("ALTER TABLE events RENAME TO old_events")
    _run(connection, _TABLES)
    connection.execute(
        f"INSERT INTO events (id, {COLUMNS}, action)"
        f" SELECT id, {FIRST_COLUMNS}, {more} FROM old_events ORDER BY id"
    )
    connection.execute("DROP TABLE old_events")
    for table in _NAMED:
        connection.execute(
            f"UPDATE OR REPLACE {table} SET mission = nfc(mission), annotator = nfc(annotator)"
            " WHERE (mission, annotator) <> (nfc(mission), nfc(annotator))"
        )
    connection.execute("UPDATE events SET label = nfc(label) WHERE label <> nfc(label)")
    _run(connection, _REST)


def format_of(connection: sqlite3.Connection) -> int:
    """The format that a file has."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def _run(connection: sqlite3.Connection, statements: tuple[str, ...]) -> None:
    for statement in statements:
        connection.execute(statement)
