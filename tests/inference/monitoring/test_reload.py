"""A store's new active model beside the running one; with real stores and real bundles."""

import json
import time
from dataclasses import replace
from typing import Any

import pytest

from tests.inference.live import HandSource, Listener, looping
from tests.waiting import until
from tokt.inference.config import Limits
from tokt.inference.monitoring.reload import BundleCheck, ModelReloader, check_in_child
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.report import EventQueue
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import ReloadableTextureDetector, TextureDetector
from tokt.models.bundle.bundle import Bundle, bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.store.last_good import load_running
from tokt.models.store.store import Store


@pytest.fixture
def make_bundle(bundle_file):
    content = read_bundle(bundle_file).content

    def make(version: str) -> Bundle:
        return bundle_from_bytes(bundle_bytes(replace(content, version=version)), version)

    return make


@pytest.fixture
def store(tmp_path, make_bundle):
    made = Store(tmp_path / "store")
    made.deploy(make_bundle("1"))
    return made


class Watched:
    """A watch over a store, looked at by hand; what it put and told."""

    def __init__(self, store: Store, clock: Any, misfit: str = "", copy_of: Bundle | None = None):
        self.put: list[str] = []
        self.checks = 0
        misfit_of, put = (lambda bundle: misfit), (lambda bundle: self.put.append(bundle.label))
        self.watch = ModelReloader(
            *(store, copy_of or store.active(), misfit_of, put, clock, self._check),
            is_active=copy_of is None,
        )

    def _check(self, store: Store) -> BundleCheck:
        self.checks += 1
        try:
            return BundleCheck(store.active().sha256, "")
        except Exception as error:  # noqa: BLE001 - as the child process tells it
            return BundleCheck("", str(error))

    def look(self) -> list[str]:
        self.watch.look()
        return [f"{event.name}: {event.words}" for event in self.watch.exchange()]


def test_a_new_model_is_put_between_frames_and_told(store, make_bundle, hand_clock):
    watched = Watched(store, hand_clock)
    assert watched.look() == [] and watched.checks == 0
    store.deploy(make_bundle("2"))
    assert watched.look() == ["model: model noise/2 runs from the next frame on"]
    assert watched.look() == [] and (watched.put, watched.checks) == (["noise/2"], 1)
    store.rollback()
    assert len(watched.look()) == 1 and watched.put[-1] == "noise/1"


def test_a_damaged_one_is_refused_once_and_tried_again_later(store, make_bundle, hand_clock):
    watched = Watched(store, hand_clock)
    entry = store.deploy(make_bundle("2"))
    file = store.bundle_file(entry.sha256)
    whole = file.read_bytes()
    file.write_bytes(whole[:-10])
    told = watched.look()
    assert len(told) == 1 and told[0].startswith("model_refused: model noise/2 is refused: ")
    assert told[0].endswith("; the running model goes on")
    assert watched.look() == [] and watched.checks == 1
    hand_clock.now += 31
    assert watched.look() == [] and watched.checks == 2  # told once
    file.write_bytes(whole)
    hand_clock.now += 31
    assert len(watched.look()) == 1 and watched.put == ["noise/2"]


def test_the_active_one_takes_its_copy_s_place_once_it_is_made_good(store, hand_clock):
    active = store.active()
    store.bundle_file(active.sha256).write_bytes(b"damaged")
    watched = Watched(store, hand_clock, copy_of=active)
    assert watched.look()[0].startswith("model_refused: model noise/1 is refused: ")
    store.deploy(active)
    assert watched.look() == ["model: model noise/1 runs from the next frame on"]
    assert watched.look() == [] and watched.put == ["noise/1"]


def test_the_fault_of_one_that_became_active_meanwhile_is_not_the_other_s(
    store, make_bundle, hand_clock
):
    watched = Watched(store, hand_clock)
    store.deploy(make_bundle("2"))
    watched.watch.check = lambda _: BundleCheck(make_bundle("3").sha256, "3 is damaged")
    assert watched.look() == []


def test_a_damaged_pointer_changes_nothing(store, hand_clock):
    watched = Watched(store, hand_clock)
    (store.path / "active").write_text("{")
    told = watched.look()
    assert len(told) == 1 and "pointer is damaged" in told[0]
    assert watched.look() == [] and watched.put == []


def test_one_that_does_not_fit_the_run_is_refused(store, make_bundle, hand_clock):
    watched = Watched(store, hand_clock, misfit="its frames are 480 px wide")
    store.deploy(make_bundle("2"))
    assert "refused: its frames are 480 px wide" in watched.look()[0]
    assert watched.put == []


def test_one_that_kills_its_checks_is_refused(store, make_bundle, monkeypatch):
    for python, words in (("/bin/false", "died with exit code 1"), ("/none", "cannot be run")):
        monkeypatch.setattr("tokt.inference.monitoring.reload.sys.executable", python)
        assert words in check_in_child(store).fault


def test_a_run_goes_over_to_the_new_model_and_remembers_it(
    store, make_bundle, draw_frame, monkeypatch, hand_clock
):
    monkeypatch.setattr("tokt.inference.monitoring.reload.POLL_S", 0.05)
    first = store.active()
    slot = ReloadableTextureDetector(TextureDetector(first))
    watch = ModelReloader(
        store,
        first,
        lambda bundle: "",
        lambda bundle: slot.put(TextureDetector(bundle)),
        hand_clock,
    )
    source, listener = HandSource(hand_clock), Listener()
    runtime = Runtime(
        *(source, SinglePolicy(slot), [], hand_clock, [listener], Limits(5, 5), EventQueue()),
        between=watch.exchange,
    )
    watch.start()
    seed = 0

    def step() -> bool:
        nonlocal seed
        seed += 1
        source.give(draw_frame([(1, 1)], seed))
        time.sleep(0.02)
        return bool(listener.events)

    with looping(runtime):
        step()
        second = make_bundle("2")
        store.deploy(second)
        until(step)
        step()
        until(lambda: listener.reports[-1].verdict.model == "noise/2")
        until(lambda: store.last_good_file.read_bytes() == second.data)
    watch.close()
    models = [report.verdict.model for report in listener.reports]
    assert models == sorted(models, key=str) and set(models) == {"noise/1", "noise/2"}
    assert [event.name for event in listener.events] == ["model"]
    store.bundle_file(second.sha256).write_bytes(b"gone")
    again, notes = load_running(store)
    assert again.sha256 == second.sha256 and len(notes) == 2
    assert json.loads((store.path / "active").read_text())["sha256"] == second.sha256
