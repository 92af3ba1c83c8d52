"""The drift monitor: it tells when features leave training, once, and when they are back."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.inference.conftest import draw
from tokt.features.extractors.spec import build_extractor
from tokt.inference.frame import Frame
from tokt.inference.monitoring.drift import LOOKS_A_WINDOW, MAX_WORST, DriftMonitor, DriftState
from tokt.inference.policy.policy import Judgement, SinglePolicy
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import Event, Report
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import unknown_verdict
from tokt.models.bundle.bundle import Bundle, bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.distribution import Distribution, bin_counts, ks_distances, quantile_edges

WINDOW, DIM = 8, 7
VERDICT = unknown_verdict(Fault(Reason.DARK, "dark"))


def distribution(window: int = WINDOW) -> Distribution:
    """Of standard normal features, with a limit of 0.3 each."""
    features = np.random.default_rng(0).normal(size=(4000, DIM))
    edges = np.array([quantile_edges(column) for column in features.T])
    return Distribution(edges, bin_counts(features, edges), np.full(DIM, 0.1), 3.0, window, 200, 9)


@dataclass
class Model:
    distribution: Distribution | None = field(default_factory=distribution)
    label: str = "drawn/1"
    names: tuple[str, ...] = tuple(f"f{n}" for n in range(DIM))

    @property
    def extractor(self) -> Any:
        return SimpleNamespace(names=self.names)


class Sea:
    """Frames of 50 patches of normal features, into a monitor."""

    def __init__(self, model: Any = None) -> None:
        self.told: list[Event] = []
        self.monitor = DriftMonitor(self.told.append)
        self.monitor.set_model(Model() if model is None else model)
        self.rng = np.random.default_rng(1)
        self.number = 0
        self.seen: list[NDArray[np.float64]] = []

    def give(self, features: NDArray[np.float64] | None) -> None:
        self.number += 1
        frame = Frame(self.number, 100.0 + self.number, None, None)
        judgement = Judgement(VERDICT, features=features)
        self.monitor.judged(frame, judgement, Report(1, self.number, 0.0, 1.0, VERDICT))
        if features is not None:
            self.seen.append(features)

    def frames(self, n: int, shift: float = 0.0, feature: int = 2) -> None:
        for _ in range(n):
            features = self.rng.normal(size=(50, DIM))
            features[:, feature] += shift
            self.give(features)


def test_it_tells_once_and_once_more_when_it_is_over():
    sea = Sea()
    sea.frames(60)
    assert sea.told == [] and not sea.monitor.state.out
    sea.frames(60, shift=3)
    (drift,) = sea.told
    assert sea.monitor.state.out
    assert drift.name == "drift" and "drawn/1" in drift.words and "f2" in drift.words
    # At most a window and the next look later.
    assert 160 < drift.t <= 160 + WINDOW + WINDOW // LOOKS_A_WINDOW
    worst = drift.fields["worst"]
    assert len(worst) == MAX_WORST and worst[0]["feature"] == "f2"
    assert worst[0]["distance"] > worst[0]["limit"] == pytest.approx(0.3)
    assert drift.fields["features_out"] == 1 and drift.fields["features"] == DIM
    assert drift.fields["frames"] == WINDOW and drift.fields["model"] == "drawn/1"
    sea.frames(60)
    assert [event.name for event in sea.told] == ["drift", "drift_over"]
    assert not sea.monitor.state.out


def test_the_distance_is_that_of_the_last_frames():
    sea = Sea()
    sea.frames(3 * WINDOW + 2, shift=0.4)
    model = distribution()
    counts = bin_counts(np.vstack(sea.seen[-WINDOW:]), model.edges)
    expected = ks_distances(counts, model.counts)
    found = sea.monitor.distances
    assert list(found) == list(Model().names)
    assert list(found.values()) == expected.tolist()
    assert found["f2"] == sea.monitor.state.distance == max(expected)
    assert sea.monitor.state.limit == pytest.approx(0.3)


def test_on_the_limit_it_does_not_tell_again_and_again():
    sea = Sea()
    # So many of the patches are beyond all of training: that is the distance; the limit is 0.3.
    for part in [0.28, *[0.32, 0.29] * 8]:
        for _ in range(WINDOW):
            features = sea.rng.normal(size=(1000, DIM))
            features[: int(part * 1000), 2] = 99.0
            sea.give(features)
    assert [event.name for event in sea.told] == ["drift"]
    sea.frames(2 * WINDOW)
    assert [event.name for event in sea.told] == ["drift", "drift_over"]


def test_nothing_is_said_before_the_window_is_full():
    sea = Sea()
    assert sea.monitor.state == DriftState(known=True)
    sea.frames(WINDOW - 1, shift=9)
    assert sea.monitor.state == DriftState(known=True)
    assert sea.told == [] and sea.monitor.distances == {}
    sea.frames(1, shift=9)
    assert [event.name for event in sea.told] == ["drift"]


def test_another_model_begins_anew():
    sea = Sea()
    sea.frames(WINDOW, shift=9)
    assert sea.monitor.state.out
    sea.monitor.set_model(Model(label="drawn/2"))
    drift, over = sea.told
    assert (drift.name, over.name, over.t) == ("drift", "drift_over", drift.t)
    assert over.fields == {"model": "drawn/1"} and "not known" in over.words
    assert sea.monitor.state == DriftState(known=True)
    assert sea.monitor.distances == {}
    sea.frames(WINDOW)
    assert len(sea.told) == 2 and not sea.monitor.state.out


@pytest.mark.parametrize("model", [None, Model(distribution=None)])
def test_without_a_distribution_drift_is_not_known(model):
    sea = Sea()
    sea.monitor.set_model(model)
    sea.frames(3 * WINDOW, shift=9)
    assert sea.told == [] and sea.monitor.state == DriftState()
    assert not sea.monitor.state.known


def test_frames_without_features_are_passed_over():
    sea = Sea()
    for _ in range(WINDOW):
        sea.give(None)
        # Of the model before, judged just before the switch.
        sea.give(np.zeros((50, DIM + 1)))
    assert sea.monitor.state == DriftState(known=True)
    sea.frames(WINDOW)
    assert len(sea.monitor.distances) == DIM


def learnt(bundle: Bundle, pictures: list[NDArray[np.uint8]]) -> Bundle:
    """The bundle with the distribution of these pictures' features."""
    content = bundle.content
    extractor = build_extractor(content.extractor_spec)
    rows = np.vstack([extractor.describe(picture, content.grid) for picture in pictures])
    edges = np.array([quantile_edges(column) for column in rows.T])
    counts, typical = bin_counts(rows, edges), np.full(len(edges), 0.1)
    known = Distribution(edges, counts, typical, 3.0, WINDOW // 2, 20, 8)
    return bundle_from_bytes(bundle_bytes(replace(content, distribution=known)), "learnt")


def test_a_model_knows_the_frames_it_learnt_from_and_not_blurred_ones(bundle_file):
    """Through the real detector, whose features they are."""
    pictures = [draw([(4, 4)], seed) for seed in range(20)]
    bundle = learnt(read_bundle(bundle_file), pictures)
    told: list[Event] = []
    monitor = DriftMonitor(told.append)
    monitor.set_model(bundle)
    policy = SinglePolicy(TextureDetector(bundle))
    # With its contrast kept: a flat frame is not judged at all.
    blurred = [cv2.GaussianBlur(one.astype(float), (0, 0), 1.5) for one in pictures[:WINDOW]]
    changed = [np.clip(20 + 4 * (one - 20), 0, 255).astype(np.uint8) for one in blurred]
    for number, picture in enumerate([*pictures, *changed], 1):
        judgement = policy.judge(Frame(number, float(number), picture, None))
        assert judgement.features is not None
        report = Report(number, number, 0.0, 1.0, judgement.verdict)
        monitor.judged(Frame(number, float(number), picture, None), judgement, report)
        if number == len(pictures):
            assert told == [] and monitor.state.distance is not None
    assert [event.name for event in told] == ["drift"]
