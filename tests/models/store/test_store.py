import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from tests.calls import answering, refuses
from tests.inference.test_faults import hold_row
from tests.models.parts import golden_of
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import Bundle, BundleContent, bundle_bytes, bundle_from_bytes
from tokt.models.operating_point import OperatingPoint
from tokt.models.store.health import store_summary
from tokt.models.store.store import Store


def story(store: Store) -> list[str]:
    return [f"{entry.action} {entry.name}" for entry in store.history()]


def check_consistent(store: Store) -> None:
    """Numbers 1..n; the last entry is the active one; the active bundle works."""
    history = store.history()
    assert [entry.number for entry in history] == list(range(1, len(history) + 1))
    assert history[-1] == store.active_entry()
    active = store.active()
    assert (active.sha256, active.label) == (history[-1].sha256, history[-1].label)


def test_deploy_and_roll_back(store, bundles):
    first = store.deploy(bundles["a"], " first\n sea trial ")
    assert (first.number, first.action, first.label) == (1, "deploy", "a/1")
    assert first.reason == "first sea trial"
    assert store.active().data == bundles["a"].data
    store.deploy(bundles["b"])
    assert store.active().sha256 == bundles["b"].sha256
    back = store.rollback("too many false alarms")
    assert (back.number, back.action, back.label) == (3, "rollback", "a/1")
    assert store.active().sha256 == bundles["a"].sha256
    refuses("no earlier model", store.rollback)
    assert story(store) == ["deploy a", "deploy b", "rollback a"]
    check_consistent(store)


def test_history_content(store, bundles):
    store.deploy(bundles["a"], "åpen\u2028line")
    store.deploy(bundles["c"])
    entries = Store(store.path).history()
    assert [entry.sha256 for entry in entries] == [bundles["a"].sha256, bundles["c"].sha256]
    assert entries[0].reason == "åpen line"
    for entry in entries:
        moment = datetime.fromisoformat(entry.time)
        assert moment.utcoffset() is not None and abs(time.time() - moment.timestamp()) < 100
        assert entry.who and entry.to_json()["format_version"] == 1
    found = store_summary(store)
    assert found["active"] == found["history"][-1]
    assert json.loads(json.dumps(found)) == found
    lines = (store.path / "history.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == found["history"]


def follow(store: Store, bundles: dict[str, Bundle], steps: str) -> None:
    """Deploy models by their names; ``<`` goes back, ``<1`` to an entry."""
    for step in steps.split():
        if step.startswith("<"):
            store.rollback(to=step[1:])
        else:
            store.deploy(bundles[step])


@pytest.mark.parametrize(
    ("steps", "active"),
    [
        ("a b < ", "a"),
        ("a b c < < ", "a"),
        ("a b < c < ", "a"),
        ("a b a < ", "b"),
        ("a b a < < ", "a"),
        ("a a b < ", "a"),
        ("a b c < b < ", "a"),
        ("a b c < a < ", "b"),
        ("a b c < a < < ", "a"),
        ("a b c <2 ", "b"),
        ("a b c <2 < ", "a"),
        ("a b c <1 c < ", "a"),
        ("a b < <2 < ", "a"),
        ("a b a b <3 < ", "b"),
    ],
)
def test_rollback_goes_to_what_was_active(store, bundles, steps, active):
    follow(store, bundles, steps)
    assert store.active().name == active
    check_consistent(store)


@pytest.mark.parametrize("steps", ["a", "a a", "a b b <", "a b < a", "a b c < <"])
def test_no_earlier_model(store, bundles, steps):
    follow(store, bundles, steps)
    before = story(store)
    refuses("no earlier model", store.rollback)
    assert story(store) == before
    check_consistent(store)


def test_no_store_and_an_empty_one(store):
    refuses("does not exist", store.active)
    for action in (lambda: store_summary(store), store.rollback):
        refuses(r"store .*store does not exist", action)
    assert not store.path.exists()
    store.path.mkdir(parents=True)
    found = store_summary(store)
    assert found["active"] is found["provenance"] is found["starts_with"] is None
    assert found["history"] == found["warnings"] == [] and not found["keys"]["required"]
    refuses("no earlier model", store.rollback)
    assert not list(store.path.iterdir())
    refuses("no active model", store.active)
    refuses("no earlier model", store.rollback)


def test_a_damaged_version_is_refused_and_made_good(store, bundles):
    follow(store, bundles, "a b")
    file = store.bundle_file(bundles["a"].sha256)
    for edit in (file.read_bytes()[:-1], bundles["c"].data, b""):
        file.write_bytes(edit)
        refuses("not the one that was deployed", store.rollback)
        assert store.active().name == "b"
    file.unlink()
    refuses("No such file", store.rollback)
    file.write_bytes(b"damaged")
    store.deploy(bundles["a"])
    assert store.active().name == "a"
    store.bundle_file(bundles["a"].sha256).write_bytes(b"damaged again")
    refuses("not the one that was deployed", store.active)
    assert store.rollback().name == "b"
    check_consistent(store)


def test_torn_last_line(store, bundles):
    """Every length that a killed writer can leave of its line, and what power loss leaves."""
    follow(store, bundles, "a b")
    file = store.path / "history.jsonl"
    whole = file.read_bytes()
    start = whole.index(b"\n") + 1
    tails = [whole[start:end] for end in range(start, len(whole))]
    tails += [b"\x00" * 50, b"\xff\xfe", b"\xff\n", b"{}\n", b"\n", b"null"]
    for tail in tails:
        file.write_bytes(whole[:start] + tail)
        assert story(store) == ["deploy a", "deploy b"]
        assert store.history()[-1] == store.active_entry()
    for tail in tails[:: len(tails) // 8] + tails[-6:]:
        file.write_bytes(whole[:start] + tail)
        expected = [*story(store), "deploy c", "rollback b"]
        store.deploy(bundles["c"])
        store.rollback()
        assert story(store) == expected
        check_consistent(store)
        assert len(file.read_text().splitlines()) == 4
        (store.path / "active").write_text(json.dumps(json.loads(whole[start:])))


def test_a_damaged_line_before_the_last(store, bundles):
    follow(store, bundles, "a b")
    file = store.path / "history.jsonl"
    lines = file.read_text().splitlines()
    damaged = "\n".join([lines[0][:-9], lines[1]]) + "\n"
    file.write_text(damaged)
    for action in (store.history, store.rollback):
        refuses("history line 1 is damaged", action)
    assert store.active().name == "b"
    found = store_summary(store)
    assert [entry["name"] for entry in found["history"]] == ["b"]
    assert found["active"]["name"] == "b" and found["provenance"]["dataset"] == "drawn@2"
    assert len(found["warnings"]) == 1 and "history line 1 is damaged" in found["warnings"][0]
    assert file.read_text() == damaged

    notices: list[str] = []
    assert store.deploy(bundles["c"], notice=notices.append).number == 3
    (kept,) = store.path.glob("*damaged*")
    assert kept.name.startswith("history.damaged-2") and kept.suffix == ".jsonl"
    assert kept.read_text() == damaged
    assert len(notices) == 1 and kept.name in notices[0]
    assert story(store) == ["deploy b", "deploy c"] and store_summary(store)["warnings"] == []
    assert store.rollback().name == "b"


def test_no_rollback_across_a_lost_line(store, bundles):
    follow(store, bundles, "a b c")
    file = store.path / "history.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(lines[0] + lines[1].replace(b'"b"', b'"\xff"') + lines[2])
    with pytest.warns(UserWarning, match="was damaged"):
        store.deploy(bundles["a"])
    assert [entry.number for entry in store.history()] == [1, 3, 4]
    assert store.rollback().name == "c"
    refuses("no earlier model", store.rollback)  # it was b, not a


def test_nor_across_a_second_lost_line(store, bundles):
    """After the first one there are fewer lines than numbers were given."""
    follow(store, bundles, "a b c")
    file = store.path / "history.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(lines[0] + b"?\n" + lines[2])
    store.deploy(bundles["a"], notice=str)
    file.write_bytes(file.read_bytes()[:-20])
    (store.path / "active").write_bytes(b"?")
    assert store.deploy(bundles["b"], notice=str).number == 5
    refuses("no earlier model", store.rollback)  # it was a, not c


def test_interrupted_between_pointer_and_history(store, bundles):
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
    "who": "pilot",
}
ACTIVE |= {"time": "2026-01-01T00:00:00+00:00", "reason": "", "format_version": 1}


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
    ids=lambda text: text[:40],
)
def test_damaged_pointer(store, bundles, text):
    store.path.mkdir(parents=True)
    (store.path / "active").write_text(text)
    for action in (store.active, store.history, store.rollback):
        refuses("the active pointer is damaged", action)
    assert (store.path / "active").read_text() == text
    assert "active pointer is damaged" in store_summary(store)["warnings"][0]
    notices: list[str] = []
    store.deploy(bundles["a"], notice=notices.append)
    (kept,) = store.path.glob("active.damaged-*")
    assert kept.read_text() == text and kept.name in notices[0]
    assert story(store) == ["deploy a"]
    check_consistent(store)


def test_a_damaged_pointer_costs_no_history(store, bundles):
    follow(store, bundles, "a b")
    (store.path / "active").write_bytes(b"\xff\x00")
    found = store_summary(store)
    assert found["active"] is None and found["provenance"] is None
    assert [entry["name"] for entry in found["history"]] == ["a", "b"]
    with pytest.warns(UserWarning, match="active was damaged"):
        store.deploy(bundles["c"])
    assert story(store) == ["deploy a", "deploy b", "deploy c"]
    check_consistent(store)
    assert store.rollback().name == "b"


def test_pointer_and_last_line_damaged(store, bundles):
    follow(store, bundles, "a b")
    for file in ("active", "history.jsonl"):
        whole = (store.path / file).read_bytes()
        (store.path / file).write_bytes(whole[:-40])
    with pytest.warns(UserWarning, match="was damaged"):
        entry = store.deploy(bundles["c"])
    assert entry.number == 3 and story(store) == ["deploy a", "deploy c"]
    assert len(list(store.path.glob("*.damaged-*"))) == 2
    refuses("no earlier model", store.rollback)


def test_newer_format(store, bundles):
    store.deploy(bundles["a"])
    newer = json.dumps({"format_version": 3, "who": {"knows": "what"}})
    history = (store.path / "history.jsonl").read_text()
    (store.path / "history.jsonl").write_text(history + newer + "\n")
    for action in (store.history, store.rollback, lambda: store.deploy(bundles["b"])):
        refuses("history line 2 has format 3, newer than this tokt reads", action)
    (store.path / "active").write_text(newer)
    for action in (store.active, store.rollback, lambda: store.deploy(bundles["b"])):
        refuses("newer than this tokt reads", action)
    assert (store.path / "history.jsonl").read_text() == history + newer + "\n"
    (store.path / "active").write_text("{")
    refuses("newer than this tokt reads", store.deploy, bundles["b"])
    assert (store.path / "active").read_text() == "{"
    assert not list(store.path.glob("*.damaged-*"))
    assert not store.bundle_file(bundles["b"].sha256).exists()


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


def test_a_store_of_format_1_loads(store, bundles):
    for name in "ab":
        file = store.bundle_file(bundles[name].sha256)
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


def test_leftovers_go_with_the_next_activation(store, bundles):
    store.deploy(bundles["a"])
    folders = (store.path, store.bundle_file(bundles["a"].sha256).parent)
    for age in (0, 48 * 3600):
        for folder in folders:
            partial = folder / f".partial-{age}-x"
            partial.write_text("half")
            os.utime(partial, (time.time() - age, time.time() - age))
    store.deploy(bundles["b"])
    left = [path.name for folder in folders for path in folder.glob(".p*")]
    assert left == [".partial-0-x"] * 2


def fit_for_patches(make_content: Callable[..., BundleContent]) -> Bundle:
    """A sound bundle that judges ready-cut patches: its golden frames are single patches."""
    content = make_content(7)
    grid = Grid(1, 1, None)
    frames = [np.full((27, 36), 7, np.uint8), np.arange(27 * 36, dtype=np.uint8).reshape(27, 36)]
    extractor = build_extractor(content.extractor_spec)
    values = [content.model.decision_values(extractor.describe(x, grid)) for x in frames]
    golden = golden_of(frames, values, [content.model.obstacle_patches(value) for value in values])
    plain = OperatingPoint()
    data = bundle_bytes(replace(content, grid=grid, golden=golden, operating_point=plain))
    return bundle_from_bytes(data, "patches")


def test_a_model_of_patches_is_not_deployed(store, bundles, make_content):
    patches = fit_for_patches(make_content)
    refuses("ready-cut patches", store.deploy, patches)
    assert not store.path.exists()

    # One that an older tokt has deployed.
    store.deploy(bundles["a"])
    file = store.bundle_file(patches.sha256)
    file.parent.mkdir()
    file.write_bytes(patches.data)
    for name in ("active", "history.jsonl"):
        text = (store.path / name).read_text().replace(bundles["a"].sha256, patches.sha256)
        (store.path / name).write_text(text)
    refuses("ready-cut patches", store.active)
    assert "ready-cut patches" in store_summary(store)["warnings"][0]


DEPLOYER = """
import sys
from tokt.models.bundle.bundle import read_bundle
from tokt.models.store.store import Store
bundle = read_bundle(sys.argv[2])
print("ready", flush=True)
sys.stdin.readline()
for turn in range(8):
    Store(sys.argv[1]).deploy(bundle, f"{bundle.name}{turn}")
print("done", flush=True)
"""


def test_two_processes_deploy_at_once(store, bundles, tmp_path):
    with ExitStack() as stack, ThreadPoolExecutor() as pool:
        deployers = []
        for name in "ab":
            (tmp_path / f"{name}.tokt").write_bytes(bundles[name].data)
            deployer = answering(DEPLOYER, store.path, tmp_path / f"{name}.tokt")
            deployers.append(stack.enter_context(deployer))
        assert list(pool.map(lambda ask: ask("go"), deployers)) == ["done"] * 2
    lines = [json.loads(line) for line in (store.path / "history.jsonl").read_text().splitlines()]
    assert [line["number"] for line in lines] == list(range(1, 17))
    assert {line["reason"] for line in lines} == {f"{n}{i}" for n in "ab" for i in range(8)}
    check_consistent(store)
    words = "both are in the history, the later one is active"
    hold_row("two deployments at once", words, "nothing")


def test_a_store_that_another_process_keeps(store, bundles, monkeypatch):
    follow(store, bundles, "a b")
    monkeypatch.setattr("tokt.models.store.store.LOCK_WAIT_S", 0.1)
    holder = (
        "import os, sys; from pathlib import Path\n"
        "from tokt.features.common.atomic import locked\n"
        "with locked(Path(sys.argv[1]), 1):\n"
        "    print('ready', flush=True); sys.stdin.readline(); os.abort()\n"
    )
    with answering(holder, store.path / "lock") as ask:
        for action in (store.rollback, lambda: store.deploy(bundles["c"])):
            refuses("another tokt has been writing", action)
        assert store.active().name == "b" and story(store) == ["deploy a", "deploy b"]
        ask("die")
    assert store.rollback().name == "a"


def test_a_reason_typed_in_another_encoding(store, bundles, monkeypatch):
    """What Python makes of a Latin-1 terminal's bytes must not damage the store's own entry."""
    monkeypatch.setenv("LOGNAME", "bj\udcf8rn")
    entry = store.deploy(bundles["a"], "b\udcf8lge \x1b[2J")
    assert (entry.who, entry.reason) == ("bj?rn", "b?lge ?[2J")
    check_consistent(store)


def test_history_lost(store, bundles):
    store.deploy(bundles["a"])
    (store.path / "history.jsonl").unlink()
    check_consistent(store)
    store.deploy(bundles["b"])
    assert story(store) == ["deploy a", "deploy b"]
    check_consistent(store)


def test_a_broken_active_bundle_is_shown_with_a_warning(store, bundles):
    store.deploy(bundles["a"])
    assert store_summary(store)["provenance"] == bundles["a"].content.provenance
    store.bundle_file(bundles["a"].sha256).write_bytes(bundles["a"].data[:-1])
    found = store_summary(store)
    assert found["active"]["name"] == "a" and found["provenance"] is None
    assert len(found["warnings"]) == 1 and "not the one that was deployed" in found["warnings"][0]
