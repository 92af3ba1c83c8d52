"""What each fault of a store comes to: rows of faults.md, with real files and disks."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from tests.calls import refuses, run_python
from tests.inference.test_faults import hold_row
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.store.health import store_findings, store_summary
from tokt.models.store.last_good import load_running, remember_good


@pytest.fixture
def store(store, bundles):
    """One that went from ``a/1`` to ``b/2``, which a runtime has used."""
    for name in "ab":
        store.deploy(bundles[name])
    remember_good(store, bundles["b"])
    return store


def runs(store):
    """What a start takes, and its notes."""
    bundle, notes = load_running(store)
    return bundle.label, "\n".join(notes)


def test_an_old_pointer_put_back(store, bundles):
    old = (store.path / "active").read_bytes()
    store.rollback("b warns over sand")
    (store.path / "active").write_bytes(old)
    words = r"pointer \(entry 2, b/2\) contradicts the history, which ends with entry 3 \(rollback"
    for action in (store.active_entry, store.active, store.history, store.rollback):
        refuses(words, action)
    label, notes = runs(store)
    assert label == "a/1" and "the model that was active by the history (a/1) runs" in notes
    assert store_summary(store)["starts_with"]["label"] == "a/1"
    assert "contradicts" in store_summary(store)["warnings"][0]
    states = {found.name: found.state for found in store_findings(store.path)}
    assert states["store active"] == "fault"
    done = run_python("-m", "tokt.models.store.check_active", store.path)
    assert done.returncode == 2 and "contradicts" in json.loads(done.stdout)["fault"]
    store.bundle_file(bundles["a"].sha256).write_bytes(b"damaged")
    refuses("it was rolled back from", load_running, store)  # the copy is of b
    notices: list[str] = []
    assert store.deploy(bundles["c"], notice=notices.append).number == 4
    assert len(notices) == 1 and store.active().label == "c/3"
    hold_row(
        "an old `active` file is put in the pointer's place",
        "refused; the model that the history ends with runs, health says so",
        "nothing",
    )


def test_a_pointer_to_another_model_than_its_line(store, bundles):
    entry = json.loads((store.path / "active").read_text())
    entry |= {"sha256": bundles["a"].sha256, "name": "a", "version": "1"}
    (store.path / "active").write_text(json.dumps(entry))
    refuses(r"\(entry 2, a/1\) contradicts the history, which ends with entry 2", store.active)
    assert runs(store)[0] == "b/2"


def test_a_pointer_that_is_newer_than_the_history_is_the_truth(store, bundles):
    """Killed before the line; or somebody put an old history there."""
    history = (store.path / "history.jsonl").read_bytes()
    for name in "ca":
        store.deploy(bundles[name])
        (store.path / "history.jsonl").write_bytes(history)
        assert runs(store) == (bundles[name].label, "")
    assert runs(store)[0] == "a/1"


def test_the_clock_is_set_back_between_two_commands(store, bundles, monkeypatch):
    class Yesterday(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2001, 1, 1, tzinfo=UTC)

    monkeypatch.setattr("tokt.models.store.history.datetime", Yesterday)
    store.deploy(bundles["c"])
    store.rollback("c is bad")
    times = [entry.time for entry in store.history()]
    assert times != sorted(times) and runs(store) == ("b/2", "")
    store.bundle_file(bundles["b"].sha256).write_bytes(b"damaged")
    store.last_good_file.write_bytes(bundles["c"].data)
    assert runs(store)[0] == "a/1"  # not c, which was rolled back from at an earlier time
    hold_row("the clock is set back between two commands of a store", "as without it", "nothing")


@pytest.mark.skipif(os.name == "nt", reason="needs symbolic links")
def test_a_pointer_that_is_a_symbolic_link(store, bundles, tmp_path):
    pointer, elsewhere = store.path / "active", tmp_path / "elsewhere"
    pointer.rename(elsewhere)
    pointer.symlink_to(elsewhere)
    whole = elsewhere.read_bytes()
    assert runs(store) == ("b/2", "")
    store.rollback()
    assert not pointer.is_symlink() and elsewhere.read_bytes() == whole
    assert runs(store) == ("a/1", "")
    for target, words in ((elsewhere, "contradicts"), (pointer, "symbolic"), ("none", "is gone")):
        pointer.unlink()
        pointer.symlink_to(target)
        label, notes = runs(store)
        assert label == "a/1" and words in notes
    hold_row(
        "the active pointer is a symbolic link",
        "as the file it leads to; the next command puts a file in its place",
        "nothing",
    )


# On a file system of 3 MB that is full to its last byte; what is printed is looked at below.
ON_A_FULL_DISK = """
import json, os, sys
from pathlib import Path
from tokt.features.common.errors import ToktError
from tokt.models.bundle.bundle import read_bundle
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.store.health import store_findings
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store

store = Store(Path(sys.argv[1]) / "store")
a, b, c = (read_bundle(Path(sys.argv[2]) / f"{name}.tokt") for name in "abc")
for bundle in (a, b, a, b):
    store.deploy(bundle)

def fill():
    with open(Path(sys.argv[1]) / "log", "ab", buffering=0) as log:
        try:
            while log.write(b"x" * 4096):
                pass
        except OSError:
            pass

def files():
    return sorted((str(path), path.stat().st_size) for path in store.path.rglob("*"))

def state():
    entries = store.history()
    found = [finding.name for finding in store_findings(store.path) if finding.state == "fault"]
    return [store.active().label, load_running(store)[1], len(entries), found]

told = []
fill()
writer = os.fork() if "writer" in sys.argv else None  # or one that takes every byte that comes free
while writer == 0 and os.getppid() != 1:
    fill()
if "killed" in sys.argv:  # as it wrote into the place kept for it
    for spare in store.path.glob("*.spare"):
        os.truncate(spare, 300)
    fill()
before = files()
try:
    store.deploy(c)
except ToktError as error:
    told.append([str(error), files() == before, state()])
for reason in ("b is bad", "a is bad", "b is bad after all", "damaged"):
    notices, to = [], ""
    if reason == "damaged":
        with open(store.path / "active", "r+b") as pointer:
            pointer.write(b"?")
        to = "2"
    store.rollback(reason * 9, to, notice=notices.append)
    told.append([notices, state()])
    if len(sys.argv) > 3:
        if writer:
            os.kill(writer, 9)
        break
print(json.dumps(told))
"""


def on_a_full_disk(tmp_path, bundles, *arguments):
    for name in "abc":
        (tmp_path / f"{name}.tokt").write_bytes(bundles[name].data)
    (tmp_path / "disk").mkdir(exist_ok=True)
    shell = 'mount -t tmpfs -o size=3m none "$1" && shift && exec "$@"'
    mount = ["unshare", "-m", "sh", "-c", shell, "sh", tmp_path / "disk"]
    python = [sys.executable, "-c", ON_A_FULL_DISK, tmp_path / "disk", tmp_path, *arguments]
    done = subprocess.run([*mount, *python], capture_output=True, text=True, check=False)
    if done.returncode and "Traceback" not in done.stderr:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()[-80:]}")
    assert not done.returncode, done.stderr
    return json.loads(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a file system")
def test_a_rollback_on_a_full_disk(bundles, tmp_path):
    refused, *back = on_a_full_disk(tmp_path, bundles)
    assert "No space left on device" in refused[0]
    assert refused[1:] == [True, ["b/2", [], 4, []]]
    hold_row("a deployment on a full disk", "refused; the store is as it was", "nothing")
    assert [state for _, state in back] == [
        ["a/1", [], 5, []],
        ["b/2", [], 6, []],
        ["a/1", [], 7, []],
        ["b/2", [], 8, []],
    ]
    assert [notices for notices, _ in back[:3]] == [[], [], []]
    (notice,) = back[3][0]
    assert "active was damaged; it cannot be kept: No space left" in notice
    _, (notices, state) = on_a_full_disk(tmp_path, bundles, "writer")
    assert state == ["a/1", [], 5, []] and len(notices) <= 1
    _, (_, state) = on_a_full_disk(tmp_path, bundles, "killed")
    assert state == ["a/1", [], 5, []]
    hold_row("a rollback on a full disk", "the earlier model, by the place kept for it", "nothing")


HOSTILE = "\x1b[2J\x9b1A\u202e\u2066\x07\r\n  signed by key 00 (checked)\u200b\x7f"
SHOWN = r"\x1b[2J\x9b1A\u202e\u2066\x07\r\n  signed by key 00 (checked)\u200b\x7f"


def test_escape_sequences_out_of_files_are_shown_as_text(
    store, make_content, keys, tmp_path, run_tokt
):
    provenance = {"dataset": HOSTILE, "code_version": HOSTILE, "dataset_sources": [HOSTILE]}
    card = f"# {HOSTILE}\nA card.\n"
    content = replace(make_content(5), provenance=provenance, card=card)
    bundle = bundle_from_bytes(bundle_bytes(content), "hostile")
    file = tmp_path / "hostile.tokt"
    file.write_bytes(bundle.data)
    entry = store.deploy(bundle)
    store.trust(keys["boat"].public, "boat")
    store.accept_unsigned()
    for name in ("active", "history.jsonl"):
        text = (store.path / name).read_text().replace(entry.who, "\\u001b[8m\\n\\u202e")
        (store.path / name).write_text(text)
    keys_file = store.path / "keys.json"
    keys_file.write_text(keys_file.read_text().replace('"boat"', json.dumps(HOSTILE)))
    store.last_good_file.write_text("?")
    commands = [("store", store.path), ("doctor", "--store", store.path), ("models", "show", file)]
    for command in commands:
        ran = run_tokt(*command)
        for line in [*ran.out.split("\n"), *ran.err.split("\n")]:
            assert line.isprintable(), line  # and only a card has lines of its own
            assert command[0] == "models" or not line.startswith("  signed by"), line
        as_json = run_tokt(*command, "--json").out
        assert as_json.replace("\n", "").isprintable()
        if command[0] == "store":
            assert f"  dataset: {SHOWN}" in ran.out.splitlines()
            assert f"  {SHOWN}  " in ran.out, "a key's name"
            assert r"by \x1b[8m\n\u202e" in ran.out
            assert json.loads(as_json)["provenance"]["dataset"] == HOSTILE
        if command[0] == "models":
            assert json.loads(as_json)["card"] == card
    hold_row(
        "escape sequences, line breaks or reversed writing in a bundle, the history, the keys",
        "shown as text, such as `\\x1b`",
        "nothing",
    )
