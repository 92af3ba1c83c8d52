import os
import random
import re
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tests.fixtures import write_labels
from tests.labels.store.said import history
from tests.waiting import MAX_S
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.record import LabelRecord, utc_now, utc_text
from tokt.labels.store.health import label_store_finding
from tokt.labels.store.schema import upgrade
from tokt.labels.store.store import LabelStore, Note

TIME = "2016-04-20T10:00:00Z"
GRID = Grid()


def _record(label, *, annotator="ann", frame=1, col=0, **more):
    return LabelRecord("dive", "left", frame, GRID, 0, col, label, annotator, TIME, **more)


def test_last_word_of_each_annotator_is_in_force(store):
    assert store.add([_record("ocean"), _record("reef", annotator="bob")]) == 2
    assert store.add([_record("sand"), _record("ocean", col=1)]) == 2
    bobs = _record("reef", annotator="bob")
    assert store.current() == [_record("sand"), bobs, _record("ocean", col=1)]
    assert [said.label for said in history(store, _record(None).cell)] == ["ocean", "reef", "sand"]


def test_saying_the_same_again_writes_nothing(store):
    records = [_record("ocean", col=col) for col in range(10)]
    assert store.add(records) == 10
    assert store.add([replace(record, time=utc_now()) for record in records]) == 0
    counted = store.add_counted([_record("reef"), *records[1:], _record("ocean", frame=2)])
    assert (counted.new, counted.changed, counted.unchanged) == (1, 1, 9)


def test_back_and_forth_in_one_call_keeps_every_step(store):
    said = [_record(label) for label in ("ocean", "reef", "reef", "ocean")]
    said = [replace(record, time=f"2016-04-20T10:00:0{n}Z") for n, record in enumerate(said)]
    assert store.add(said) == 3
    assert [said.label for said in store.current()] == ["ocean"]


def test_an_older_file_does_not_bring_back_what_was_changed_since(store):
    older = [_record("ocean"), _record("ocean", col=1, model_version="net/3"), _record("sand")]
    older[2] = replace(older[2], col=2)
    store.add(older)
    newer = replace(_record("reef"), time="2016-04-20T10:00:01Z")
    store.add([newer, replace(newer, col=2, label=None)])
    assert store.add_counted(older).unchanged == 3
    assert store.current() == [newer, older[1]]
    # Said anew it counts, whatever the clock says.
    assert store.add([replace(older[0], time="1970-01-01T00:00:00Z")]) == 1


def test_label_taken_back_is_gone_from_the_view_but_not_from_history(store):
    assert store.add([_record(None)]) == 0
    store.add([_record("ocean")])
    assert store.add([_record(None), _record(None)]) == 1
    assert store.current() == []
    assert [said.label for said in history(store, _record(None).cell)] == ["ocean", None]
    (stats,) = store.stats()
    assert (stats.frames, stats.patches, stats.events, stats.counts) == (0, 0, 2, {})
    assert store.add([_record("reef")]) == 1
    assert [said.label for said in store.current()] == ["reef"]


def test_suggestions_never_count_nor_overwrite(store):
    def suggestion(label, version="lbp/1"):
        return _record(label, source="model", model_version=version)

    store.add([suggestion("reef", "lbp/0"), suggestion("reef")])
    assert store.current() == [] and store.annotators() == [] and store.stats() == []
    store.add([_record("ocean")])
    assert store.add([suggestion("reef")]) == 0
    assert store.add_counted([suggestion("sand")]).suggestions == 1
    assert [said.label for said in store.current()] == ["ocean"]
    confirmed = _record("sand", model_version="lbp/1")
    store.add([confirmed])
    assert store.current() == [confirmed]
    assert len(history(store, confirmed.cell)) == 5


def test_filters(store):
    coarse = LabelRecord("dive", "right", 3, Grid(5, 5), 4, 4, "reef", "bob", TIME)
    other = replace(_record("ocean"), mission="transit")
    store.add([coarse, other, _record("ocean"), _record("sand", frame=2)])
    assert store.current(grid=Grid(5, 5)) == [coarse]
    assert store.current("transit") == [other]
    assert store.current(annotator="bob") == [coarse]
    assert store.current(camera="left", frame=2) == [_record("sand", frame=2)]
    assert store.current("dive", "nobody") == []
    assert store.missions() == ["dive", "transit"]
    assert store.annotators() == ["ann", "bob"]


def test_an_interrupted_add_leaves_nothing(store):
    def interrupted():
        yield _record("ocean")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.add(interrupted())
    assert store.current() == []
    assert store.add([_record("ocean")]) == 1


@pytest.mark.parametrize("statement", ["UPDATE events SET label = 'sand'", "DELETE FROM events"])
def test_events_cannot_be_changed_or_deleted(store, statement):
    store.add([_record("ocean")])
    with sqlite3.connect(store.path) as other, pytest.raises(sqlite3.IntegrityError, match="never"):
        other.execute(statement)
    assert store.current() == [_record("ocean")]


def test_writes_are_synced_through_a_write_ahead_log(store):
    connection = store._connection
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)


FORMAT_1 = """
    CREATE TABLE events (
        id INTEGER PRIMARY KEY AUTOINCREMENT, mission TEXT NOT NULL, camera TEXT NOT NULL,
        frame INTEGER NOT NULL, grid TEXT NOT NULL, row INTEGER NOT NULL, col INTEGER NOT NULL,
        label TEXT, annotator TEXT NOT NULL, time TEXT NOT NULL,
        source TEXT NOT NULL CHECK (source IN ('human', 'model')), model_version TEXT);
    CREATE INDEX events_by_cell
        ON events (mission, camera, frame, grid, row, col, annotator, source);
    CREATE TRIGGER events_keep_update BEFORE UPDATE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never changed'); END;
    CREATE TRIGGER events_keep_delete BEFORE DELETE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never deleted'); END;
    CREATE VIEW said_last AS SELECT mission, camera, frame, grid, row, col, label, annotator,
        time, source, model_version, MAX(id) AS id FROM events WHERE source = 'human'
        GROUP BY mission, camera, frame, grid, row, col, annotator;
    PRAGMA application_id = 1953459060;
    PRAGMA user_version = 1;
    INSERT INTO events VALUES (1, 'dive', 'left', 1, '10x10@360', 0, 0, 'reef', 'ann',
        '2016-04-20T10:00:00Z', 'human', NULL);
    INSERT INTO events VALUES (2, 'dive', 'left', 1, '10x10@360', 0, 0, 'ocean', 'ann',
        '2016-04-20T10:00:00Z', 'human', 'lbp/3');
    INSERT INTO events VALUES (3, 'dive', 'left', 1, '10x10@360', 0, 0, 'reef', 'model',
        '2016-04-20T10:00:00Z', 'model', 'lbp/4');
    INSERT INTO events VALUES (7, 'dive', 'left', 1, '10x10@360', 0, 1, 'sand', 'ann',
        '2016-04-20T10:00:00Z', 'human', NULL);
    INSERT INTO events VALUES (8, 'dive', 'left', 1, '10x10@360', 0, 1, NULL, 'ann',
        '2016-04-20T10:00:00Z', 'human', NULL);
    """


FORMAT_2 = """
CREATE TABLE events (
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
    );
CREATE TABLE actions (
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
    );
CREATE TABLE seen (
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL,
        PRIMARY KEY (mission, annotator, camera, frame)
    ) WITHOUT ROWID;
CREATE INDEX events_by_cell ON events (mission, camera, frame, grid, row, col, annotator, source);
CREATE INDEX events_settled ON events (mission, camera, frame, grid, row, col)
    WHERE source = 'settled';
CREATE INDEX events_by_action ON events (action) WHERE action IS NOT NULL;
CREATE INDEX actions_by_history ON actions (annotator, mission, grid);
CREATE TRIGGER events_keep_update BEFORE UPDATE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never changed'); END;
CREATE TRIGGER events_keep_delete BEFORE DELETE ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never deleted'); END;
CREATE TRIGGER actions_keep_update BEFORE UPDATE ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never changed'); END;
CREATE TRIGGER actions_keep_delete BEFORE DELETE ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never deleted'); END;
CREATE VIEW said_last AS
        SELECT mission, camera, frame, grid, row, col, label, annotator, time, source,
        model_version, MAX(id) AS id FROM events WHERE source = 'human'
        GROUP BY mission, camera, frame, grid, row, col, annotator;
CREATE VIEW settled_now AS
        SELECT mission, camera, frame, grid, row, col, label, annotator, time, source,
        model_version, id FROM events WHERE source = 'settled' AND label IS NOT NULL
        AND NOT EXISTS (SELECT 1 FROM events AS other WHERE other.mission = events.mission
            AND other.camera = events.camera AND other.frame = events.frame
            AND other.grid = events.grid AND other.row = events.row AND other.col = events.col
            AND other.source <> 'model' AND other.id > events.id);
PRAGMA application_id = 1953459060;
PRAGMA user_version = 2;
INSERT INTO events VALUES (2, 'dive', 'left', 1, '10x10@360', 0, 0, 'ocean', 'ann',
    '2016-04-20T10:00:00Z', 'human', 'lbp/3', NULL);
INSERT INTO events VALUES (5, 'dive', 'left', 1, '10x10@360', 0, 1, 'reef', 'ann',
    '2016-04-20T10:00:00Z', 'human', NULL, 3);
INSERT INTO events VALUES (6, 'dive', 'left', 1, '10x10@360', 0, 0, 'reef', 'bob',
    '2016-04-20T10:00:00Z', 'settled', NULL, 4);
INSERT INTO actions VALUES (3, 'k', 'ann', 'dive', '10x10@360', 'paint', '2016-04-20T10:00:00Z',
    'human', 1, NULL, 3, NULL, 3, NULL, '{"event": 5, "changed": 1, "conflicts": [],
    "frames": [["left", 1]], "kind": "paint"}');
INSERT INTO actions VALUES (4, 's', 'bob', 'dive', '10x10@360', 'settle', '2016-04-20T10:00:00Z',
    'settled', 0, NULL, 4, NULL, 4, NULL, '{"event": 6, "changed": 1, "conflicts": [],
    "frames": [["left", 1]], "kind": "settle"}');
INSERT INTO seen VALUES ('dive', 'left', 1, 'ann', '2016-04-20T10:00:00Z');
"""
FORMAT_3 = """
CREATE TABLE events (
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
    );
CREATE TABLE actions (
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
    );
CREATE TABLE seen (
        mission TEXT NOT NULL,
        camera TEXT NOT NULL,
        frame INTEGER NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL,
        PRIMARY KEY (mission, annotator, camera, frame)
    ) WITHOUT ROWID;
CREATE TABLE notes (
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
    );
CREATE TABLE blindness (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        annotator TEXT NOT NULL,
        blind INTEGER NOT NULL,
        time TEXT NOT NULL
    );
CREATE TABLE settings (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        mission TEXT NOT NULL,
        name TEXT NOT NULL,
        value TEXT NOT NULL,
        annotator TEXT NOT NULL,
        time TEXT NOT NULL
    );
CREATE INDEX events_by_cell ON events (mission, camera, frame, grid, row, col, annotator, source);
CREATE INDEX events_settled ON events (mission, camera, frame, grid, row, col) WHERE source =
    'settled';
CREATE INDEX events_by_action ON events (action) WHERE action IS NOT NULL;
CREATE INDEX actions_by_history ON actions (annotator, mission, grid);
CREATE INDEX notes_by_mission ON notes (mission);
CREATE TRIGGER events_keep_update BEFORE update ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never updated'); END;
CREATE TRIGGER events_keep_delete BEFORE delete ON events
        BEGIN SELECT RAISE(ABORT, 'label events are never deleted'); END;
CREATE TRIGGER actions_keep_update BEFORE update ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never updated'); END;
CREATE TRIGGER actions_keep_delete BEFORE delete ON actions
        BEGIN SELECT RAISE(ABORT, 'actions are never deleted'); END;
CREATE TRIGGER notes_keep_update BEFORE update ON notes
        BEGIN SELECT RAISE(ABORT, 'notes are never updated'); END;
CREATE TRIGGER notes_keep_delete BEFORE delete ON notes
        BEGIN SELECT RAISE(ABORT, 'notes are never deleted'); END;
CREATE TRIGGER blindness_keep_update BEFORE update ON blindness
        BEGIN SELECT RAISE(ABORT, 'times of blind labelling are never updated'); END;
CREATE TRIGGER blindness_keep_delete BEFORE delete ON blindness
        BEGIN SELECT RAISE(ABORT, 'times of blind labelling are never deleted'); END;
CREATE TRIGGER settings_keep_update BEFORE update ON settings
        BEGIN SELECT RAISE(ABORT, 'settings of missions are never updated'); END;
CREATE TRIGGER settings_keep_delete BEFORE delete ON settings
        BEGIN SELECT RAISE(ABORT, 'settings of missions are never deleted'); END;
CREATE VIEW said_last AS
        SELECT mission, camera, frame, grid, row, col, label, annotator, time, source,
            model_version, blind, MAX(id) AS id FROM events WHERE source = 'human'
        GROUP BY mission, camera, frame, grid, row, col, annotator;
CREATE VIEW settled_now AS
        SELECT mission, camera, frame, grid, row, col, label, annotator, time, source,
            model_version, blind, id FROM events WHERE source = 'settled' AND label IS NOT NULL
        AND NOT EXISTS (SELECT 1 FROM events AS other WHERE other.mission = events.mission AND
            other.camera = events.camera AND other.frame = events.frame AND other.grid =
            events.grid AND other.row = events.row AND other.col = events.col
            AND other.source <> 'model' AND other.id > events.id);
PRAGMA application_id = 1953459060;
PRAGMA user_version = 3;
INSERT INTO events VALUES (2, 'Krillé', 'left', 1, '10x10@360', 0, 0, 'taré', 'Åse',
    '2016-04-20T10:00:00Z', 'human', 'lbp/3', 1, NULL);
INSERT INTO events VALUES (5, 'dive', 'left', 1, '10x10@360', 0, 1, 'reef', 'ann',
    '2016-04-20T10:00:00Z', 'human', NULL, 0, NULL);
INSERT INTO seen VALUES ('Krillé', 'left', 1, 'Åse', '2016-04-20T10:00:00Z');
INSERT INTO notes VALUES (1, 'Krillé', 'left', 1, NULL, NULL, NULL, 'murky', 'Åse',
    '2016-04-20T10:00:00Z');
INSERT INTO settings VALUES (1, 'Krillé', 'rate', '2', 'Åse', '2016-04-20T10:00:00Z');
"""
MADE = "SELECT type, name, sql FROM sqlite_master ORDER BY 1, 2"


def _file_of(tmp_path, script):
    path = tmp_path / "labels.db"
    with sqlite3.connect(path) as old:
        old.executescript("PRAGMA journal_mode = WAL;" + script)
    old.close()
    return path


def _is_as_made_new(path):
    with sqlite3.connect(path) as now:
        assert now.execute("PRAGMA user_version").fetchone() == (4,)
        upgraded = now.execute(MADE).fetchall()
        for table in ("events", "actions", "notes", "blindness", "settings"):
            kept = f"{table}_keep_%"
            count = "SELECT COUNT(*) FROM sqlite_master WHERE type = 'trigger' AND name LIKE ?"
            assert now.execute(count, (kept,)).fetchone() == (2,)
    now.close()
    with LabelStore(path.with_name("new.db")) as store:
        assert upgraded == store._connection.execute(MADE).fetchall()


@pytest.fixture
def yesterdays(tmp_path):
    return _file_of(tmp_path, FORMAT_1)


def test_a_format_1_file_is_brought_up_to_date_with_all_that_is_in_it(yesterdays):
    with LabelStore(yesterdays) as store:
        assert store.current() == [_record("ocean", model_version="lbp/3")]
        labels = [said.label for said in history(store, _record(None).cell)]
        assert labels == ["reef", "ocean", "reef"]
        assert [row[0] for row in store.rows_after(0, "dive", GRID)] == [1, 2, 7, 8]
        assert store.last_event() == 8
        assert store.add([_record("sand"), replace(_record("reef"), source="settled")]) == 2
        assert store.last_event() == 10
    with sqlite3.connect(yesterdays) as now, pytest.raises(sqlite3.IntegrityError, match="never"):
        now.execute("DELETE FROM events")
    _is_as_made_new(yesterdays)


def test_a_format_2_file_is_brought_up_to_date_with_all_that_is_in_it(tmp_path):
    path = _file_of(tmp_path, FORMAT_2)
    with LabelStore(path) as store:
        assert store.current() == [
            _record("ocean", model_version="lbp/3"),
            _record("reef", col=1, blind=True),
        ]
        assert store.settled() == [_record("reef", annotator="bob", source="settled")]
        assert [row[0] for row in store.rows_after(0, "dive", GRID)] == [2, 5, 6]
        assert store.seen("dive", "ann") == {("left", 1)}
        assert store.blind_annotators("dive") == set() and store.settings("dive") == {}
        undone = store.undo("ann", "dive", GRID, "u", TIME, target="k")
        assert (undone.action, undone.event, undone.changed) == (5, 7, 1)
        assert store.redo("ann", "dive", GRID, "r", TIME).changed == 1
        assert store.current()[1] == _record("reef", col=1, blind=True)
    _is_as_made_new(path)


def test_a_format_3_file_is_brought_up_to_date_and_names_are_one(tmp_path):
    """Names written with combining marks are those that are written with one character."""
    path = _file_of(tmp_path, FORMAT_3)
    with LabelStore(path) as store:
        mission, who = "Krill\u00e9", "\u00c5se"
        (record,) = store.current(mission)
        assert (record.mission, record.annotator, record.blind) == (mission, who, True)
        assert record.label == "tar\u00e9" and store.grids(mission)
        assert len(store.current("dive")) == 1 and record.file == ""
        assert store.seen(mission, who) == {("left", 1)}
        assert store.settings(mission) == {"rate": "2"} and len(store.notes(mission)) == 1
    _is_as_made_new(path)


def test_a_label_is_of_the_file_that_its_frame_was(tmp_path, store):
    (tmp_path / "dive").mkdir()
    picture = cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1].tobytes()
    (tmp_path / "dive" / "a_1.png").write_bytes(picture)
    store.keep_files(open_mission(tmp_path / "dive"))
    store.add([_record("ocean")])
    (record,) = store.current()
    assert record.file == "a_1.png" and record == _record("ocean")
    store.keep_files(open_mission(tmp_path / "dive"))
    (tmp_path / "dive" / "a_1.png").rename(tmp_path / "dive" / "b_1.png")
    words = "left frame 1 of dive is the file 'b_1.png', and its labels in .* are of 'a_1.png'"
    refuses(words, store.keep_files, open_mission(tmp_path / "dive"))
    refuses(words, store.add, [replace(_record("reef"), file="b_1.png")])
    assert store.current() == [_record("ocean")]


def test_a_label_that_an_undo_of_format_2_brought_back_is_as_blind_as_it_was_given(tmp_path):
    """Ann says reef blind and sand seeing, and takes sand back; of another patch the reverse."""
    rows = [  # event, col, label, action
        *((10, 2, "reef", 10), (11, 2, "sand", 11), (12, 2, "reef", 12), (13, 2, "sand", 13)),
        *((14, 2, "reef", 14), (15, 3, "reef", 11), (16, 3, "sand", 10), (17, 3, "reef", 15)),
        *((18, 4, "reef", None), (19, 4, "sand", 10), (20, 4, "reef", 15), (21, 4, None, 15)),
    ]
    actions = [  # action, kind, blind (an undo's and a redo's is that of what they reverse)
        *((10, "paint", 1, None), (11, "paint", 0, None), (12, "undo", 0, 11)),
        *((13, "redo", 0, 12), (14, "undo", 0, 13), (15, "undo", 1, 10)),
    ]
    script = FORMAT_2 + "".join(
        f"INSERT INTO events VALUES ({event}, 'dive', 'left', 1, '{GRID}', 0, {col},"
        f" {repr(label) if label else 'NULL'}, 'ann', '{TIME}', 'human', NULL,"
        f" {action or 'NULL'});"
        for event, col, label, action in rows
    )
    script += "".join(
        f"INSERT INTO actions VALUES ({number}, 'k{number}', 'ann', 'dive', '{GRID}', '{kind}',"
        f" '{TIME}', 'human', {blind}, {reverses or 'NULL'}, {number}, NULL, NULL, NULL, '{{}}');"
        for number, kind, blind, reverses in actions
    )
    path = _file_of(tmp_path, script)
    with LabelStore(path) as store:
        blind = [
            [(said.label, said.blind) for said in history(store, _record(None, col=col).cell)]
            for col in (2, 3, 4)
        ]
    reef, sand = [("reef", True), ("reef", False)], [("sand", False), ("sand", True)]
    assert blind[0] == [reef[0], sand[0], reef[0], sand[0], reef[0]]
    assert blind[1] == [reef[1], sand[1], reef[1]]
    assert blind[2] == [reef[1], sand[1], reef[1], (None, False)]
    _is_as_made_new(path)


def test_a_server_of_an_older_tokt_that_runs_on_saves_into_the_newer_file(tmp_path):
    path = _file_of(tmp_path, FORMAT_2)
    with sqlite3.connect(path) as older:
        LabelStore(path).close()
        older.execute(
            "INSERT INTO events (mission, camera, frame, grid, row, col, label, annotator, time,"
            " source, model_version, action) VALUES"
            f" ('dive', 'left', 1, '{GRID}', 0, 5, 'reef', 'ann', '{TIME}', 'human', NULL, NULL)"
        )
    older.close()
    with LabelStore(path) as store:
        assert store.current()[-1] == _record("reef", col=5)


def _tables(store):
    """What the small tables say: who is blind, settings, notes in force by place and person."""
    notes = {
        (note.camera, note.frame, note.grid, note.row, note.col, note.annotator): note.text
        for _, note in store.notes_after(0, "dive")
    }
    return store.blind_annotators("dive"), store.settings("dive"), notes


def test_blindness_settings_and_notes_only_grow_and_the_newest_counts(store):
    on_patch = Note("dive", "left", 1, GRID, 0, 3, "coral?", "ann", TIME)
    on_frame = replace(on_patch, grid=None, row=None, col=None, text="murky")
    taken_back = replace(on_patch, text="")
    for _ in range(2):  # what is said again adds nothing
        store.add_note(on_patch)
        store.add_note(on_frame)
        store.set_blind("dive", "ann", blind=True, time=TIME)
        store.set_setting("dive", "obstacle_as", "reef", "ann", TIME)
    store.set_blind("transit", "bob", blind=True, time=TIME)
    store.set_blind("dive", "bob", blind=False, time=TIME)  # bob never was
    store.add_note(replace(taken_back, annotator="bob"))  # bob wrote none
    patch, frame = ("left", 1, GRID, 0, 3, "ann"), ("left", 1, None, None, None, "ann")
    said = {patch: "coral?", frame: "murky"}
    assert _tables(store) == ({"ann"}, {"obstacle_as": "reef"}, said)
    store.add_note(taken_back)
    store.set_blind("dive", "ann", blind=False, time=TIME)
    store.set_setting("dive", "obstacle_as", "sand", "bob", TIME)
    assert _tables(store) == (set(), {"obstacle_as": "sand"}, {**said, patch: ""})
    with sqlite3.connect(store.path) as other:
        for table, rows in ("notes", 3), ("blindness", 3), ("settings", 2):
            assert other.execute(f"SELECT COUNT(*) FROM {table}").fetchone() == (rows,)
            for change in (f"UPDATE {table} SET time = ''", f"DELETE FROM {table}"):
                with pytest.raises(sqlite3.IntegrityError, match="never"):
                    other.execute(change)
    other.close()


def test_an_interrupted_upgrade_leaves_yesterdays_file(yesterdays, monkeypatch):
    def killed(connection):
        upgrade(connection)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("tokt.labels.store.store.upgrade", killed)
        with pytest.raises(KeyboardInterrupt):
            LabelStore(yesterdays)
    with sqlite3.connect(yesterdays) as old:
        assert old.execute("PRAGMA user_version").fetchone() == (1,)
        assert old.execute("SELECT COUNT(*) FROM events").fetchone() == (5,)
        new = "SELECT COUNT(*) FROM sqlite_master WHERE name = 'actions'"
        assert old.execute(new).fetchone() == (0,)
    old.close()
    with LabelStore(yesterdays) as store:
        assert store.last_event() == 8


def test_two_processes_upgrade_at_once(yesterdays):
    code = (
        "import sys; from pathlib import Path; from tokt.labels.store.store import LabelStore\n"
        "sys.stdin.read()\n"
        "with LabelStore(Path(sys.argv[1])) as store: print(store.last_event())"
    )
    command = [sys.executable, "-c", code, str(yesterdays)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    children = [subprocess.Popen(command, **pipes) for _ in range(2)]
    for child in children:
        child.stdin.close()
    for child in children:
        assert child.stdout.read() == "8\n"
        child.stdout.close()
        assert child.wait() == 0


def test_doctor_leaves_a_format_1_file_as_it_is(yesterdays):
    before = {file.name: file.read_bytes() for file in yesterdays.parent.iterdir()}
    finding = label_store_finding(yesterdays.parent)
    assert (finding.state, finding.figures) == ("ok", {"events": 5, "format": 1})
    assert {file.name: file.read_bytes() for file in yesterdays.parent.iterdir()} == before


def test_a_newer_format_is_refused_and_left_alone(store):
    store._connection.execute("PRAGMA user_version = 5")
    store.close()
    refuses("format 5, newer", LabelStore, store.path)


def test_other_files_are_refused_and_left_alone(tmp_path):
    path = tmp_path / "labels.db"
    path.write_text("mission,camera\n" * 100)
    refuses("not a database", LabelStore, path)
    assert path.read_text() == "mission,camera\n" * 100
    foreign = tmp_path / "mlflow.db"
    with sqlite3.connect(foreign) as other:
        other.execute("CREATE TABLE runs (id)")
    other.close()
    before = foreign.read_bytes()
    refuses("another kind of database", LabelStore, foreign)
    assert foreign.read_bytes() == before
    (tmp_path / "file").touch()
    refuses("label store", LabelStore, tmp_path / "file" / "labels.db")


def test_reading_where_there_is_no_store_makes_none(tmp_path):
    refuses("no label store", LabelStore, tmp_path / "a" / "labels.db", create=False)
    assert list(tmp_path.iterdir()) == []


def test_threads_share_a_store(store):
    def label(who):
        for frame in range(20):
            store.add([_record("ocean", annotator=f"ann{who}", frame=frame)])
            store.current(frame=frame)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(label, range(4)))
    assert [entry.patches for entry in store.stats()] == [20] * 4


IMPORT_LOOP = """
import sys
from tokt.cli.labels import labels_app
file, workspace, name, count = sys.argv[1:]
for n in range(int(count)):
    options = ["--annotator", f"{name}{n}", "--workspace", workspace]
    labels_app(["import", file, *options], standalone_mode=False)
    print("acknowledged", f"{name}{n}", flush=True)
"""
ROWS = 300


@pytest.fixture
def label_file(tmp_path):
    rows = [["dive", "left", n // 100, n // 10 % 10, n % 10, "ocean"] for n in range(ROWS)]
    return write_labels(tmp_path / "some.csv", rows)


def _import_loop(file, workspace, name, count):
    command = [sys.executable, "-c", IMPORT_LOOP, str(file), str(workspace), name, str(count)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.process
def test_sigkill_at_any_moment_loses_no_acknowledged_import(tmp_path, label_file):
    chance = random.Random(42)
    acknowledged = set()
    for trial in range(4):
        child = _import_loop(label_file, tmp_path, f"t{trial}n", 10_000)
        lines = [child.stdout.readline()]
        time.sleep(chance.uniform(0, 0.15))
        child.send_signal(signal.SIGKILL)
        lines += child.stdout.readlines()
        child.wait()
        child.stdout.close()
        acknowledged |= set(re.findall(r"^acknowledged (\w+)\n", "".join(lines), re.MULTILINE))
        with LabelStore(tmp_path / "labels.db") as store:
            assert store._connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            counts = Counter(record.annotator for record in store.current())
        assert set(counts.values()) <= {ROWS}
        assert acknowledged <= set(counts)
    assert len(acknowledged) >= 4


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.process
def test_sigkill_while_the_store_is_made(tmp_path, label_file):
    path = tmp_path / "labels.db"
    for _ in range(3):
        for leftover in tmp_path.glob("labels.db*"):
            leftover.unlink()
        child = _import_loop(label_file, tmp_path, "n", 1)
        while not path.exists() and child.poll() is None:
            time.sleep(0.0005)
        child.send_signal(signal.SIGKILL)
        child.communicate()
        with LabelStore(path) as store:
            assert len(store.current()) in (0, ROWS)
            assert store.add([_record("reef", annotator="after")]) == 1


@pytest.mark.process
def test_processes_import_at_once_into_a_store_neither_has_made(tmp_path, label_file):
    children = [_import_loop(label_file, tmp_path / "ws", name, 8) for name in "abc"]
    for child in children:
        output, _ = child.communicate(timeout=MAX_S)
        assert child.returncode == 0
        assert output.count("acknowledged") == 8
    with LabelStore(tmp_path / "ws" / "labels.db") as store:
        counts = Counter(record.annotator for record in store.current())
    assert counts == {f"{name}{n}": ROWS for name in "abc" for n in range(8)}


def test_reader_does_not_wait_for_a_writer(store):
    store.add([_record("ocean")])
    with sqlite3.connect(store.path, isolation_level=None) as writer:
        writer.execute("BEGIN IMMEDIATE")
        # Where it waited, it would do so until it gave up with an error.
        with LabelStore(store.path, create=False) as reader:
            assert len(reader.current()) == 1
        writer.execute("ROLLBACK")


def test_threads_read_while_one_waits_for_another_process_to_write(store):
    store.add([_record("ocean")])
    with sqlite3.connect(store.path, isolation_level=None) as writer:
        writer.execute("BEGIN IMMEDIATE")
        waiting = threading.Thread(target=store.add, args=([_record("sand")],))
        waiting.start()
        time.sleep(0.2)
        assert store.current() == [_record("ocean")]
        assert waiting.is_alive()
        writer.execute("ROLLBACK")
    waiting.join(MAX_S)
    assert store.current() == [_record("sand")]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"row": 10}, "outside the grid 10x10@360"),
        ({"col": -1}, "outside the grid"),
        ({"frame": -1}, "not a frame number"),
        ({"frame": 2**63}, "not a frame number"),
        ({"camera": "Left"}, "camera 'Left'"),
        ({"annotator": ""}, "annotator ''"),
        ({"mission": "a\nb"}, "mission"),
        ({"source": "robot"}, "source 'robot'"),
        ({"source": "model"}, "model version"),
        ({"time": "yesterday"}, "time 'yesterday'"),
        ({"time": "2016-04-20T10:00:00"}, "zone"),
        ({"time": "2016-04-20T12:00:00+02:00"}, "2016-04-20T10:00:00Z"),
    ],
)
def test_records_that_cannot_be(changes, message):
    refuses(message, replace, _record("ocean"), **changes)


def test_utc_text_keeps_the_moment():
    assert utc_text("2016-04-20T12:00:00.25+02:00") == "2016-04-20T10:00:00.250000Z"
    now = utc_now()
    assert utc_text(now) == now
