"""What a runtime starts with when the active model cannot be used, and what it never takes."""

import json
import os

import pytest

from tests.calls import refuses, run_python
from tests.inference.test_faults import hold_row
from tests.models.parts import pack, rehash, unpack
from tokt.models.bundle.bundle import Bundle, bundle_bytes, bundle_from_bytes
from tokt.models.store.check_active import main
from tokt.models.store.health import store_summary
from tokt.models.store.last_good import load_running, remember_good
from tokt.models.store.store import Store


@pytest.fixture
def store(store, bundles):
    """One that went from ``a/1`` over ``b/2`` to ``c/3``, each of which a runtime has used."""
    for name in "abc":
        store.deploy(bundles[name])
        assert remember_good(store, store.active()) == ""
    return store


def damage(store: Store, *bundles: Bundle) -> None:
    for bundle in bundles:
        file = store.bundle_file(bundle.sha256)
        file.write_bytes(file.read_bytes()[:-1])


def runs(store: Store) -> tuple[str, str]:
    bundle, notes = load_running(store)
    return bundle.label, "\n".join(notes)


def test_a_sound_store_runs_its_active_model_without_a_note(store):
    assert load_running(store)[1] == []
    assert runs(store) == ("c/3", "")
    store.last_good_file.write_bytes(b"damaged")
    assert runs(store) == ("c/3", ""), "the copy is not asked for"


def test_a_damaged_active_bundle_runs_from_the_copy(store, bundles):
    damage(store, bundles["c"])
    label, notes = runs(store)
    assert label == "c/3"
    assert "the active model (c/3) is refused: bundle" in notes
    assert "not the one that was deployed" in notes
    assert f"the last good copy runs instead: c/3, sha256 {bundles['c'].sha256[:12]}" in notes
    refuses("not the one that was deployed", store.active)
    assert store_summary(store)["starts_with"]["label"] == "c/3"


def test_then_the_earlier_ones_newest_first(store, bundles):
    store.last_good_file.unlink()
    damage(store, bundles["c"])
    assert runs(store)[0] == "b/2"
    damage(store, bundles["b"])
    label, notes = runs(store)
    assert label == "a/1" and notes.count("is refused") == 2
    assert "the earlier model (a/1) runs instead" in notes
    damage(store, bundles["a"])
    assert refuses("", load_running, store).count("is refused") == 3


def test_the_copy_of_what_ran_last_comes_before_what_never_ran(store, bundles):
    remember_good(store, bundles["a"])
    damage(store, bundles["c"])
    assert runs(store)[0] == "a/1"


def test_a_damaged_copy_is_passed_over(store, bundles):
    damage(store, bundles["c"])
    whole = bundles["c"].data
    for data in (b"", whole[:-1], whole[:500] + b"\x00" + whole[501:], whole + b"x"):
        store.last_good_file.write_bytes(data)
        label, notes = runs(store)
        assert label == "b/2" and "the last good copy is refused" in notes
    store.last_good_file.unlink()
    store.last_good_file.mkdir()
    assert runs(store)[0] == "b/2"
    hold_row(
        "the active bundle and the last good copy are damaged",
        "the earlier model runs; health says so",
        "nothing",
    )


@pytest.mark.parametrize("to", ["", "1"])
def test_never_a_model_that_was_rolled_back_from(store, bundles, to):
    """The runtime was off, so that its copy is still of the model rolled back from."""
    store.rollback("it steered into the tower", to)
    damage(store, bundles["b"])
    label, notes = runs(store)
    assert label == "a/1"
    if not to:
        assert "it was rolled back from" in notes
    damage(store, bundles["a"])
    refuses("it was rolled back from", load_running, store)
    store.deploy(bundles["c"], "it was the lamp")
    damage(store, bundles["c"])
    assert runs(store)[0] == "c/3", "a person took it again"


def test_nor_one_that_an_undo_would_reach_again(store, bundles):
    """a b c a, and back from a: a stands further down the stack as well."""
    store.deploy(bundles["a"])
    remember_good(store, bundles["a"])
    store.rollback("a is bad")
    damage(store, bundles["c"])
    assert runs(store)[0] == "b/2"
    damage(store, bundles["b"])
    refuses("it was rolled back from", load_running, store)
    damage(store)
    store.last_good_file.unlink()
    assert "a/1" not in refuses("", load_running, store), "not even tried"


def test_nor_one_left_by_a_jump(store, bundles):
    store.rollback(to="a/1")
    for name in "bc":
        remember_good(store, bundles[name])
        damage(store, bundles["a"])
        refuses("it was rolled back from", load_running, store)
        store.bundle_file(bundles["a"].sha256).write_bytes(bundles["a"].data)
    store.rollback(to="2")
    remember_good(store, bundles["a"])
    damage(store, bundles["b"])
    refuses("it was rolled back from", load_running, store)


@pytest.mark.parametrize("text", [b"", b"\x00" * 300, b"{"])
def test_a_damaged_pointer_is_read_from_its_copy(store, bundles, text):
    store.rollback()
    (store.path / "active").write_bytes(text)
    label, notes = runs(store)
    assert label == "b/2"
    assert "the active pointer is damaged" in notes
    assert "the model that was active by the history (b/2) runs instead" in notes
    hold_row(
        "the active pointer is damaged",
        "the model that the history ends with runs; health says so",
        "nothing",
    )


def test_a_damaged_pointer_and_a_history_without_the_rollback(store, bundles):
    """Killed before the line was added, then the pointer damaged: the copy knows of it."""
    history = (store.path / "history.jsonl").read_bytes()
    store.rollback("c is bad")
    (store.path / "history.jsonl").write_bytes(history)
    (store.path / "active").write_bytes(b"?")
    assert runs(store)[0] == "b/2"
    damage(store, bundles["b"])
    assert runs(store)[0] == "a/1"
    (store.path / "active.copy").write_bytes(b"?")
    assert runs(store)[0] == "c/3", "three faults at once: the history alone says so"


def test_a_damaged_pointer_and_the_line_of_the_rollback_torn(store, bundles):
    """Power lost while the line was written: the copy says what the line said, or nothing does."""
    store.rollback("c is bad")
    history = (store.path / "history.jsonl").read_bytes()
    for torn in (history[:-30], history[: history.rindex(b'{"number"')] + b"\x00" * 90):
        (store.path / "history.jsonl").write_bytes(torn)
        (store.path / "active").write_bytes(b"")
        assert runs(store)[0] == "b/2"
    (store.path / "active.copy").write_bytes(b"")
    refuses("history line 4 is damaged", load_running, store)


def test_a_lost_pointer(store):
    (store.path / "active").unlink()
    label, notes = runs(store)
    assert label == "c/3" and "the active pointer is gone" in notes
    (store.path / "active.copy").unlink()
    assert runs(store)[0] == "c/3"
    (store.path / "history.jsonl").unlink()
    refuses("no active model", load_running, store)


def test_a_first_deployment_that_was_killed_has_activated_nothing(store, tmp_path):
    new = Store(tmp_path / "new")
    new.path.mkdir()
    (new.path / "active.copy").write_text(json.dumps({**store.history()[0].to_json(), "number": 1}))
    refuses("no active model", load_running, new)


def test_what_a_damaged_history_does_not_say_is_not_taken(store, bundles):
    """Line 2 might have said anything, so that a is not known to be one to go back to."""
    file = store.path / "history.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(lines[0] + b"?\n" + lines[2])
    remember_good(store, bundles["a"])
    damage(store, bundles["c"])
    refuses("not one of the models to go back to", load_running, store)


def test_a_history_whose_lines_are_out_of_order_is_not_gone_back_in(store):
    history = store.path / "history.jsonl"
    lines = history.read_text().splitlines(keepends=True)
    history.write_text("".join(reversed(lines)))
    for name in ("active", "active.copy"):
        (store.path / name).write_text("{")
    refuses("lines are not in their order", load_running, store)
    assert store_summary(store)["starts_with"] is None


def test_a_history_of_a_newer_tokt(store, bundles):
    with (store.path / "history.jsonl").open("a") as handle:
        handle.write('{"format_version": 9}\n')
    damage(store, bundles["c"])
    refuses(r"not the one that was deployed.*newer than this tokt", load_running, store)


def test_a_bundle_that_is_sound_but_was_never_deployed_here(store, bundles, make_content):
    stranger = bundle_from_bytes(bundle_bytes(make_content(9)), "stranger")
    store.last_good_file.write_bytes(stranger.data)
    damage(store, bundles["c"])
    label, notes = runs(store)
    assert label == "b/2" and "not one of the models to go back to" in notes


def test_every_one_needs_the_signature_asked_for_now(store, signed, keys):
    store.trust(keys["boat"].public, "boat")
    # The middle of a long message is cut.
    assert refuses("", load_running, store).count("not signed") >= 3
    for name in "bc":
        store.deploy(signed[name])
        remember_good(store, signed[name])
    damage(store, signed["c"])
    assert runs(store)[0] == "c/3"
    store.trust(keys["other"].public, "other")
    store.distrust(keys["boat"].public.id)
    refuses(r"last_good\.tokt.* does not trust", load_running, store)


def test_a_store_that_cannot_be_written_is_told_not_raised(store, bundles):
    store.last_good_file.unlink()
    store.last_good_file.mkdir()
    words = remember_good(store, bundles["c"])
    assert "no copy of c/3 is kept for the next start" in words and "\n" not in words
    assert not list(store.path.glob(".partial-*"))


def test_a_process_checks_the_active_bundle(store, bundles, capsys):
    done = run_python("-m", "tokt.models.store.check_active", store.path)
    c = bundles["c"]
    assert (done.returncode, done.stderr, done.stdout.count("\n")) == (0, "", 1)
    assert json.loads(done.stdout) == {"sha256": c.sha256, "label": "c/3", "fault": ""}
    loaded = store.runnable(c.sha256, golden=False)
    assert loaded.data == c.data and loaded.label == "c/3"
    damage(store, c)
    assert main([str(store.path)]) == 2
    found = json.loads(capsys.readouterr().out)
    assert (found["sha256"], found["label"]) == (c.sha256, "c/3")
    assert "not the one that was deployed" in found["fault"]
    refuses("not the one that was deployed", store.runnable, c.sha256, golden=False)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe to hang on")
def test_a_check_that_hangs_ends_itself(tmp_path):
    os.mkfifo(tmp_path / "active")
    program = """
import faulthandler, runpy
later = faulthandler.dump_traceback_later
faulthandler.dump_traceback_later = lambda seconds, exit: later(0.1, exit=exit)
runpy.run_module("tokt.models.store.check_active", run_name="__main__")
"""
    done = run_python("-c", program, tmp_path)
    assert (done.returncode, done.stdout) == (1, "")


def test_golden_false_leaves_out_nothing_else(bundles):
    """Another model's golden values pass without their step; an edited byte does not."""
    members = unpack(bundles["a"].data)
    members["golden.npz"] = unpack(bundles["b"].data)["golden.npz"]
    words = r"golden\.npz in the bundle has been edited"
    refuses(words, bundle_from_bytes, pack(members), "a", golden=False)
    data = rehash(members)
    refuses("golden frame 0 gives decision values that differ", bundle_from_bytes, data, "a")
    assert bundle_from_bytes(data, "a", golden=False).label == "a/1"
