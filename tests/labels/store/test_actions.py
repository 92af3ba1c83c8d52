"""Actions of the labelling page in the store: applied, undone, sent twice, interrupted."""

import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.calls import refuses, run_python
from tests.labels.store.said import history
from tests.waiting import MAX_S
from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord
from tokt.labels.store import store as store_module
from tokt.labels.store.actions import Action, ActionHead, ActionResult, Change, Conflict
from tokt.labels.store.store import LabelStore

TIME = "2016-04-20T10:00:00Z"
GRID = Grid()
WHERE = ("ann", "dive", GRID)


def _change(label, base=None, col=0, **more):
    return Change("left", more.pop("frame", 1), 0, col, label, base, **more)


def _action(key, *changes, kind="paint", who="ann", **more):
    return Action(key, who, more.pop("mission", "dive"), GRID, kind, TIME, changes, **more)


def _said(label, *, who="ann", col=0, **more):
    return LabelRecord("dive", "left", 1, GRID, 0, col, label, who, TIME, **more)


def _labels(store, who="ann"):
    return {record.col: record.label for record in store.current(annotator=who)}


def _undo(store, key, **more):
    return store.undo(*WHERE, key, TIME, **more)


def _redo(store, key, **more):
    return store.redo(*WHERE, key, TIME, **more)


def test_an_action_is_written_with_who_when_and_which_model(store):
    changes = (_change("reef", model_version="lbp/3"), _change("ocean", col=1, frame=2))
    done = store.apply(_action("k", *changes, blind=True))
    assert done == ActionResult("k", 1, 2, 2, (), False, (("left", 1), ("left", 2)), "paint")
    first, second = _said("reef", model_version="lbp/3"), replace(_said("ocean", col=1), frame=2)
    expected = [replace(first, blind=True), replace(second, blind=True)]
    assert store.current() == expected
    (row,) = store.rows_after(1, "dive", GRID)
    assert row == (2, "left", 2, 0, 1, "ocean", "ann", "human", None, True)


def test_what_changed_meanwhile_is_not_overwritten(store):
    store.add([_said("reef"), _said("sand", col=1), _said("ocean", col=2)])
    changes = (
        _change("ocean", base=None),  # it is reef
        _change("ocean", base="sand", col=1),
        _change("ocean", base="reef", col=2),  # it is what shall be
        _change(None, base="reef", col=3),  # there is none anyway
    )
    done = store.apply(_action("k", *changes))
    assert (done.changed, done.conflicts) == (1, (Conflict("left", 1, 0, 0, "reef", "ocean"),))
    assert _labels(store) == {0: "reef", 1: "ocean", 2: "ocean"}


def test_undo_and_redo_bring_back_labels_and_their_models(store):
    store.add([_said("sand", model_version="lbp/1")])
    changes = (_change("reef", "sand", model_version="lbp/2"), _change("reef", col=1))
    store.apply(_action("k", *changes))
    done = _undo(store, "u")
    assert (done.changed, done.kind, done.frames) == (2, "paint", (("left", 1),))
    assert store.current() == [_said("sand", model_version="lbp/1")]
    assert _redo(store, "r").kind == "paint"
    assert store.current() == [_said("reef", model_version="lbp/2"), _said("reef", col=1)]
    assert _undo(store, "u2").changed == 2
    assert store.current() == [_said("sand", model_version="lbp/1")]
    labels = [said.label for said in history(store, _said(None).cell)]
    assert labels == ["sand", "reef", "sand", "reef", "sand"]


def test_undo_has_no_limit_and_outlives_the_process(store):
    for n in range(60):
        base = f"class{n - 1}" if n else None
        store.apply(_action(f"k{n}", _change(f"class{n}", base)))
    store.close()
    with LabelStore(store.path) as again:
        for n in reversed(range(60)):
            assert _labels(again) == {0: f"class{n}"}
            assert _undo(again, f"u{n}", target=f"k{n}").changed == 1
        assert _labels(again) == {} and _undo(again, "last") is None
    with LabelStore(store.path) as again:
        for n in range(60):
            assert _redo(again, f"r{n}", target=f"k{n}").changed == 1
        assert _labels(again) == {0: "class59"} and _redo(again, "last redo") is None


def test_the_next_undo_and_redo_are_known(store):
    assert store.history_top(*WHERE) == (None, None)
    store.apply(_action("k1", _change("reef", frame=3), kind="rest"))
    reef = [_change("reef", col=1), _change("reef", col=2), _change("reef", frame=4)]
    store.apply(_action("k2", *reef))
    first = ActionHead("k1", "rest", "left", 3, 1, 1)
    second = ActionHead("k2", "paint", "left", 1, 3, 2)
    assert store.history_top(*WHERE) == (second, None)
    _undo(store, "u")
    assert store.history_top(*WHERE) == (first, second)
    _redo(store, "r")
    _undo(store, "u2")
    assert store.history_top(*WHERE) == (first, second)
    store.apply(_action("k3", _change("sand", col=5)))
    assert store.history_top(*WHERE) == (ActionHead("k3", "paint", "left", 1, 1, 1), None)
    assert _redo(store, "r2") is None


def test_histories_are_kept_apart_by_annotator_mission_and_grid(store):
    coarse = replace(_action("coarse", _change("reef")), grid=Grid(5, 5))
    store.apply(_action("ben", _change("reef"), who="ben"))
    store.apply(_action("m", _change("reef"), mission="b"))
    store.apply(coarse)
    assert _undo(store, "u") is None
    assert store.undo("ann", "dive", Grid(5, 5), "u2", TIME).changed == 1


def test_undo_of_something_else_than_meant_is_refused(store):
    store.apply(_action("k1", _change("reef")))
    store.apply(_action("k2", _change("sand", "reef"), kind="accept"))
    refuses(r"something else was done since.*accept", _undo, store, "u", target="k1")
    assert _labels(store) == {0: "sand"}
    _undo(store, "u", target="k2")
    refuses("something else", _redo, store, "r", target="k1")


def test_a_step_that_could_change_nothing_makes_way_for_the_next(store):
    store.apply(_action("k1", _change("reef", col=1)))
    store.apply(_action("k2", _change("reef")))
    store.add([_said("sand")])
    assert _undo(store, "u").conflicts
    assert [head and head.key for head in store.history_top(*WHERE)] == ["k1", None]
    assert _undo(store, "u2").changed == 1
    store.add([_said("sand", col=1)])
    assert _redo(store, "r").conflicts
    assert store.history_top(*WHERE) == (None, None)


def test_what_is_sent_twice_counts_once(store):
    assert _undo(store, "idle") is None
    paint = _action("k", _change("reef"), _change("reef", "sand", col=1))
    done = store.apply(paint)
    assert done.conflicts
    store.add([_said("ocean", col=4)])
    assert store.apply(paint) == replace(done, repeated=True)
    assert _undo(store, "idle") is None and _labels(store) == {0: "reef", 4: "ocean"}
    undone = _undo(store, "u", target="k")
    assert _undo(store, "u", target="k") == replace(undone, repeated=True)
    redone = _redo(store, "r")
    assert _redo(store, "r") == replace(redone, repeated=True)
    assert _labels(store) == {0: "reef", 4: "ocean"}
    for taken in (_action("u"), _action("k", who="ben"), replace(_action("k"), grid=Grid(5, 5))):
        refuses("taken by another", store.apply, taken)
    refuses("taken by another", _redo, store, "u")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"key": ""}, "key"),
        ({"kind": "undo"}, "kind"),
        ({"source": "model"}, "source"),
        ({"annotator": " ann"}, "annotator"),
        ({"time": "now"}, "time"),
        ({"changes": (_change("reef"), _change("sand"))}, "changed twice"),
        ({"changes": (_change("reef", col=10),)}, "outside the grid"),
        ({"changes": (_change("reef", model_version=""),)}, "model_version"),
    ],
)
def test_actions_that_cannot_be(changes, message):
    refuses(message, replace, _action("k", _change("reef")), **changes)


@pytest.mark.parametrize("chunk", [1, 2, 100])
def test_events_are_read_in_pieces_also_what_comes_meanwhile(store, monkeypatch, chunk):
    monkeypatch.setattr("tokt.labels.store.store._CHUNK", chunk)
    for n in range(3):
        store.apply(_action(f"k{n}", _change("reef", col=n), _change("sand", frame=n + 2)))
        store.add([replace(_said("reef"), mission="transit", col=n)])
        store.add([_said("reef", col=n, who="m", source="model", model_version="lbp/1")])
    assert [row[0] for row in store.rows_after(0, "dive", GRID)] == [1, 2, 5, 6, 9, 10]
    assert [row[0] for row in store.rows_after(5, "dive", GRID)] == [6, 9, 10]
    assert list(store.rows_after(0, "dive", Grid(5, 5))) == []
    assert store.last_event() == 12
    reading = store.rows_after(6, "dive", GRID)
    assert next(reading)[0] == 9
    store.apply(_action("k", _change("sand", col=9)))
    assert [row[0] for row in reading] == ([10, 13] if chunk < 100 else [10])


def test_an_undo_brings_back_whether_the_label_was_given_blind(store):
    store.apply(_action("k0", _change("reef"), blind=True))
    store.apply(_action("k1", _change("ocean", base="reef")))
    for step in (_undo, _undo, _redo):
        step(store, step.__name__ + str(store.last_event()))
    assert [row[-1] for row in store.rows_after(0, "dive", GRID)] == [
        True,
        False,
        True,
        False,
        True,
    ]
    assert store.current() == [_said("reef", blind=True)]


def test_seen_frames(store):
    assert store.seen("dive", "ann") == set()
    for _ in range(2):
        store.mark_seen("dive", "left", 3, "ann", TIME)
    store.mark_seen("dive", "right", 3, "ann", TIME)
    store.mark_seen("dive", "left", 4, "ben", TIME)
    version = store.data_version()
    store.mark_seen("dive", "left", 3, "ann", "2017-04-20T10:00:00Z")
    assert store.data_version() == version
    assert store.seen("dive", "ann") == {("left", 3), ("right", 3)}
    assert store.seen("transit", "ann") == set()


def test_a_frame_that_was_seen_waits_for_nobody(store, monkeypatch):
    monkeypatch.setattr(store_module, "BUSY_S", 0.1)
    store.mark_seen("dive", "left", 3, "ann", TIME)
    with closing(sqlite3.connect(store.path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        store.mark_seen("dive", "left", 3, "ann", TIME)
        refuses("locked", store.mark_seen, "dive", "left", 4, "ann", TIME)


def test_who_waited_long_for_a_thread_still_waits_for_a_process(store, monkeypatch):
    with closing(sqlite3.connect(store.path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        now = [0.0]

        class LateLock(type(store._lock)):
            def __enter__(self):
                now[0] = 1000.0
                return super().__enter__()

        clock = SimpleNamespace(monotonic=lambda: now[0], sleep=lambda s: other.commit())
        monkeypatch.setattr(store_module, "time", clock)
        monkeypatch.setattr(store, "_lock", LateLock())
        store.apply(_action("k", _change("reef")))
    assert _labels(store)


def test_data_version_tells_of_every_write(store):
    with LabelStore(store.path) as other:
        versions = [store.data_version()]
        for n, writer in enumerate((store, other, store, other)):
            writer.apply(_action(f"k{n}", _change("reef", col=n)))
            versions.append(store.data_version())
        writer.mark_seen("dive", "left", 1, "ann", TIME)
        versions.append(store.data_version())
        assert len(set(versions)) == len(versions)
        assert store.data_version() == versions[-1]


def test_actions_are_never_changed_or_deleted(store):
    store.apply(_action("k", _change("reef")))
    with sqlite3.connect(store.path) as other:
        for statement in ("UPDATE actions SET kind = 'x'", "DELETE FROM actions"):
            with pytest.raises(sqlite3.IntegrityError, match="never"):
                other.execute(statement)
    other.close()


def test_a_long_history_makes_no_undo_slower(store):
    """Counted in steps of SQLite's machine: times would tell of the computer."""

    def steps_of_an_undo(key):
        ticks = count()
        store._connection.set_progress_handler(lambda: next(ticks) < 0, 1)
        assert _undo(store, key).changed == 1
        assert store.history_top(*WHERE)[0] is not None
        store._connection.set_progress_handler(None, 0)
        return next(ticks)

    store._connection.execute("PRAGMA synchronous = OFF")
    for n in range(500):
        store.apply(_action(f"k{n}", _change("reef", frame=n)))
        if n == 10:
            early = steps_of_an_undo("early")
    assert steps_of_an_undo("late") < 1.2 * early


CHILD = """
import os, random, signal, sys
from pathlib import Path
from tokt.features.frames.grid import Grid
from tokt.labels.store.actions import Action, Change
from tokt.labels.store.store import LabelStore
path, name, count, steps = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
grid, time = Grid(), "2016-04-20T10:00:00Z"
store = LabelStore(path)
left = steps
def step():
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
if steps:
    store._connection.set_progress_handler(step, 10)
for n in range(count):
    cells = [(row, col) for row in range(10) for col in range(10)]
    changes = tuple(Change("left", n, row, col, "reef", None) for row, col in cells)
    done = store.apply(Action(f"{name}{n}", name, "dive", grid, "paint", time, changes))
    print(f"{name}{n}", flush=True)
    if n % 3 == 2:
        store.undo(name, "dive", grid, f"{name}u{n}", time, target=f"{name}{n}")
        print(f"{name}u{n}", flush=True)
"""


def _child(path, name, count, steps=0):
    command = [sys.executable, "-c", CHILD, str(path), name, str(count), str(steps)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _events_by_key(path):
    with sqlite3.connect(path) as reader:
        assert reader.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        counts = reader.execute(
            "SELECT key, COUNT(*) FROM events LEFT JOIN actions ON actions.id = events.action"
            " GROUP BY 1"
        ).fetchall()
        keys = reader.execute("SELECT COUNT(*) FROM actions").fetchone()[0]
    reader.close()
    assert keys == len(counts)
    return dict(counts)


@pytest.mark.skipif(os.name == "nt", reason="needs SIGKILL")
@pytest.mark.process
def test_sigkill_in_the_middle_of_an_action(tmp_path):
    path = tmp_path / "labels.db"
    LabelStore(path).close()
    acknowledged = set()
    # An action of 100 patches is about 1200 calls of the child's step(), an undo 1600.
    children = [_child(path, f"t{n}x", 60, 3000 + 1051 * n) for n in range(4)]
    for child in children:
        output, _ = child.communicate(timeout=MAX_S)
        assert child.returncode == -signal.SIGKILL
        assert output
        acknowledged |= set(output.split())
    there = _events_by_key(path)
    assert set(there.values()) == {100}
    assert acknowledged <= set(there)
    assert len(set(there) - acknowledged) <= len(children)
    with LabelStore(path) as store:
        for who in store.annotators():
            head, _ = store.history_top(who, "dive", GRID)
            assert head is not None
            assert store.undo(who, "dive", GRID, f"{who} after", TIME, head.key).changed == 100


@pytest.mark.process
def test_processes_act_at_once(tmp_path):
    path = tmp_path / "labels.db"
    children = [_child(path, name, 12) for name in ("anna", "ben")]
    for child in children:
        output, _ = child.communicate(timeout=MAX_S)
        assert child.returncode == 0
        assert len(output.split()) == 16
    with LabelStore(path) as store:
        for who in ("anna", "ben"):
            frames = {record.frame for record in store.current(annotator=who)}
            assert frames == {0, 1, 3, 4, 6, 7, 9, 10}
            assert store.history_top(who, "dive", GRID)[1].key == f"{who}11"


FULL_DISK = """
import resource, sys
from pathlib import Path
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.store.actions import Action, Change
from tokt.labels.store.store import LabelStore
store = LabelStore(Path(sys.argv[1]))
time = "2016-04-20T10:00:00Z"
def act(key, col):
    change = Change("left", 1, 0, col, "reef", None)
    return store.apply(Action(key, "ann", "dive", Grid(), "paint", time, (change,)))
act("before", 0)
store.check_writable()
wal = Path(sys.argv[1] + "-wal").stat().st_size
resource.setrlimit(resource.RLIMIT_FSIZE, (wal, resource.RLIM_INFINITY))
for attempt in (store.check_writable, lambda: act("full", 1), store.check_writable):
    try:
        attempt()
    except ToktError as error:
        print(error)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
store.check_writable()
done = act("full", 1)
print(done.repeated, done.changed)
"""


@pytest.mark.skipif(os.name == "nt", reason="needs RLIMIT_FSIZE")
def test_a_full_disk_is_noticed_and_nothing_half_written(tmp_path):
    path = tmp_path / "labels.db"
    ran = run_python("-c", FULL_DISK, path)
    assert (ran.returncode, ran.stderr) == (0, "")
    *faults, after = ran.stdout.splitlines()
    assert after == "False 1"
    assert len(faults) == 3
    assert all(fault.startswith(f"label store {path}: ") for fault in faults)
    with LabelStore(path) as store:
        assert _labels(store) == {0: "reef", 1: "reef"}


READ_ONLY = """
import os, sys
from pathlib import Path
from tokt.features.common.errors import ToktError
from tokt.labels.store.store import LabelStore
if os.getuid() == 0:
    os.setuid(65534)
try:
    LabelStore(Path(sys.argv[1])).check_writable()
except ToktError as error:
    print(error)
"""


@pytest.mark.skipif(os.name == "nt", reason="needs file modes")
@pytest.mark.parametrize("in_use", [False, True])
def test_a_read_only_file_says_so(in_use):
    # Not pytest's folder: root's child becomes nobody, who could not even enter that.
    with tempfile.TemporaryDirectory() as name:
        folder, path = Path(name), Path(name) / "labels.db"
        with LabelStore(path) as store:
            store.apply(_action("k", _change("reef")))
            modes = {folder: (0o777, 0o555)}
            for file in folder.iterdir() if in_use else [path]:
                modes[file] = (0o666, 0o444)
            if not in_use:
                store.close()
            for file, (everybody, _) in modes.items():
                file.chmod(everybody)
            ran = run_python("-c", READ_ONLY, path)
            assert (ran.stdout, ran.stderr) == ("", "")
            for file, (_, reading) in modes.items():
                file.chmod(reading)
            ran = run_python("-c", READ_ONLY, path)
            folder.chmod(0o755)
        assert (ran.returncode, ran.stderr) == (0, "")
        assert ran.stdout.startswith(f"label store {path}: ")
