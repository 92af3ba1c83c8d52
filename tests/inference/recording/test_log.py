"""Logs of JSON lines: rotation, crashes, full disks, and reading them back."""

import json
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses, run_python
from tests.tiers import scaled
from tests.waiting import until
from tokt.inference.recording import log as log_module
from tokt.inference.recording.log import (
    JsonLines,
    LinesApart,
    LogGap,
    LogRotation,
    older_file,
    read_log,
)

SMALL = LogRotation(max_mb=0.0001, keep=3)  # 100 bytes: some seven short lines


def numbers(path: Path, gaps: list[LogGap] | None = None) -> list[int]:
    return [line["n"] for line in read_log(path, gaps)]


def write(path: Path, first: int, last: int, rotation: LogRotation | None = SMALL) -> JsonLines:
    log = JsonLines(path, rotation)
    for n in range(first, last + 1):
        log.write({"n": n})
    log.close()
    return log


def test_files_step_on_and_the_oldest_goes(tmp_path):
    path = tmp_path / "run.jsonl"
    log = write(path, 100, 199)
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {"run.1.jsonl", "run.2.jsonl", "run.3.jsonl", "run.jsonl"}
    assert all(p.stat().st_size <= 100 for p in tmp_path.iterdir())
    found = numbers(path)
    assert found == list(range(found[0], 200)) and len(found) > 30
    assert log.failed == 0


def test_a_line_longer_than_a_file_is_kept_whole(tmp_path):
    log = JsonLines(tmp_path / "run.jsonl", SMALL)
    for n in range(3):
        log.write({"n": n, "long": "x" * 300})
    log.close()
    assert numbers(tmp_path / "run.jsonl") == [0, 1, 2]


def test_files_of_others_with_similar_names_are_left_alone(tmp_path):
    others = [tmp_path / name for name in ("run.2016.jsonl", "run.events.jsonl", "run.4.jsonl")]
    for other in others:
        other.write_text('{"n": -1}\n')
    write(tmp_path / "run.jsonl", 0, 100)
    assert {other.read_text() for other in others} == {'{"n": -1}\n'}
    assert numbers(tmp_path / "run.jsonl")[0] == -1  # run.4.jsonl was kept by a larger --log-keep


@pytest.mark.parametrize("renames", range(5))
def test_a_step_that_dies_after_any_rename_loses_no_line(renames, tmp_path, monkeypatch):
    path, roomy = tmp_path / "run.jsonl", LogRotation(SMALL.max_mb, keep=20)
    write(path, 100, 130, roomy)  # 4 files
    whole, done = Path.replace, 0

    def replace(self: Path, target: Path) -> Path:
        nonlocal done
        if done == renames:
            raise KeyboardInterrupt
        done += 1
        return whole(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    log, n = JsonLines(path, roomy), 131
    with suppress(KeyboardInterrupt):
        while n < 150:
            log.write({"n": n})
            n += 1
    monkeypatch.undo()
    assert done == renames and numbers(path) == list(range(100, n))
    write(path, n, 180, roomy)
    assert numbers(path) == list(range(100, 181))


def test_a_step_that_cannot_be_goes_on_in_the_same_file(tmp_path, monkeypatch):
    path = tmp_path / "run.jsonl"

    def refused(self: Path, target: Path) -> Path:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "replace", refused)
    log = write(path, 100, 150)
    monkeypatch.undo()
    assert log.failed == 0 and "cannot be begun: Permission denied" in log.last_error
    assert [p.name for p in tmp_path.iterdir()] == ["run.jsonl"]
    assert numbers(path) == list(range(100, 151))


_WRITER = """
import sys
from tokt.inference.recording.log import JsonLines, LogRotation
log = JsonLines(sys.argv[1], LogRotation(0.0002, 50))
for n in range(int(sys.argv[2]), 10**9):
    log.write({"n": n})
"""


def test_a_killed_process_loses_nothing_but_what_it_had_not_said(tmp_path):
    path, after = tmp_path / "run.jsonl", 100_000
    rng = random.Random(5)
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", _WRITER, str(path), str(after)])
        until(older_file(path, 50).exists)
        time.sleep(rng.uniform(0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait()
        gaps: list[LogGap] = []
        found = numbers(path, gaps)
        assert found == list(range(found[0], found[-1] + 1)) and gaps == []
        after = found[-1] + 1
        for n in range(51):
            (path if n == 0 else older_file(path, n)).unlink(missing_ok=True)


def test_a_log_that_is_written_meanwhile_is_read_without_a_gap(tmp_path):
    path = tmp_path / "run.jsonl"
    log = JsonLines(path, LogRotation(0.01, 8))
    log.write({"n": 0})
    stop = threading.Event()

    def go_on() -> None:
        n = 0
        while not stop.is_set():
            n += 1
            log.write({"n": n})

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        for _ in range(10):
            found = numbers(path)
            assert found == list(range(found[0], found[0] + len(found)))
    finally:
        stop.set()
        thread.join()
        log.close()


def test_damaged_lines_are_told_and_a_torn_end_is_not(tmp_path):
    path = tmp_path / "run.jsonl"
    older = older_file(path, 1)
    older.write_bytes(b'{"n":1}\n{"n":\n[]\n{"n":2}')
    path.write_bytes(b'{"n":3}\n\xff\xfe\n{"n":4}\n{"n":')
    gaps: list[LogGap] = []
    assert numbers(path, gaps) == [1, 2, 3, 4]
    assert [(gap.file, gap.line) for gap in gaps] == [(older, 2), (older, 3), (path, 2)]
    assert [gap.words for gap in gaps] == ["damaged", "not a JSON object", "damaged"]
    assert str(gaps[2]) == f"{path} line 2: damaged"


def test_a_log_is_added_to_after_a_torn_line(tmp_path):
    path = tmp_path / "run.jsonl"
    path.write_bytes(b'{"n":1}\n{"n')
    write(path, 2, 3, None)
    assert path.read_bytes() == b'{"n":1}\n{"n\n{"n":2}\n{"n":3}\n'


@settings(max_examples=scaled(40))
@given(st.lists(st.binary(max_size=12), max_size=6), st.integers(0, 40))
def test_whatever_is_in_the_file_reading_goes_on(parts, cut):
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.jsonl"
        path.write_bytes(b"\n".join([*parts, b""])[:cut] + b'\n{"n":1}\n')
        assert list(read_log(path))[-1:] == [{"n": 1}]


_FULL = """
import json, resource, sys
from tokt.inference.recording.log import JsonLines
log = JsonLines(sys.argv[1])
unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
resource.setrlimit(resource.RLIMIT_FSIZE, (105, unlimited[1]))  # the disk is full at 105 bytes
for n in range(10, 30):
    log.write({"n": n})
failed = log.failed
resource.setrlimit(resource.RLIMIT_FSIZE, unlimited)
for n in range(30, 35):
    log.write({"n": n})
print(json.dumps([failed, log.failed, log.last_error]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs RLIMIT_FSIZE")
def test_a_disk_that_was_full_is_written_again_and_says_what_is_missing(tmp_path):
    path = tmp_path / "run.jsonl"
    failed, failed_later, _ = json.loads(run_python("-c", _FULL, path).stdout)
    gaps: list[LogGap] = []
    found = numbers(path, gaps)
    kept = 105 // len(b'{"n":10}\n')
    assert found == [*range(10, 10 + kept), *range(30, 35)]
    assert failed == failed_later == 20 - kept
    torn, lost = gaps
    assert torn.words == "damaged"
    assert lost.words.startswith(f"lines that could not be written here: {failed} (")


@pytest.mark.parametrize("value", [{"n": float("nan")}, {"n": {1, 2}}])
def test_what_is_no_json_is_counted_and_no_error(value, tmp_path):
    path = tmp_path / "run.jsonl"
    log = JsonLines(path)
    log.write(value)
    log.write({"n": 1})
    log.close()
    gaps: list[LogGap] = []
    assert numbers(path, gaps) == [1] and log.failed == 1
    assert gaps[0].words.startswith("lines that could not be written here: 1 (not JSON")


def test_a_folder_that_went_and_came_back_is_written_again(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    log = JsonLines(folder / "run.jsonl", SMALL)
    for n in range(100, 110):
        log.write({"n": n})
    folder.rename(tmp_path / "away")
    for n in range(110, 130):
        log.write({"n": n})
    (tmp_path / "away").rename(folder)
    for n in range(130, 135):
        log.write({"n": n})
    log.close()
    found = numbers(folder / "run.jsonl")
    assert found[-5:] == list(range(130, 135)) and log.failed > 0
    assert len(found) + log.failed == 35


def test_a_disk_that_takes_long_to_say_no_at_the_start_is_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(log_module, "_PATIENCE_S", 0.05)
    path, first, answered = tmp_path / "disk" / "run.jsonl", JsonLines.open, threading.Event()
    monkeypatch.setattr(JsonLines, "open", lambda lines: (answered.wait(), first(lines)))
    log = LinesApart(path)
    log.write({"n": 1})
    answered.set()
    until(lambda: log.failed == 1)
    path.parent.mkdir()
    log.write({"n": 2})
    until(path.exists)
    monkeypatch.setattr(log_module, "_PATIENCE_S", 10.0)
    log.close()
    gaps: list[LogGap] = []
    assert numbers(path, gaps) == [2] and log.failed == 1
    assert gaps[0].words == "lines that could not be written here: 1 (No such file or directory)"


def test_what_a_user_can_get_wrong(tmp_path):
    refuses(r"log .* cannot be written", JsonLines, tmp_path / "none" / "log.jsonl")
    refuses("does not exist", lambda: list(read_log(tmp_path / "none.jsonl")))
    for rotation in ({"max_mb": 0}, {"max_mb": float("nan")}, {"keep": 0}, {"keep": 100}):
        refuses("", LogRotation, **rotation)
