import os
import random
import signal
from pathlib import Path

import pytest

from tests.calls import answering
from tokt.features.common import atomic

SIZE = 300_000
# Forks a child that writes without end, and kills it after the delay read from stdin.
KILLER = f"""
import os, signal, sys, time
from pathlib import Path
from tokt.features.common import atomic
file, folder = Path(sys.argv[1]) / "file", Path(sys.argv[1]) / "folder"
def write():
    for turn in range(10**9):
        letter = b"ab"[turn % 2 : turn % 2 + 1]
        atomic.write_bytes(file, letter * {SIZE})
        with atomic.new_folder(folder.with_name(f"folder-{{os.getpid()}}-{{turn}}")) as new:
            (new / "one").write_bytes(letter * 1000)
            (new / "two").write_bytes(letter * 1000)
print("ready", flush=True)
for line in sys.stdin:
    child = os.fork()
    if not child:
        write()
    time.sleep(float(line))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    print("killed", flush=True)
"""


@pytest.fixture
def write_and_kill(tmp_path):
    with answering(KILLER, tmp_path) as kill_after:
        yield kill_after


@pytest.mark.skipif(os.name == "nt", reason="needs fork and SIGKILL")
def test_killed_writers_leave_whole_content(tmp_path, write_and_kill):
    assert signal.SIGKILL
    delays = random.Random(1)
    (tmp_path / "file").write_bytes(b"a" * SIZE)
    partials, whole = 0, 0
    for trial in range(600):
        if trial >= 60 and partials and whole:
            break
        # Later ones live longer: on a busy machine a child may not get far in 0.02 s.
        assert write_and_kill(delays.uniform(0.0, 0.02 * (1 + trial // 60))) == "killed"
        assert (tmp_path / "file").read_bytes() in (b"a" * SIZE, b"b" * SIZE)
        for folder in tmp_path.glob("folder-*"):
            whole += 1
            content = sorted((path.name, path.read_bytes()) for path in folder.iterdir())
            letter = content[0][1][:1]
            assert content == [("one", letter * 1000), ("two", letter * 1000)]
        left = list(tmp_path.glob(".partial-*"))
        partials += len(left)
        assert atomic.remove_partials(tmp_path) == len(left)
        assert not list(tmp_path.glob(".partial-*"))
    assert partials > 0, "no kill hit a write; the test proves nothing"
    assert whole > 0, "no write was finished; the test proves nothing"


def test_write_text_and_parents(tmp_path):
    target = tmp_path / "a" / "b" / "c.txt"
    atomic.write_text(target, "bølge\n")
    assert target.read_bytes() == "bølge\n".encode()
    atomic.write_text(target, "")
    assert target.read_bytes() == b""
    assert [path.name for path in target.parent.iterdir()] == ["c.txt"]


def test_a_failed_write_leaves_nothing(tmp_path):
    (tmp_path / "folder" / "inside").mkdir(parents=True)
    with pytest.raises(OSError):
        atomic.write_bytes(tmp_path / "folder", b"x")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
    assert (tmp_path / "folder" / "inside").is_dir()


def test_a_file_that_somebody_reads_is_replaced_when_it_is_closed_or_stays(tmp_path, monkeypatch):
    """Refusals of a rename, which only Windows has of its own."""
    target, refused = tmp_path / "file", []
    target.write_text("a")
    replace = Path.replace

    def refuse(old, new):
        try:
            if os.name != "nt" and not opened.closed:
                raise PermissionError(13, "Permission denied", str(old))
            return replace(old, new)
        except PermissionError:
            refused.append(new)
            if len(refused) == 4:
                opened.close()
            raise

    monkeypatch.setattr(Path, "replace", refuse)
    with target.open() as opened:
        monkeypatch.setattr(atomic, "OPEN_S", 0.0)
        with pytest.raises(PermissionError):
            atomic.write_text(target, "b")
        assert target.read_text() == "a" and refused == [target]
        monkeypatch.setattr(atomic, "OPEN_S", 60.0)
        atomic.write_text(target, "b")
    assert target.read_text() == "b" and refused == [target] * 4
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_new_folder_appears_at_the_end(tmp_path):
    target = tmp_path / "sub" / "new"
    with atomic.new_folder(target) as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "file").write_text("x")
        assert not target.exists()
    assert (target / "deep" / "file").read_text() == "x"
    assert [path.name for path in target.parent.iterdir()] == ["new"]


def test_new_folder_with_an_error_leaves_nothing(tmp_path):
    with pytest.raises(KeyError), atomic.new_folder(tmp_path / "new") as folder:
        (folder / "file").write_text("x")
        raise KeyError("stop")
    assert list(tmp_path.iterdir()) == []


def test_new_folder_keeps_what_is_there(tmp_path):
    (tmp_path / "new").mkdir()
    with pytest.raises(FileExistsError), atomic.new_folder(tmp_path / "new"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


def test_remove_partials(tmp_path):
    assert atomic.remove_partials(tmp_path / "none") == 0
    (tmp_path / ".partial-1-x").mkdir()
    (tmp_path / ".partial-1-x" / "inside").write_text("x")
    (tmp_path / ".partial-2-y").write_text("x")
    (tmp_path / "kept").write_text("x")
    assert atomic.remove_partials(tmp_path, older_than_s=60) == 0
    assert atomic.remove_partials(tmp_path) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
