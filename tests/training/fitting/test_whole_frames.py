"""The boundary that moves: the same in a fold, in the runtime and in an evaluation."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest

from tests.calls import succeeds
from tests.fixtures import quiet
from tokt.features.extractors.extractor import build_extractor, extractor_named
from tokt.features.frames.mission import LEFT, open_mission
from tokt.inference.frame import Frame
from tokt.inference.texture.detector import TextureDetector
from tokt.models.bundle.bundle import bundle_bytes
from tokt.models.registry.registry import Registry
from tokt.training.datasets.changed_patches import ChangedPatches
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.split import Split
from tokt.training.evaluation.evaluate import score_mission
from tokt.training.fitting.classifier import decision_values, fit_rows
from tokt.training.fitting.cross_validation import choose_hyperparameters
from tokt.training.fitting.drift_limits import NOVEL_RATE, novelty_limit
from tokt.training.fitting.presets import Hyperparameters, settings_named
from tokt.training.fitting.tracking import log_and_register
from tokt.training.fitting.train import TrainRequest, fit_and_measure
from tokt.training.fitting.whole_frames import WholeFrames, judged

LBP = extractor_named("lbp_24_8")
MOVING = replace(settings_named("water"), landmarks=60, changes=())


def measured(trained, folder, moving):
    """A model of the tiny dataset whose boundary moves or does not, before it is registered."""
    settings = replace(MOVING, moving_boundary=moving)
    dataset = open_dataset("tiny", trained / "datasets")
    request = TrainRequest(dataset, "moving", LBP, "lbp_24_8", settings, Split(3, 1))
    return fit_and_measure(request, folder, quiet, jobs=1, stress=("gain_0.5",))


@pytest.fixture(scope="module")
def made(trained, tmp_path_factory):
    return measured(trained, tmp_path_factory.mktemp("features"), moving=True)


@pytest.fixture(scope="module")
def bundle(made, begun, tmp_path_factory):
    """A registered model of the tiny dataset whose boundary moves."""
    registry = Registry(begun(tmp_path_factory.mktemp("moving") / ".tokt"))
    log_and_register(made, registry)
    return registry.bundle("moving")


def test_a_fold_judges_as_the_runtime_and_an_evaluation_do(bundle, trained, tiny, tmp_path):
    dataset = open_dataset("tiny", trained / "datasets")
    features, whole = described(dataset, dict(bundle.extractor_spec), tmp_path)
    every = np.arange(len(dataset.patches))
    choice = Hyperparameters(bundle.metrics["folds"][0]["penalty"])
    pipeline = fit_rows(features, dataset.targets(), every, choice, MOVING)
    mission, left = open_mission(tiny.path), (dataset.patches.camera == LEFT).to_numpy()
    mine = dataset.patches[left]
    prior, judge = bundle.operating_point.water, partial(decision_values, pipeline)
    values = judged(judge, features, every[left], whole, prior)
    detector, found = TextureDetector(bundle), {}
    numbers = sorted(mine.frame.unique())
    for number in numbers:
        frame = Frame(int(number), 0.0, mission.read(int(number), LEFT), None)
        found[number] = detector.detect(frame)
    cell = mine.row * dataset.grid.cols + mine.col
    told = [found[number].decision_values[at] for number, at in zip(mine.frame, cell, strict=True)]
    np.testing.assert_allclose(values, told, atol=1e-6)
    assert len({found[number].boundary for number in numbers}) > 1
    scored = score_mission(bundle, mission, quiet, [int(number) for number in numbers])
    for number, evaluated in zip(scored.frames, scored.values, strict=True):
        np.testing.assert_array_equal(evaluated, found[number].decision_values)


def test_an_evaluation_with_a_fixed_boundary_is_that_of_a_model_without_prior(
    bundle, tiny, tmp_path
):
    still = replace(bundle.content, operating_point=replace(bundle.operating_point, water=None))
    found = []
    for content, more in ((bundle, ("--fixed-boundary",)), (still, ()), (bundle, ())):
        file = tmp_path / "evaluated.tokt"
        file.write_bytes(bundle_bytes(content))
        given = ("--mission", tiny.path, "--labels", tiny.labels, *more, "--workspace", tmp_path)
        told = json.loads(succeeds("evaluate", file, *given, "--json").out)
        found.append((told["patch"], told["frames"]))
    assert found[0] == found[1] != found[2]


def test_in_a_fold_it_moves_by_frame_and_by_little(made, trained, tmp_path):
    fixed = measured(trained, tmp_path, moving=False)
    assert made.operating_point.water is not None and fixed.operating_point.water is None
    held = {"moving": made.held_out, "fixed": fixed.held_out}
    dataset = made.request.dataset
    frames = dataset.patches.groupby(["mission", "camera", "frame"]).ngroup()
    for one, two in (
        (held["moving"].values, held["fixed"].values),
        (held["moving"].stressed["gain_0.5"], held["fixed"].stressed["gain_0.5"]),
    ):
        moved = pd.Series((two - one)[:, 0]).groupby(frames.to_numpy())
        assert (
            moved.mean().abs().max() <= made.operating_point.water.limit
            and moved.mean().nunique() > 1
        )
        assert (moved.max() - moved.min()).max() < 1e-9, "one boundary a frame"


def test_whole_frames_are_the_labelled_patches_and_more(trained, tmp_path):
    dataset = open_dataset("tiny", trained / "datasets")
    features, whole = described(dataset, LBP.spec, tmp_path)
    own = cached_features(dataset, LBP.spec, tmp_path, quiet, 1)
    np.testing.assert_array_equal(features, own)
    table = dataset.frames.sort_values(["mission", "camera", "frame"])
    extractor, grid = build_extractor(LBP.spec), dataset.grid
    for at, index in zip(whole.at[:3], table.index[:3], strict=True):
        frame = extractor.describe(dataset.read_frame(index), grid)
        np.testing.assert_array_equal(whole.features[at], frame)
    assert len(whole.at) == len(np.unique(whole.frame)) and len(own) < whole.at.size
    tested = np.arange(9, 12)
    frames, values = whole.part(tested).values(lambda table, rows: table[rows, :1])
    assert (frames == np.unique(whole.frame[tested])).all()
    np.testing.assert_array_equal(values[..., 0], whole.features[whole.at[frames], 0])


def test_gray_frames_that_were_held_out_have_a_prior_of_their_own(trained, tmp_path):
    """From changed frames without colour, of which each is judged by a model that knew none."""
    dataset = open_dataset("tiny", trained / "datasets")
    features, whole = described(dataset, LBP.spec, tmp_path)
    targets, rng = dataset.targets(), np.random.default_rng(5)
    source = np.arange(len(targets))
    ocean = features[targets == 0].mean(axis=0)
    fainter = ocean + 0.6 * (features - ocean)
    changes = ChangedPatches(np.concatenate([fainter, fainter[:9]]), np.append(source, [-1] * 9))
    whole = replace(whole, gray_changes=changes)
    learnt = dataset.patches, features, targets, MOVING, Split(3, 1)
    prior = choose_hyperparameters(*learnt, whole=whole).prior
    assert prior.gray is not None and prior.gray.gray is None
    assert prior.gray.obstacle < prior.obstacle - 0.1
    few = replace(whole, gray_changes=ChangedPatches(fainter[:50], source[:50]))
    assert choose_hyperparameters(*learnt, whole=few).prior == replace(prior, gray=None)
    # Gray frames of the dataset itself tell of gray, and of nothing else.
    some = replace(few, gray=rng.random(len(whole.gray)) < 0.5)
    mixed = choose_hyperparameters(*learnt, whole=some).prior
    assert mixed.gray is not None and mixed.water != prior.water
    alone = choose_hyperparameters(*learnt, whole=replace(few, gray=~np.zeros_like(some.gray)))
    assert replace(alone.prior, gray=None) == replace(prior, gray=None)


def test_a_gray_frame_is_judged_by_the_prior_of_gray_frames(bundle, tiny, monkeypatch):
    prior = bundle.operating_point.water
    gray = replace(prior, water=prior.water - 1, obstacle=prior.obstacle - 1)
    frame = Frame(4, 0.0, open_mission(tiny.path).read(4, LEFT), None)

    def boundaries(prior):
        one = replace(bundle, operating_point=replace(bundle.operating_point, water=prior))
        features = one.features(frame.left)
        alone = one.values_of(features) - one.values_alone(features)
        moved = TextureDetector(one).detect(frame).boundary
        assert np.allclose(alone, moved)
        return moved

    told = replace(prior, gray=gray)
    assert boundaries(told) == boundaries(prior) != boundaries(gray)
    monkeypatch.setattr(
        type(bundle.extractor), "is_gray", lambda self, features: np.ones(len(features), bool)
    )
    assert boundaries(told) == boundaries(gray)


def described(dataset, spec, cache):
    """Features of the labelled patches, and the frames that they are in."""
    table = cached_features(dataset, spec, cache, quiet, 1, whole_frames=True)
    return table[: len(dataset.patches)], WholeFrames.of(dataset, table, build_extractor(spec))


def test_at_most_one_frame_in_a_hundred_of_known_water_is_too_far(trained):
    dataset = open_dataset("tiny", trained / "datasets")
    distance = np.random.default_rng(2).gamma(2.0, 0.2, len(dataset.patches))
    limit, words = novelty_limit(dataset, distance)
    clear = ~np.asarray(dataset.obstacle_flags(), bool)[dataset.targets()]
    keys = ["mission", "camera", "frame"]
    farthest = dataset.patches[keys].assign(far=distance)[clear].groupby(keys).far.max()
    assert (farthest > limit).mean() <= NOVEL_RATE
    assert (farthest >= limit).mean() > NOVEL_RATE, "no larger than need be"
    assert f"of {len(farthest)} held-out frames" in words
    assert novelty_limit(dataset, np.full(len(dataset.patches), np.nan)) == (None, "")
