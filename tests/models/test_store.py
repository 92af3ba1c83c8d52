from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from tokt.features.errors import ToktError
from tokt.models.bundle import Bundle, BundleContent, bundle_bytes, bundle_from_bytes
from tokt.models.store import Store


@pytest.fixture(scope="module")
def bundles(make_content: Callable[..., BundleContent]) -> dict[str, Bundle]:
    """Three models, ``a/1``, ``b/2`` and ``c/3``."""
    return {
        name: bundle_from_bytes(bundle_bytes(make_content(seed, name=name)), name)
        for seed, name in enumerate("abc", 1)
    }


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "ship" / "store")


def story(store: Store) -> list[str]:
    return [f"{entry.action} {entry.name}" for entry in store.history()]


def bundle_file(store: Store, bundle: Bundle) -> Path:
    return store.path / "versions" / bundle.sha256 / "bundle.tokt"


def check_consistent(store: Store) -> None:
    """Numbers 1..n; the last entry is the active one; the active bundle works."""
    history = store.history()
    assert [entry.number for entry in history] == list(range(1, len(history) + 1))
    assert history[-1] == store.active_entry()
    assert store.active().sha256 == history[-1].sha256
    assert store.active().label == history[-1].label


def test_deploy_and_roll_back(store: Store, bundles: dict[str, Bundle]) -> None:
    first = store.deploy(bundles["a"], " first\n sea trial ")
    assert (first.number, first.action, first.label) == (1, "deploy", "a/1")
    assert first.reason == "first sea trial"
    assert store.active().data == bundles["a"].data
    store.deploy(bundles["b"])
    assert store.active().sha256 == bundles["b"].sha256
    back = store.rollback("too many false alarms")
    assert (back.number, back.action, back.label) == (3, "rollback", "a/1")
    assert store.active().sha256 == bundles["a"].sha256
    with pytest.raises(ToktError, match="no earlier model"):
        store.rollback()
    assert story(store) == ["deploy a", "deploy b", "rollback a"]
    check_consistent(store)


def test_history_content(store: Store, bundles: dict[str, Bundle]) -> None:
    store.deploy(bundles["a"], "åpen\u2028line")
    store.deploy(bundles["c"])
    entries = Store(store.path).history()
    assert [entry.sha256 for entry in entries] == [bundles["a"].sha256, bundles["c"].sha256]
    assert entries[0].reason == "åpen line"
    for entry in entries:
        moment = datetime.fromisoformat(entry.time)
        assert moment.utcoffset() is not None and abs(time.time() - moment.timestamp()) < 100
        assert entry.who and entry.format_version == 1
    found = store.to_json()
    assert found["active"] == found["history"][-1]
    assert json.loads(json.dumps(found)) == found
    lines = (store.path / "history.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == found["history"]


@pytest.mark.parametrize(
    ("steps", "active"),
    [
        ("a b < ", "a"),
        ("a b c < < ", "a"),
        ("a b < c < ", "a"),
        ("a b < b < ", "a"),
        ("a b a < ", "b"),
        ("a b a < < ", "a"),
        ("a b b < ", "a"),
        ("a a b < ", "a"),
        ("a b c < b < ", "a"),
        ("a b c < a < ", "b"),
        ("a b c < a < < ", "a"),
    ],
)
def test_rollback_goes_to_what_was_active(
    store: Store, bundles: dict[str, Bundle], steps: str, active: str
) -> None:
    for step in steps.split():
        if step == "<":
            store.rollback()
        else:
            store.deploy(bundles[step])
    assert store.active().name == active
    check_consistent(store)


@pytest.mark.parametrize("steps", ["a", "a a", "a b <", "a b b <", "a b < a", "a b c < <"])
def test_no_earlier_model(store: Store, bundles: dict[str, Bundle], steps: str) -> None:
    for step in steps.split():
        if step == "<":
            store.rollback()
        else:
            store.deploy(bundles[step])
    before = story(store)
    with pytest.raises(ToktError, match="no earlier model"):
        store.rollback()
    assert story(store) == before
    check_consistent(store)


def test_no_store_and_an_empty_one(store: Store) -> None:
    with pytest.raises(ToktError, match="does not exist"):
        store.active()
    assert store.to_json() == {"active": None, "history": []}
    assert not store.path.exists()
    store.path.mkdir(parents=True)
    with pytest.raises(ToktError, match="no active model"):
        store.active()
    with pytest.raises(ToktError, match="no earlier model"):
        store.rollback()


def test_a_store_that_is_a_file(store: Store, bundles: dict[str, Bundle]) -> None:
    store.path.parent.mkdir()
    store.path.write_text("not a folder")
    actions: list[Callable[[], Any]] = [
        store.active,
        store.active_entry,
        store.history,
        store.rollback,
        store.to_json,
        lambda: store.deploy(bundles["a"]),
    ]
    for action in actions:
        with pytest.raises(ToktError):
            action()
    with pytest.raises(ToktError, match="is not a folder"):
        store.active()
    assert store.path.read_text() == "not a folder"


def test_a_damaged_version_is_refused_and_made_good(
    store: Store, bundles: dict[str, Bundle]
) -> None:
    for name in "ab":
        store.deploy(bundles[name])
    file = bundle_file(store, bundles["a"])
    edits = [file.read_bytes()[:-1], bundles["c"].data, b""]
    for edit in edits:
        file.write_bytes(edit)
        with pytest.raises(ToktError, match="not the one that was deployed"):
            store.rollback()
        assert store.active().name == "b"
    file.unlink()
    with pytest.raises(ToktError, match="No such file"):
        store.rollback()
    file.write_bytes(b"damaged")
    store.deploy(bundles["a"])
    assert store.active().name == "a"
    bundle_file(store, bundles["a"]).write_bytes(b"damaged again")
    with pytest.raises(ToktError, match="not the one that was deployed"):
        store.active()
    assert store.rollback().name == "b"
    check_consistent(store)


def test_torn_last_line(store: Store, bundles: dict[str, Bundle]) -> None:
    """Every length that a killed writer can leave of its line, and what power loss leaves."""
    store.deploy(bundles["a"])
    store.deploy(bundles["b"])
    file = store.path / "history.jsonl"
    whole = file.read_bytes()
    start = whole.index(b"\n") + 1
    tails = [whole[start:end] for end in range(start, len(whole))]
    tails += [b"\x00" * 50, b"\xff\xfe", b"\xff\n", b"{}\n", b"\n", b"null"]
    for tail in tails:
        file.write_bytes(whole[:start] + tail)
        check_consistent(store)
        assert story(store) == ["deploy a", "deploy b"]
    for tail in tails[:: len(tails) // 8] + tails[-6:]:
        file.write_bytes(whole[:start] + tail)
        expected = [*story(store), "deploy c", "rollback b"]
        store.deploy(bundles["c"])
        store.rollback()
        assert story(store) == expected
        check_consistent(store)
        assert len(file.read_text().splitlines()) == 4
        (store.path / "active").write_text(json.dumps(json.loads(whole[start:])))


def test_a_damaged_line_before_the_last(store: Store, bundles: dict[str, Bundle]) -> None:
    for name in "ab":
        store.deploy(bundles[name])
    file = store.path / "history.jsonl"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([lines[0][:-9], lines[1]]) + "\n")
    for action in (store.history, store.rollback, lambda: store.deploy(bundles["c"])):
        with pytest.raises(ToktError, match="history line 1 is damaged"):
            action()
    assert store.active().name == "b"


def test_history_lost(store: Store, bundles: dict[str, Bundle]) -> None:
    store.deploy(bundles["a"])
    (store.path / "history.jsonl").unlink()
    check_consistent(store)
    store.deploy(bundles["b"])
    assert story(store) == ["deploy a", "deploy b"]
    check_consistent(store)


def test_interrupted_between_pointer_and_history(store: Store, bundles: dict[str, Bundle]) -> None:
    store.deploy(bundles["a"])
    before = (store.path / "history.jsonl").read_bytes()
    store.deploy(bundles["b"])
    (store.path / "history.jsonl").write_bytes(before)
    check_consistent(store)
    assert store.rollback().name == "a"
    assert story(store) == ["deploy a", "deploy b", "rollback a"]
    assert (store.path / "history.jsonl").read_bytes().count(b"\n") == 3


SHA = "5a" * 32
ACTIVE = {
    "number": 1,
    "action": "deploy",
    "sha256": SHA,
    "name": "a",
    "version": "1",
    "time": "2026-01-01T00:00:00+00:00",
    "who": "pilot",
    "reason": "",
    "format_version": 1,
}


@pytest.mark.parametrize(
    "text",
    ["", "{", "null", "[]", "3", '"a"', "{}", "\x00" * 40, "[" * 100_000]
    + [json.dumps({key: value for key, value in ACTIVE.items() if key != less}) for less in ACTIVE]
    + [json.dumps({**ACTIVE, key: None}) for key in ACTIVE]
    + [json.dumps({**ACTIVE, key: ["x"]}) for key in ACTIVE]
    + [json.dumps({**ACTIVE, key: True}) for key in ACTIVE]
    + [json.dumps({**ACTIVE, "number": "1"}), json.dumps({**ACTIVE, "number": 0})]
    + [json.dumps({**ACTIVE, "number": 1.0}), json.dumps({**ACTIVE, "more": 1})]
    + [json.dumps({**ACTIVE, "format_version": 0}), json.dumps({**ACTIVE, "sha256": "../../x"})],
)
def test_damaged_pointer(store: Store, bundles: dict[str, Bundle], text: str) -> None:
    store.path.mkdir(parents=True)
    (store.path / "active").write_text(text)
    for action in (store.active, store.history, store.rollback, lambda: store.deploy(bundles["a"])):
        with pytest.raises(ToktError, match="the active pointer is damaged"):
            action()
    assert (store.path / "active").read_text() == text


def test_pointer_that_is_not_text_or_not_a_file(store: Store) -> None:
    store.path.mkdir(parents=True)
    (store.path / "active").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ToktError, match="active pointer"):
        store.active()
    (store.path / "active").unlink()
    (store.path / "active").mkdir()
    with pytest.raises(ToktError, match="active pointer"):
        store.active()


def test_newer_format(store: Store, bundles: dict[str, Bundle]) -> None:
    store.deploy(bundles["a"])
    newer = json.dumps({"format_version": 2, "who": {"knows": "what"}})
    history = (store.path / "history.jsonl").read_text()
    (store.path / "history.jsonl").write_text(history + newer + "\n")
    for action in (store.history, store.rollback, lambda: store.deploy(bundles["b"])):
        with pytest.raises(ToktError, match="history line 2 was written by a newer tokt"):
            action()
    (store.path / "active").write_text(newer)
    later: list[Callable[[], Any]] = [
        store.active,
        store.rollback,
        lambda: store.deploy(bundles["b"]),
    ]
    for action in later:
        with pytest.raises(ToktError, match="newer tokt"):
            action()
    assert (store.path / "history.jsonl").read_text() == history + newer + "\n"


YESTERDAY_ACTIVE = """{
  "number": 3,
  "action": "rollback",
  "sha256": "SHA_A",
  "name": "a",
  "version": "1",
  "time": "2026-02-03T10:00:30+00:00",
  "who": "pilot",
  "reason": "false alarms over sand",
  "format_version": 1
}
"""
YESTERDAY_HISTORY = """\
{"number": 1, "action": "deploy", "sha256": "SHA_A", "name": "a", "version": "1", \
"time": "2026-02-01T08:00:00+00:00", "who": "pilot", "reason": "", "format_version": 1}
{"number": 2, "action": "deploy", "sha256": "SHA_B", "name": "b", "version": "2", \
"time": "2026-02-03T09:59:00+00:00", "who": "chief", "reason": "b\\u00f8lge", "format_version": 1}
{"number": 3, "action": "rollback", "sha256": "SHA_A", "name": "a", "version": "1", \
"time": "2026-02-03T10:00:30+00:00", "who": "pilot", "reason": "false alarms over sand", \
"format_version": 1}
"""


def test_a_store_of_format_1_loads(store: Store, bundles: dict[str, Bundle]) -> None:
    for name in "ab":
        file = bundle_file(store, bundles[name])
        file.parent.mkdir(parents=True)
        file.write_bytes(bundles[name].data)
    for name, text in (("active", YESTERDAY_ACTIVE), ("history.jsonl", YESTERDAY_HISTORY)):
        for letter in "ab":
            text = text.replace(f"SHA_{letter.upper()}", bundles[letter].sha256)
        (store.path / name).write_text(text)
    assert store.active().label == "a/1"
    assert story(store) == ["deploy a", "deploy b", "rollback a"]
    assert store.history()[1].reason == "bølge" and store.history()[1].who == "chief"
    store.deploy(bundles["c"])
    assert store.rollback().label == "a/1"
    check_consistent(store)


def test_leftovers_go_with_the_next_activation(store: Store, bundles: dict[str, Bundle]) -> None:
    store.deploy(bundles["a"])
    folders = (store.path, bundle_file(store, bundles["a"]).parent)
    for age in (0, 48 * 3600):
        for folder in folders:
            partial = folder / f".partial-{age}-x"
            partial.write_text("half")
            os.utime(partial, (time.time() - age, time.time() - age))
    store.deploy(bundles["b"])
    assert [[path.name for path in folder.glob(".p*")] for folder in folders] == [
        [".partial-0-x"],
        [".partial-0-x"],
    ]


# Forks a child that deploys and rolls back without end; kills it after the delay from stdin.
KILLER = """
import os, signal, sys, time
from pathlib import Path
import cv2
from tokt.models.bundle import read_bundle
from tokt.models.store import Store
cv2.setNumThreads(1)
store = Store(sys.argv[1])
bundles = [read_bundle(path) for path in sys.argv[2:]]
def act():
    for turn in range(10**9):
        store.deploy(bundles[turn % 3], "again")
        store.deploy(bundles[(turn + 1) % 3])
        if turn % 2:
            store.rollback()
print("ready", flush=True)
for line in sys.stdin:
    child = os.fork()
    if not child:
        act()
    time.sleep(float(line))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    print(os.WTERMSIG(status), flush=True)
"""


@pytest.fixture
def deploy_and_kill(
    store: Store, bundles: dict[str, Bundle], tmp_path: Path
) -> Iterator[Callable[[float], None]]:
    for name, bundle in bundles.items():
        (tmp_path / f"{name}.tokt").write_bytes(bundle.data)
    files = [str(tmp_path / f"{name}.tokt") for name in bundles]
    with subprocess.Popen(
        [sys.executable, "-c", KILLER, str(store.path), *files],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ) as process:
        assert process.stdin and process.stdout
        assert process.stdout.readline() == "ready\n"

        def kill_after(delay_s: float) -> None:
            assert process.stdin and process.stdout
            process.stdin.write(f"{delay_s}\n")
            process.stdin.flush()
            assert process.stdout.readline() == "9\n"

        yield kill_after
        process.stdin.close()


@pytest.mark.skipif(os.name == "nt", reason="needs fork and SIGKILL")
def test_a_killed_deployment_leaves_a_store_that_loads(
    store: Store, bundles: dict[str, Bundle], deploy_and_kill: Callable[[float], None]
) -> None:
    chance = random.Random(8)
    store.deploy(bundles["a"])
    lengths, interrupted = [], 0
    for trial in range(60):
        deploy_and_kill(chance.uniform(0.0, 0.03))
        lines = (store.path / "history.jsonl").read_text().count("\n")
        check_consistent(store)
        interrupted += lines < len(store.history()) or bool(list(store.path.rglob(".partial-*")))
        for partial in store.path.rglob(".partial-*"):
            partial.unlink()
        lengths.append(len(store.history()))
        if trial % 10 == 9:
            store.deploy(bundles["c"], "after a kill")
            check_consistent(store)
    assert lengths == sorted(lengths) and lengths[-1] > 20
    assert interrupted > 0, "no kill hit a write; the test proves nothing"
