"""A store's new active model beside the running one; with real stores and real bundles."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.inference.conftest import draw
from tests.inference.live import HandSource, Listener, looping
from tests.inference.test_faults import hold_row
from tests.models.parts import golden_of
from tests.waiting import until
from tokt.features.extractors.spec import build_extractor
from tokt.inference.config import Limits
from tokt.inference.monitoring.reload import (
    GOOD_FRAMES,
    RETRY_S,
    BundleCheck,
    ModelReloader,
    check_in_child,
)
from tokt.inference.policy.assembly import assemble
from tokt.inference.runtime import Runtime
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import Verdict
from tokt.models.bundle.bundle import Bundle, bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.store.last_good import remember_good
from tokt.models.store.store import Store


@pytest.fixture
def make_bundle(bundle_file):
    content = read_bundle(bundle_file).content

    def make(version: str, large: bool = False) -> Bundle:
        frame = draw_large([(1, 5)]) if large else draw_strip([(1, 5)])
        features = build_extractor(content.extractor_spec).describe(frame, content.grid)
        values = content.model.decision_values(features)
        golden = golden_of([frame], [values], [content.model.obstacle_patches(values)])
        made = replace(content, version=version, golden=golden, frame_sizes=())
        return bundle_from_bytes(bundle_bytes(made), version)

    return make


def draw_strip(patches, seed=0):
    """A frame of a shape that only a model of such frames judges."""
    return draw(patches, seed)[:100]


def draw_large(patches, seed=0):
    """One of another camera, of twice the pixels each way."""
    return np.kron(draw_strip(patches, seed), np.ones((2, 2), np.uint8))


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
        misfit_of = lambda bundle, frame: misfit  # noqa: E731
        put = lambda bundle, note: self.put.append(bundle.label)  # noqa: E731
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


class Run:
    """A live loop on a store, with the real policy; looked at by hand."""

    def __init__(self, store: Store, clock: Any):
        self.store, self.clock = store, clock
        assembly = assemble("texture", store.active, None)
        self.watch = ModelReloader(
            *(store, store.active(), assembly.misfit),
            lambda bundle, note: assembly.texture.put(TextureDetector(bundle), note),
            *(clock, lambda store: BundleCheck(store.active().sha256, "")),
        )
        self.source, self.listener, self.seed = HandSource(clock), Listener(), 0
        self.runtime = Runtime(
            *(self.source, assembly.policy, [], clock, [self.listener, self.watch], Limits(5, 5)),
            between=self.watch.exchange,
        )

    def frames(self, n: int, paint: Any) -> list[str]:
        """Give frames, then look at the store; what the events before the next frame are."""
        for _ in range(n):
            self._give(paint)
        self.watch.look()
        self.watch._remember()
        told = len(self.listener.events)
        for _ in range(2):  # the loop may have been waiting for the first already
            self._give(paint)
        return [f"{event.name}: {event.words}" for event in self.listener.events[told:]]

    def _give(self, paint: Any) -> None:
        self.seed += 1
        judged = len(self.listener.reports)
        self.clock.now += 0.1
        self.source.give(paint([(1, 1)], self.seed))
        until(lambda: len(self.listener.reports) > judged)

    @property
    def verdict(self) -> Verdict:
        return self.listener.reports[-1].verdict

    @property
    def kept(self) -> str:
        file = self.store.last_good_file
        return read_bundle(file).label if file.exists() else ""


def test_a_new_model_of_another_camera_is_refused_until_that_camera_is_there(
    store, make_bundle, hand_clock
):
    run = Run(store, hand_clock)
    with looping(run.runtime):
        assert run.frames(GOOD_FRAMES - 1, draw_strip) == [] and run.kept == ""
        assert run.frames(0, draw_strip) == [] and run.kept == "noise/1"
        store.deploy(make_bundle("2", large=True))
        (told,) = run.frames(1, draw_strip)
        assert told.startswith(
            "model_refused: model noise/2 is refused: it cannot judge the newest"
        )
        assert "frames are 360x100, which the model did not learn" in told
        assert told.endswith("; the running model goes on")
        hand_clock.now += RETRY_S + 1
        assert run.frames(1, draw_strip) == []  # told once
        # A dark frame, and one of another size, say nothing of which model is the right one.
        run.frames(1, lambda patches, seed: draw_strip(patches, seed) // 40)
        hand_clock.now += RETRY_S + 1
        assert run.frames(1, draw_large) == [] and run.verdict.reason == "wrong_size"
        assert run.frames(0, draw_strip) == [] and run.verdict.model == "noise/1"
        hand_clock.now += RETRY_S + 1
        told = run.frames(1 + GOOD_FRAMES, draw_large)  # the other camera has come, after a stall
        assert told == ["model: model noise/2 runs from the next frame on"]
        assert run.verdict.model == "noise/2" and run.kept == "noise/1"
        run.frames(GOOD_FRAMES, draw_large)
        assert run.kept == "noise/2"
    hold_row(
        "a new model of another camera becomes active while it runs",
        "as without it: the old one goes on, and stays the last good one",
        "refusals +1",
    )


def test_a_start_with_a_model_of_another_camera_goes_back_to_the_last_good_one(
    store, make_bundle, hand_clock
):
    assert remember_good(store, store.active()) == ""
    store.deploy(make_bundle("2", large=True))
    run = Run(store, hand_clock)
    with looping(run.runtime):
        assert run.frames(GOOD_FRAMES - 1, draw_strip) == [] and run.verdict.reason == "wrong_size"
        told, runs = run.frames(1, draw_strip)
        assert told.startswith("model_refused: model noise/2 cannot judge what this camera gives: ")
        assert "the last good one runs instead: noise/1, sha256 " in told
        assert runs == "model: model noise/1 runs from the next frame on"
        assert run.verdict.model == "noise/1" and "instead: noise/1" in run.verdict.health
        hand_clock.now += RETRY_S + 1
        (told,) = run.frames(GOOD_FRAMES, draw_strip)
        assert "model noise/2 is refused: it cannot judge the newest frame" in told
        assert run.kept == "noise/1" and run.verdict.model == "noise/1"
        # The camera that the active model was made for.
        hand_clock.now += RETRY_S + 1
        assert len(run.frames(1 + GOOD_FRAMES, draw_large)) == 1
        assert run.verdict.model == "noise/2" and run.verdict.health == "ok"
    hold_row(
        "the active model is of another camera at the start",
        "unknown `wrong_size`, after 10 frames the last good one; health says so",
        "refusals +1; switches +1",
    )


def test_a_model_that_waits_to_be_put_in_is_not_blamed_for_the_one_before_it(
    store, make_bundle, hand_clock
):
    """The loop may be in a long frame while the store is looked at again."""
    assert remember_good(store, store.active()) == ""
    store.deploy(make_bundle("2", large=True))
    run = Run(store, hand_clock)
    with looping(run.runtime):
        for _ in range(GOOD_FRAMES):
            run._give(draw_strip)
        assert run.verdict.reason == "wrong_size"
        store.deploy(make_bundle("3"))
        run.watch.look()
        run.watch.look()
        assert run.frames(0, draw_strip) == ["model: model noise/3 runs from the next frame on"]
        assert run.verdict.model == "noise/3"


@pytest.mark.parametrize("last_good", ["", "large", "rolled back from", "damaged"])
def test_there_it_goes_on_saying_unknown_where_the_last_good_one_is_no_better(
    store, make_bundle, hand_clock, last_good
):
    other = make_bundle("3", large=last_good == "large")
    if last_good:
        store.deploy(other)
        assert remember_good(store, other) == ""
    if last_good == "rolled back from":
        store.rollback()
    if last_good == "damaged":
        store.last_good_file.write_bytes(other.data[:-1])
    store.deploy(make_bundle("2", large=True))
    run = Run(store, hand_clock)
    with looping(run.runtime):
        for _ in range(2):
            assert run.frames(GOOD_FRAMES, draw_strip) == [] and run.verdict.reason == "wrong_size"
            hand_clock.now += RETRY_S + 1
        assert not last_good or store.last_good_file.read_bytes()[:-1] in other.data


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


def test_the_next_one_has_to_judge_what_the_one_before_it_did(store, make_bundle, hand_clock):
    """Also where no frame has come since the running one took over."""
    watched, asked = Watched(store, hand_clock), []
    watched.watch.misfit = lambda bundle, frame: asked.append(frame) or ""
    seen = SimpleNamespace(features=np.zeros(1), verdict=SimpleNamespace(model="noise/1"))
    watched.watch.judged("frame", seen, None)
    for version in "23":
        store.deploy(make_bundle(version))
        watched.look()
    assert watched.put == ["noise/2", "noise/3"] and asked == ["frame", "frame"]


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
