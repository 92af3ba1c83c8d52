"""Copies of a label store's file: with its log, without it, and beside the log of another one."""

import shutil
import sqlite3
import sys
from contextlib import closing

import pytest

from tests.calls import refused, run_python, succeeds
from tests.inference.test_faults import hold_row
from tokt.features.common.errors import FAULT
from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord
from tokt.labels.store.health import label_store_finding
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.store.write_ahead_log import log_of

TIME = "2016-04-20T10:00:00Z"
KILLED = """
import os, sys
from pathlib import Path
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import Grid, LabelStore
store = LabelStore(Path(sys.argv[1]))
patches = (("dive", "left", n, Grid(), 0, n % 10) for n in range(*map(int, sys.argv[3:])))
said = sys.argv[2], "2016-04-20T10:00:00Z"
store.add(LabelRecord(*patch, "ocean", *said) for patch in patches)
os.kill(os.getpid(), 9)
"""


def said(who, first, last):
    patches = (("dive", "left", frame, Grid(), 0, frame % 10) for frame in range(first, last))
    return [LabelRecord(*patch, "ocean", who, TIME) for patch in patches]


def labelled_and_killed(file, who, first, last):
    """A process says one label after the other, and is killed: the log has what is new."""
    ran = run_python("-c", KILLED, file, who, first, last)
    assert ran.returncode == -9, ran.stderr
    assert log_of(file).stat().st_size > 0


def labels_in(file):
    with LabelStore(file, create=False) as store:
        return store.current()


@pytest.fixture
def annas(tmp_path):
    """A store whose file has 49 labels, and its log none."""
    file = tmp_path / "anna" / FILE_NAME
    with LabelStore(file) as store:
        store.add(said("anna", 0, 49))
    assert not log_of(file).exists()
    return file


def log_of_another(folder):
    labelled_and_killed(folder / FILE_NAME, "ben", 0, 30)


def log_of_another_with_more(folder):
    labelled_and_killed(folder / FILE_NAME, "ben", 0, 400)


def log_of_long_ago(folder):
    """Of this very store, from before it had its last labels."""
    with LabelStore(folder / FILE_NAME) as store:
        store.add(said("anna", 0, 20))
    labelled_and_killed(folder / FILE_NAME, "anna", 20, 30)


def log_of_later(folder):
    """Of this very store, when there were other labels between."""
    with LabelStore(folder / FILE_NAME) as store:
        store.add(said("anna", 0, 900))
    labelled_and_killed(folder / FILE_NAME, "ben", 0, 300)


LOGS = (log_of_another, log_of_another_with_more, log_of_long_ago, log_of_later)


@pytest.mark.parametrize("make_log", LOGS)
def test_a_log_of_another_file_is_refused_and_nothing_is_changed(annas, tmp_path, make_log):
    make_log(tmp_path / "other")
    shutil.copy(log_of(tmp_path / "other" / FILE_NAME), log_of(annas))
    before = annas.read_bytes(), log_of(annas).read_bytes()
    words = "labels.db-wal is not of this file, or damaged"
    for command in (("stats",), ("backup", tmp_path / "b.db"), ("export", tmp_path / "e.csv")):
        refused(words, "labels", *command, "--workspace", annas.parent)
    doctors = label_store_finding(annas.parent)
    assert doctors.state == FAULT and words in doctors.text and str(annas) in doctors.text
    assert (annas.read_bytes(), log_of(annas).read_bytes()) == before
    assert not (tmp_path / "b.db").exists()
    log_of(annas).unlink()
    assert labels_in(annas) == said("anna", 0, 49)
    hold_row(
        "labels.db lies beside the log of another one",
        "refused in one line, code 2; neither is changed",
        "nothing",
    )


@pytest.mark.parametrize("left", ["empty", "missing"])
def test_a_log_without_its_file_is_kept(annas, left):
    """SQLite removes the log of an empty file."""
    labelled_and_killed(annas, "anna", 49, 60)
    log = log_of(annas).read_bytes()
    annas.write_bytes(b"")
    if left == "missing":
        annas.unlink()
    labels = annas.parent / "more.csv"
    labels.write_text("mission,camera,frame,row,col,label\ndive,left,1,0,0,ocean\n")
    refused(left, "labels", "import", labels, "--annotator", "a", "--workspace", annas.parent)
    assert log_of(annas).read_bytes() == log
    hold_row(
        "labels.db is empty or gone, and its log is there",
        "refused in one line, code 2; the log stays",
        "nothing",
    )


def test_a_killed_process_has_its_log(annas):
    labelled_and_killed(annas, "anna", 49, 200)
    assert labels_in(annas) == said("anna", 0, 200)


def test_a_log_of_which_a_part_was_brought_over(annas, tmp_path):
    """Killed while it was folded, the file by itself is of two times; with the log it is whole."""
    labelled_and_killed(annas, "anna", 49, 400)
    before, log = annas.read_bytes(), log_of(annas).read_bytes()
    assert len(labels_in(annas)) == 400
    after = annas.read_bytes()
    for half in (0, 1):
        mixed = bytearray(after)
        for page in range(half, len(before) // 4096, 2):
            mixed[4096 * page : 4096 * (page + 1)] = before[4096 * page : 4096 * (page + 1)]
        annas.write_bytes(mixed)
        log_of(annas).write_bytes(log)
        assert len(labels_in(annas)) == 400


def test_folding_waits_for_nobody_and_loses_nothing(annas):
    with LabelStore(annas) as store, closing(sqlite3.connect(annas)) as reader:
        store.add(said("anna", 49, 60))
        reader.execute("BEGIN")
        assert reader.execute("SELECT COUNT(*) FROM events").fetchone() == (60,)
        store.add(said("anna", 60, 70))
        with store._transaction():
            store.fold_log()  # somebody reads, and somebody writes
        assert log_of(annas).stat().st_size > 0
        reader.rollback()
        store.fold_log()
        assert log_of(annas).stat().st_size == 0
        alone = shutil.copy(annas, annas.with_name("alone.db"))
        assert labels_in(alone) == store.current() == said("anna", 0, 70)
        store.add(said("anna", 70, 80))
        with LabelStore(annas) as second:  # of this process: its log is not looked at
            assert second.current() == said("anna", 0, 80)


def test_a_backup_of_what_a_killed_process_said(annas, tmp_path):
    labelled_and_killed(annas, "anna", 49, 98)
    target = tmp_path / "stick" / "labels.db"
    ran = succeeds("labels", "backup", target, "--workspace", annas.parent)
    assert ran.out == f"{target}: 98 events, checked\n"
    assert [file.name for file in target.parent.iterdir()] == ["labels.db"]
    with closing(sqlite3.connect(f"{target.as_uri()}?mode=ro&immutable=1", uri=True)) as read:
        assert read.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    assert labels_in(target) == said("anna", 0, 98)
    hold_row("SIGKILL of `tokt label`, then `tokt labels backup`", "every label", "nothing")
    again = "is there already; a backup replaces no file"
    refused(again, "labels", "backup", target, "--workspace", annas.parent)


@pytest.mark.skipif(sys.platform != "linux", reason="needs RLIMIT_FSIZE")
def test_a_backup_to_a_full_disk_leaves_nothing(annas, tmp_path):
    program = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (36_000, 36_000))\n"
    program += "from tokt.cli import main; main()"
    target = tmp_path / "stick" / "labels.db"
    workspace = "--workspace", annas.parent
    ran = run_python("-c", program, "labels", "backup", target, *workspace)
    assert ran.returncode == 2 and ran.stderr.startswith(f"tokt: error: {target}: "), ran.stderr
    assert "nothing was written" in ran.stderr and not list(target.parent.iterdir())
    hold_row("a backup of labels to a full disk", "refused in one line, code 2", "nothing")
