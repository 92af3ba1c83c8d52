"""Training and its cross-validation: the same each time, and honest."""

import json
from dataclasses import asdict, replace
from unittest.mock import Mock

import cv2
import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import (
    average_precision_score,
    balanced_accuracy_score,
    precision_recall_fscore_support,
)
from sklearn.model_selection import StratifiedKFold
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from tests.calls import refuses, run_python, succeeds
from tests.fixtures import (
    BUILD_TINY,
    TRAIN_TINY,
    draw_tiny_frame,
    quiet,
    tiny_labels,
    tower_cells,
    write_labels,
)
from tokt.features.extractors.extractor import extractor_named
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import frame_id, read_bundle
from tokt.models.linear import LinearModel
from tokt.models.operating_point import MofNRule
from tokt.models.registry.registry import Registry
from tokt.training.datasets import split as split_module
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import FULL_DIVE, Dives, Fold, blocked_folds
from tokt.training.datasets.split import Split
from tokt.training.evaluation.metrics import class_metrics, obstacle_metrics
from tokt.training.fitting import classifier, cross_validation
from tokt.training.fitting.classifier import decision_values, fit_classifier, fit_rows, linear_model
from tokt.training.fitting.cross_validation import (
    HeldOutPredictions,
    choose_hyperparameters,
    cross_validate,
    held_out_metrics,
)
from tokt.training.fitting.presets import (
    PRESETS,
    Hyperparameters,
    extractor_for,
    preset_for,
    settings_named,
    weighted,
)
from tokt.training.fitting.train import TrainRequest, fit_and_measure

PLAIN = settings_named("plain")
TWO = replace(PLAIN, penalties=(0.01, 1.0))


@pytest.fixture
def request_for(trained):
    """A request to train on the tiny dataset."""

    def make(preset, extractor="lbp", **more):
        dataset = open_dataset("tiny", trained / "datasets")
        settings = settings_named(preset)
        chosen = extractor_for(extractor, preset)
        return TrainRequest(dataset, "m", chosen, extractor, settings, Split(3, 1), **more)

    return make


ELSEWHERE = """
import json, sys
from pathlib import Path
from tokt.training.datasets import split as split_module
from tokt.training.datasets.split import Split
from tokt.training.datasets.dataset import open_dataset
from tokt.training.fitting.presets import extractor_for, settings_named
from tokt.training.fitting.train import TrainRequest, fit_and_measure

data = open_dataset("tiny", Path(sys.argv[1]))
lbp, plain = extractor_for("lbp", "plain"), settings_named("plain")
request = TrainRequest(data, "tiny-lbp", lbp, "lbp", plain, Split(3, 1))
made = fit_and_measure(request, Path(sys.argv[2]), lambda items, *_: items, jobs=2)
model, held_out = made.model, made.held_out
arrays = [model.weights, model.bias, held_out.values]
rule = made.operating_point.rule.to_json()
print(json.dumps([*(array.tobytes().hex() for array in arrays), made.metrics, rule]))
"""


@pytest.mark.process
def test_another_process_with_processes_of_its_own_trains_bit_identical_weights(trained, tmp_path):
    """Against `tokt train` in this process, alone: weights, held-out values, figures, rule."""
    ran = run_python("-c", ELSEWHERE, trained / "datasets", tmp_path, LOKY_MAX_CPU_COUNT="2")
    weights, bias, values, metrics, rule = json.loads(ran.stdout)
    registry = Registry(trained)
    content = registry.bundle("tiny-lbp/1").content
    assert bytes.fromhex(weights) == content.model.weights.tobytes()
    assert bytes.fromhex(bias) == content.model.bias.tobytes()
    assert bytes.fromhex(values) == registry.held_out("tiny-lbp/1").value_0.to_numpy().tobytes()
    assert metrics == content.metrics and rule == content.operating_point.rule.to_json()
    ((first,), (second,)) = ([*kept.glob("tiny-*.npy")] for kept in (trained / "cache", tmp_path))
    assert first.read_bytes() == second.read_bytes()


@pytest.fixture
def blocks(fabricate):
    """A dataset of 30 blocks of 10 frames of one patch each; labels change by block only."""
    rng = np.random.default_rng(11)
    sides = rng.permutation(np.arange(30) % 3 == 0)
    labels = ["reef" if sides[n // 10] else "ocean" for n in range(300)]
    return fabricate(labels, [f"dive#{n // 10:03d}" for n in range(300)])


def shuffled(seed):
    """16 blocks of 12 frames: 4 tracks, seen in 3 near copies each, 2 of them obstacles by lot.

    So labels are permuted inside blocks, near copies together, and every block has as many of
    each: nothing but having seen a track before can tell them apart.
    """
    rng = np.random.default_rng(seed)
    obstacle = np.array([rng.permutation([0, 0, 1, 1]) for _ in range(16)])
    looks = rng.normal(size=(16, 4, 40))
    number = np.arange(16 * 12)
    block, track = number // 12, number % 4
    features = looks[block, track] + rng.normal(0, 0.02, (len(number), 40))
    return features, obstacle[block, track]


def against_chance(made, seed, monkeypatch):
    """Average precision and balanced accuracy of the nested cross-validation; chance is 0.5."""
    features, truth = shuffled(seed)
    monkeypatch.setattr(made, "targets", lambda: truth)
    values = cross_validate(made, features, TWO, Split(4, 2), quiet).values[:, 0]
    said = (values > 0).astype(int)
    return average_precision_score(truth, values), balanced_accuracy_score(truth, said)


def test_labels_shuffled_inside_blocks_are_told_apart_no_better_than_by_chance(
    fabricate, monkeypatch
):
    made = fabricate(["ocean", "reef"] * 96, [f"dive#{n // 12:03d}" for n in range(192)])
    found = [against_chance(made, seed, monkeypatch) for seed in range(4)]
    assert np.abs(np.mean(found, axis=0) - 0.5).max() < 0.1

    def leaking(patches, targets, n_folds, embargo_frames, single_pictures):
        """A random split, which leaves near copies on both sides."""
        splitter = StratifiedKFold(n_folds, shuffle=True, random_state=0)
        return [Fold(*parts) for parts in splitter.split(patches, targets)]

    monkeypatch.setattr(split_module, "blocked_folds", leaking)
    # What the bound above would not let through.
    assert min(against_chance(made, 0, monkeypatch)) > 0.9


def test_choice_and_weights_of_a_fold_do_not_see_its_test_part(blocks, monkeypatch):
    """Turn around the labels of a fold's test rows and of the embargo: its choice stays."""
    rng = np.random.default_rng(5)
    truth = blocks.targets()
    features = np.column_stack([truth + rng.normal(0, 1.2, 300), rng.normal(size=(300, 30))])
    split = Split(3, 2)
    folds = blocked_folds(blocks.patches, truth, 3, 2)
    original = blocked_folds

    def same_outer_folds(patches, targets, *how):
        return folds if len(patches) == 300 else original(patches, targets, *how)

    monkeypatch.setattr(split_module, "blocked_folds", same_outer_folds)

    def run(targets):
        monkeypatch.setattr(type(blocks), "targets", lambda self: targets)
        return cross_validate(blocks, features, TWO, split, quiet)

    clean = run(truth)
    for number, fold in enumerate(folds[:2]):
        unseen = np.setdiff1d(np.arange(300), fold.train)
        assert len(unseen) > len(fold.test)
        poisoned = truth.copy()
        poisoned[unseen] = 1 - poisoned[unseen]
        found = run(poisoned)
        assert found.choices[number] == clean.choices[number]
        assert found.rules[number] == clean.rules[number]
        assert np.array_equal(found.values[fold.test], clean.values[fold.test])
        others = np.setdiff1d(np.arange(300), fold.test)
        assert not np.array_equal(found.values[others], clean.values[others])


@pytest.fixture
def dives(fabricate):
    """Four dives of 40, 60, 80 and 100 frames of one patch; every other block of 10 is reef."""
    made = {"a": 40, "b": 60, "c": 80, "d": 100}
    missions = [name for name, frames in made.items() for _ in range(frames)]
    numbers = [n for frames in made.values() for n in range(frames)]
    groups = [f"{name}#{n // 10:03d}" for name, n in zip(missions, numbers, strict=True)]
    labels = ["reef" if n // 10 % 2 else "ocean" for n in numbers]
    return fabricate(labels, groups, numbers, missions)


def test_several_dives_are_held_out_whole_unless_asked_otherwise(dives, blocks):
    split = Split.of(dives, 5, 5)
    assert (split.by, split.weight, split.sites) == ("dive", "dive", {})
    features = np.random.default_rng(0).normal(size=(280, 3))
    held_out = cross_validate(dives, features, PLAIN, split, quiet)
    assert (
        dives.patches.groupby("mission").apply(len).tolist() == np.bincount(held_out.fold).tolist()
    )
    split = Split.of(dives, 5, 5, "block", "patch")
    assert (split.by, split.weight) == ("block", "patch")
    assert Split.of(blocks, 5, 5) == Split(5, 5)
    refuses("cannot be split by dive", Split.of, blocks, 5, 5, "dive")
    refuses("--split is dive or block, not 'frame'", Split.of, dives, 5, 5, "frame")
    refuses("--weight is dive or patch, not 'x'", Split.of, dives, 5, 5, None, "x")
    refuses("no mission 'e'", Split.of, dives, 5, 5, None, None, ["basin=a,e"])


def test_what_is_only_true_of_one_dive_counts_for_nothing(dives):
    """Reef looks otherwise in each dive: blocks of a dive tell of each other, dives do not."""
    rng = np.random.default_rng(3)
    dive, truth = pd.factorize(dives.patches.mission)[0], dives.targets()
    asked, found = (Hyperparameters(0.1), PLAIN), {"dive": [], "block": []}
    for _ in range(6):
        features = rng.normal(size=(4, 2, 12))[dive, truth] + rng.normal(0, 0.3, (280, 12))
        for by, right in found.items():
            for fold in Split.of(dives, 5, 5, by).cut(dives.patches, truth):
                values = decision_values(fit_rows(features, truth, fold.train, *asked), features)
                right.extend((values[fold.test, 0] > 0) == truth[fold.test])
    assert np.mean(found["block"]) > 0.95 and abs(np.mean(found["dive"]) - 0.5) < 0.15


def test_nothing_of_a_dive_is_seen_by_what_it_is_tested_with(dives, monkeypatch):
    """Turn around the labels of a dive: its choices, rule, margins and decision values stay."""
    rng = np.random.default_rng(5)
    truth, mission = dives.targets(), dives.patches.mission.to_numpy()
    features = np.column_stack([truth + rng.normal(0, 1.2, 280), rng.normal(size=(280, 30))])

    def run(targets):
        monkeypatch.setattr(type(dives), "targets", lambda self: targets)
        return cross_validate(dives, features, TWO, Split.of(dives, 5, 5), quiet)

    clean = run(truth)
    for number, name in ((0, "a"), (3, "d")):
        found = run(np.where(mission == name, 1 - truth, truth))
        assert found.choices[number] == clean.choices[number]
        assert found.rules[number] == clean.rules[number]
        tested = mission == name
        assert np.array_equal(found.values[tested], clean.values[tested])
        assert not np.array_equal(found.values[~tested], clean.values[~tested])


def test_a_split_is_by_site_then_by_dive_and_inside_a_training_part_too(dives):
    def held_out(split, without=()):
        left = ~dives.patches.mission.isin([*without]).to_numpy()
        patches, targets = dives.patches[left].reset_index(drop=True), dives.targets()[left]
        folds = split.cut(patches, targets, to_choose=bool(without))
        return sorted("".join(sorted(set(patches.mission[fold.test]))) for fold in folds)

    plain = Split.of(dives, 5, 5)
    assert held_out(plain) == [*"abcd"] and held_out(plain, "b") == [*"acd"]
    site = Split(4, 5, "dive", sites={"a": "s", "b": "s"})
    assert held_out(site) == ["ab", "c", "d"] and held_out(site, "c") == ["ab", "d"]
    sites = replace(site, sites={**site.sites, "c": "t", "d": "t"})
    # Where one site is left, its dives one by one.
    assert held_out(sites) == ["ab", "cd"] and held_out(sites, "ab") == [*"cd"]


def test_where_one_dive_is_left_choices_are_made_by_its_blocks(fabricate):
    labels = ["reef" if n // 10 % 2 else "ocean" for n in range(120)]
    missions = ["a"] * 60 + ["b"] * 60
    groups = [f"{name}#{n // 10:03d}" for n, name in enumerate(missions)]
    made = fabricate(labels, groups, None, missions)
    features = made.targets()[:, None] + np.random.default_rng(0).normal(0, 0.1, (120, 2))
    held_out = cross_validate(made, features, PLAIN, Split.of(made, 4, 1), quiet)
    assert average_precision_score(made.targets(), held_out.values[:, 0]) > 0.99
    assert np.bincount(held_out.fold).tolist() == [60, 60]


def test_a_class_that_one_dive_alone_has_is_refused_and_said(fabricate):
    labels = [*["ocean", "reef"] * 10, *["ocean"] * 20]
    made = fabricate(labels, None, None, ["a"] * 20 + ["b"] * 20)
    features = np.random.default_rng(0).normal(size=(40, 2))
    words = "without a, which is held out as a whole, nothing labelled reef is left to learn from"
    refuses(words, cross_validate, made, features, PLAIN, Split.of(made, 2, 1), quiet)
    refuses("cannot be split by dive", Split.of, made, 2, 1, "dive")


def test_a_dive_that_alone_keeps_a_class_is_not_chosen_on(fabricate):
    labels = [*["ocean", "reef"] * 10, *["reef"] * 40]
    missions = [name for name in "abc" for _ in range(20)]
    made = fabricate(labels, None, None, missions)
    asked = made.patches, np.random.default_rng(0).normal(size=(60, 2)), made.targets()
    tested = np.isfinite(choose_hyperparameters(*asked, PLAIN, Split(2, 0, "dive")).values[:, 0])
    assert set(made.patches.mission[tested]) == {"b", "c"} and tested.sum() == 40
    # Of a and b it is b alone that could be held out: so by blocks.
    two = made.patches[:40], asked[1][:40], asked[2][:40]
    tested = np.isfinite(choose_hyperparameters(*two, PLAIN, Split(2, 0, "dive")).values)
    assert tested.all()


def test_a_dive_counts_by_the_root_of_its_patches_in_learning(dives):
    """Against a fit whose patches have weights by hand."""
    rng = np.random.default_rng(1)
    truth, mission = dives.targets(), dives.patches.mission.to_numpy()
    features = np.column_stack([truth + rng.normal(0, 0.7, 280), rng.normal(3, 2, (280, 2))])
    choice, rows = Hyperparameters(0.1), np.arange(280)
    each = pd.Series(mission).map({"a": 40, "b": 60, "c": 80, "d": 100}).to_numpy() ** -0.5
    each *= 280 / each.sum()
    scaler = StandardScaler().fit(features, sample_weight=each)
    svc = LinearSVC(C=0.1, random_state=42, dual=False, tol=1e-9)
    svc.fit(scaler.transform(features), truth, sample_weight=each)
    made = fit_rows(features, truth, rows, choice, PLAIN, (), Dives.of(mission))
    assert np.allclose(made["scaler"].mean_, scaler.mean_)
    assert np.allclose(made["svc"].coef_, svc.coef_, atol=1e-4)
    # One dive: nothing is other than without, to the last bit.
    one = np.flatnonzero(mission == "a")
    alike = (
        fit_rows(features, truth, one, choice, PLAIN, (), by) for by in (None, Dives.of(mission))
    )
    first, second = (model["svc"].coef_.tobytes() for model in alike)
    assert first == second


def test_a_long_dive_does_not_choose_alone():
    """Candidate one is right on the long dive, candidate two on the two short ones."""
    targets = np.array([0, 1] * 50 + [0, 1] * 5 + [0, 1] * 5)
    right, wrong = np.where(targets, 1.0, -1.0), np.where(targets, -1.0, 1.0)
    parts = [np.arange(100), np.arange(100, 110), np.arange(110, 120)]
    long = np.concatenate([right[:100], wrong[100:]])[:, None]
    assert cross_validation._mean_f1(targets, long, []) > 0.8
    assert cross_validation._mean_f1(targets, long, parts) == pytest.approx(1 / 3)
    assert cross_validation._mean_f1(targets, -long, parts) == pytest.approx(2 / 3)
    # A dive with one side only has no F1: it is left out.
    sided = np.where(np.arange(120) < 100, 1, targets)
    assert cross_validation._mean_f1(sided, right[:, None], parts) == 1


def test_figures_by_dive_and_site_stand_beside_the_mean(dives):
    truth, mission = dives.targets().copy(), dives.patches.mission.to_numpy()
    truth[mission == "d"] = 0
    score = np.where(truth == 1, 1.0, -1.0)
    score[mission == "b"] *= -1
    fold = pd.factorize(mission)[0]
    about = fold, (Hyperparameters(1.0),) * 4, (MofNRule(),) * 4
    held_out = HeldOutPredictions(score[:, None], *about)
    model = LinearModel(np.zeros((1, 1)), np.zeros(1), np.zeros(1), ("clear", "obstacle"), (0, 1))
    dives.targets = lambda: truth
    found = held_out_metrics(dives, held_out, model, {"a": "basin", "b": "basin"})
    assert {name: one["f1"] for name, one in found["dives"].items()} == {
        **{"a": 1, "b": 0, "c": 1, "d": None}
    }
    assert found["dives"]["d"]["n"] == 100 and found["dives"]["d"]["obstacles"] == 0
    mean = found["over_dives"]
    assert mean["f1"] == pytest.approx(2 / 3) and (mean["worst"], mean["worst_f1"]) == ("b", 0)
    assert (mean["n"], mean["without_f1"]) == (4, 1)
    assert list(found["sites"]) == ["basin", "c", "d"]
    rows = np.isin(mission, ["a", "b"])
    expected = obstacle_metrics(truth[rows] == 1, score[rows])
    assert expected.items() <= found["sites"]["basin"].items()
    one = HeldOutPredictions(score[:, None], np.where(mission == "a", 0, -1), *about[1:])
    assert not {"dives", "over_dives", "sites"} & set(held_out_metrics(dives, one, model))


def test_the_split_of_a_run_that_an_older_tokt_logged_is_by_block():
    old = {"split_folds": "5", "split_embargo_frames": "3"}
    assert Split.logged(old) == Split(5, 3)
    new = Split(5, 3, "dive", "dive", {"a": "basin"})
    logged = {f"split_{name}": str(value) for name, value in asdict(new).items()}
    assert Split.logged(logged) == new
    for name, value in (("by", "x"), ("weight", ""), ("sites", "5"), ("sites", "{")):
        with pytest.raises((ValueError, SyntaxError, AttributeError)):
            Split.logged({**logged, f"split_{name}": value})


def test_held_out_metrics_against_scikit_learn(trained):
    registry = Registry(trained)
    metrics, held_out = registry.bundle("tiny-lbp").metrics, registry.held_out("tiny-lbp")
    truth, score = held_out.target.to_numpy(), held_out.obstacle_score.to_numpy()
    precision, recall, f1, _ = precision_recall_fscore_support(truth, score > 0)
    expected = {"precision": precision[1], "recall": recall[1], "f1": f1[1], "macro_f1": f1.mean()}
    expected["average_precision"] = average_precision_score(truth, score)
    assert {name: metrics["patch"][name] for name in expected} == pytest.approx(expected)
    assert metrics["patches_tested"] == len(truth) == 3950
    for index, fold in enumerate(metrics["folds"]):
        mine = held_out.fold == index
        own = precision_recall_fscore_support(truth[mine], score[mine] > 0, average="binary")
        assert np.isclose(fold["f1"], own[2])
        assert fold["penalty"] in PLAIN.penalties
    assert 0.8 < metrics["patch"]["f1"] < 1


def test_figures_without_any_obstacle_or_any_alarm_are_none_not_zero():
    everything = obstacle_metrics(np.ones(5, bool), np.full(5, np.inf))  # F1 of 1 says nothing
    assert {everything[name] for name in ("f1", "precision", "recall")} == {None}
    none = obstacle_metrics(np.zeros(3, bool), np.array([-1.0, -1, -1]))
    assert (none["precision"], none["recall"], none["f1"]) == (None, None, None)
    assert none["average_precision"] is None
    missed = obstacle_metrics(np.ones(3, bool), np.array([-1.0, 0, -1]))
    assert (missed["precision"], missed["recall"], missed["f1"]) == (None, 0.0, 0.0)
    figures = class_metrics(np.array([0, 0]), np.array([0, 1]), ("a", "b", "c"))
    assert figures["per_class"]["b"] == {"precision": 0.0, "recall": None, "f1": 0.0, "n": 0}
    assert figures["per_class"]["c"]["precision"] is None
    assert np.isclose(figures["macro_f1"], 2 / 3)


def test_thesis_preset_is_the_thesiss(request_for, tmp_path, no_progress):
    request = request_for("thesis")
    trained = fit_and_measure(request, tmp_path, no_progress)
    svc = trained.pipeline.named_steps["svc"]
    assert list(trained.pipeline.named_steps) == ["svc"]  # unscaled
    assert (svc.C, svc.random_state) == (100.0, 42)
    assert trained.choice.penalty == 100.0
    # The first all-clear frame of the dataset is what it learnt from, so it is not a test.
    dataset = request.dataset
    learnt = dataset.patches.frame.to_numpy() == 1
    assert (trained.held_out.fold[learnt] == -1).all()
    assert np.isnan(trained.held_out.values[learnt]).all()
    assert (trained.held_out.fold[~learnt] >= 0).all()
    assert trained.metrics["patches_tested"] == 3950 - 100
    assert trained.metrics["frames"]["ocean_frames"] == 14
    assert "two images" in trained.metrics["split"]
    row = dataset.frames.index[dataset.frames.frame == 1][0]
    assert frame_id(dataset.frames.digest[row]) in trained.trained_on
    assert len(trained.trained_on) == 2


def test_thesis_images_of_the_dataset_give_linearsvcs_own_weights_and_are_left_out(
    request_for, tiny, tmp_path, no_progress
):
    """The same two images through scikit-learn by hand."""
    ocean, other = (tiny.path / "Left" / f"tiny_L_{number}.png" for number in (2, 5))
    request = request_for("thesis", ocean_image=ocean, other_image=other)
    trained = fit_and_measure(request, tmp_path, no_progress)
    left_out = request.dataset.patches.frame[trained.held_out.fold < 0]
    assert set(left_out) == {2, 5}
    assert "ocean = tiny_L_2.png and other = tiny_L_5.png" in trained.metrics["split"]
    pictures = (cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in (ocean, other))
    grid = request.dataset.grid
    rows = np.vstack([request.extractor.describe(picture, grid) for picture in pictures])
    svc = LinearSVC(C=100, random_state=42, dual=True, max_iter=5000)
    svc.fit(rows, [0] * 100 + [1] * 100)
    assert np.array_equal(svc.coef_, trained.model.weights)


def test_thesis_preset_needs_whole_frames_and_two_sides(fabricate, tmp_path, no_progress):
    made = fabricate(["ocean", "reef"] * 10)
    made.block_frames = None
    settings = settings_named("thesis")
    request = TrainRequest(made, "m", extractor_for("lbp", "thesis"), "lbp", settings, Split(2, 0))
    refuses("folder of patches", fit_and_measure, request, tmp_path, no_progress)


def test_best_widens_the_plain_names_and_plain_does_not():
    ready_cut = Grid(1, 1, None)
    for grid in (None, ready_cut):
        assert extractor_for("lbp", "plain", grid).dim == 12
    assert extractor_for("lbp", "best", Grid(10, 10)).dim > 30
    assert extractor_for("lbp_10_5_frame", "best").dim == 12
    assert settings_named("best", Grid(10, 10)).changes == ("gain_0.5", "jpeg_60")
    assert settings_named("best", ready_cut).changes == ()
    assert settings_named("plain", ready_cut) == PLAIN
    assert extractor_for("haralick", "thesis").spec["ignore_zeros"] is True


def test_of_several_dives_best_is_water_without_colours_where_there_are_none(begun, tmp_path):
    workspace, missions = begun(tmp_path / ".tokt"), []
    for name, blue in (("gray", None), ("yellow", 0.5), ("violet", 1.0)):
        folder = tmp_path / name
        (folder / "Left").mkdir(parents=True)
        for frame in range(1, 13):
            picture = draw_tiny_frame(frame)
            if blue is not None:
                shades = np.uint8(picture * blue), np.uint8(picture * (1.5 - blue)), picture
                picture = cv2.merge(shades)
            cv2.imwrite(str(folder / "Left" / f"{name}_L_{frame}.png"), picture)
        rows = (row for row in tiny_labels(name) if row[2] <= 12)
        missions.append(("--mission", folder, "--labels", write_labels(folder / "l.csv", rows)))
    gray, yellow, violet = missions
    for name, given in (("mixed", (*gray, *yellow)), ("coloured", (*yellow, *violet))):
        succeeds("dataset", "build", name, *given, *BUILD_TINY, "--workspace", workspace)
        assert open_dataset(name, workspace / "datasets").is_gray == (name == "mixed")
    less = ("--changes", "none", "--max-samples", 1000, *TRAIN_TINY, "--workspace", workspace)
    made = json.loads(succeeds("train", "mixed", "--json", *less).out)
    assert "A fit learns from 1,000 patches at most, drawn by lot." in made["cv"]["split"]
    assert (made["preset"], made["extractor"]) == ("water", extractor_named("water_gray").spec)
    assert made["cv"]["dives"].keys() == {"gray", "yellow"} and made["operating_point"]["water"]
    assert extractor_for("haralick", "water").spec == extractor_named("water").spec
    ready_cut = Mock(grid=Grid(1, 1, None), patches=pd.DataFrame({"mission": ["a", "b"]}))
    assert (preset_for("best", ready_cut), preset_for("lite", ready_cut)) == ("best", "lite")
    refuses("ready-cut", extractor_for, "haralick", "lite", ready_cut.grid)
    assert preset_for("best", open_dataset("mixed", workspace / "datasets")) == "water"
    assert preset_for("plain", open_dataset("mixed", workspace / "datasets")) == "plain"
    half = json.loads(succeeds("train", "mixed", "--preset", "lite", "--json", *less).out)
    spec = extractor_named("lite_water_gray").spec
    assert (half["preset"], half["extractor"]) == ("lite_water", spec)
    assert half["operating_point"]["water"]


def test_a_lite_model_is_trained_and_judges_a_run(tiny, workspace, tmp_path):
    model, log, where = tmp_path / "m.tokt", tmp_path / "l.jsonl", ("--workspace", workspace)
    asked = ("train", "tiny", "--preset", "lite", "--name", "small", *TRAIN_TINY, *where)
    made = json.loads(succeeds(*asked, "--json").out)
    assert made["preset"] == "lite" and made["cv"]["patch"]["f1"] > 0.9
    assert "one of twelve" in made["cv"]["split"]
    succeeds("export", "small", "-o", model, *where)
    assert read_bundle(model).extractor.spec == extractor_named("lite").spec
    succeeds("run", "--source", tiny.path, "--bundle", model, "--udp", "127.0.0.1:9", "--log", log)
    lines = map(json.loads, log.read_text("utf-8").splitlines())
    said = {line["frame"]: line["status"] for line in lines if "status" in line}
    truth = {frame: int(bool(tower_cells(frame))) for frame in said}
    assert said == truth


def test_best_trains_better_than_plain_on_its_own_ground(request_for, tmp_path, no_progress):
    best = fit_and_measure(request_for("best"), tmp_path, no_progress)
    assert best.metrics["converged"]
    assert best.metrics["patch"]["f1"] > 0.9
    assert best.choice.penalty in PRESETS["best"].penalties
    assert len(best.trained_on) == 40
    # The folded model and the pipeline are one and the same.
    features = cached_features(best.request.dataset, best.request.extractor.spec, tmp_path, None)
    theirs = best.pipeline.decision_function(np.asarray(features))
    assert np.abs(theirs - best.model.decision_values(features)[:, 0]).max() <= 1e-9


def test_three_classes_are_scored_by_class(fabricate):
    """held_out_metrics of a model of three classes, two of them obstacles."""
    made = fabricate(["ocean", "reef", "subsea_installation"] * 10)
    made.task = "classes"
    targets = made.targets()
    values = np.eye(3)[targets]
    values[1] = [0, 0, 2]  # a reef taken for an installation: the right side, the wrong class
    values[0] = [0, 2, 0]  # water taken for a reef: a false alarm
    trained = fit_classifier(values, targets, Hyperparameters(1.0), PLAIN)
    model = linear_model(trained, made.classes(), made.obstacle_flags())
    folds = ((Hyperparameters(1.0),) * 2, (MofNRule(),) * 2)
    held_out = HeldOutPredictions(values, np.arange(30) % 2, *folds)
    figures = held_out_metrics(made, held_out, model)["patch"]
    assert figures["recall"] == 1.0
    assert figures["precision"] == 20 / 21
    assert figures["confusion"]["counts"][1] == [0, 9, 1]
    assert figures["per_class"]["reef"]["recall"] == 0.9


@pytest.mark.parametrize("most", [300, 4_000])
@pytest.mark.parametrize("logistic", [False, True])
def test_an_added_dive_keeps_scaler_map_and_what_is_drawn_of_the_others(most, logistic):
    """So that the less it counts, the nearer the model is to the one without it."""
    rng = np.random.default_rng(2)
    mission = np.repeat(["a", "new", "b"], [700, 100, 1_200])
    targets = (rng.random(2_000) < 0.3).astype(np.int64)
    features = np.column_stack([targets + rng.normal(0, 0.6, 2_000), rng.normal(size=2_000)])
    features[mission == "new"] = features[mission == "new"] * 3 + 5
    settings = replace(PLAIN, landmarks=30, max_samples=most, logistic=logistic)
    old, every = np.flatnonzero(mission != "new"), np.arange(2_000)

    def fit(rows, added):
        dives = Dives.of(mission, added)
        return fit_rows(features, targets, rows, Hyperparameters(1.0), settings, (), dives)

    without, little, usual = fit(old, {}), fit(every, {"new": 1e-9}), fit(every, {"new": 1.0})
    for made in (little, usual):
        assert np.allclose(made["map"].components_, without["map"].components_, rtol=1e-9)
        assert np.allclose(made["scaler"].data_min_, without["scaler"].data_min_, rtol=1e-9)
    assert np.allclose(little["svc"].coef_, without["svc"].coef_, rtol=1e-3, atol=1e-3)
    assert np.abs(usual["svc"].coef_ - without["svc"].coef_).max() > 0.01
    # Among the others again, it changes the map as well.
    again = fit(every, {})
    assert not np.allclose(again["map"].components_, without["map"].components_)


def test_of_many_patches_some_are_learnt_from_and_count_for_all(monkeypatch):
    """Three dives, one of them short, and 12 patches of a rare class among 30,000."""
    rng = np.random.default_rng(5)
    dives = np.repeat([0, 1, 2], [24_000, 5_700, 300])
    targets = (rng.random(30_000) < 0.1).astype(np.int64)
    targets[rng.choice(30_000, 12, replace=False)] = 2
    features = np.column_stack([targets + rng.normal(0, 0.4, 30_000), rng.normal(size=30_000)])
    settings = replace(PLAIN, landmarks=40, max_samples=2_000)
    seen = []

    def spy(*args):
        seen.append(args)
        return fit_classifier(*args)

    monkeypatch.setattr(classifier, "fit_classifier", spy)
    asked = targets, np.arange(30_000), Hyperparameters(1.0)
    fits = [
        fit_rows(features, *asked, replace(settings, max_samples=most), (), Dives.of(dives))
        for most in (2_000, 2_000, 30_000)
    ]
    (learnt, known, _, _, weights, *_), _, (*_, every, _, _) = seen
    assert len(learnt) == len(known) == len(weights) == 2_000 and (known == 2).sum() > 5
    at = {row: n for n, row in enumerate(features[:, 1].tolist())}
    rows = [at[row] for row in learnt[:, 1].tolist()]
    assert len(set(rows)) == 2_000 and (features[rows] == learnt).all()
    assert (targets[rows] == known).all()
    share = pd.Series(weights).groupby([dives[rows], known]).sum() / weights.sum()
    expected = pd.Series(every).groupby([dives, targets]).sum() / every.sum()
    expected = expected[share.index] / expected[share.index].sum()
    np.testing.assert_allclose(share, expected, rtol=1e-9)
    roots = np.sqrt(np.minimum([24_000, 5_700, 300], FULL_DIVE))
    assert np.allclose(share.groupby(level=0).sum(), roots / roots.sum(), atol=0.01)
    # Short of patches of a class in most dives, the class counts as much as before.
    many = np.repeat(np.arange(3_000), 10)
    fit_rows(features, *asked, replace(settings, max_samples=1_000), (), Dives.of(many))
    _, known, _, _, weights, *_ = seen[-1]
    few = pd.Series(weights).groupby(known).sum() / weights.sum()
    even = pd.Series(np.ones(30_000)).groupby(targets).sum() / 30_000
    np.testing.assert_allclose(few, even, rtol=1e-9)
    # The same landmarks as of all patches, and so nearly the same model; each time the same.
    first, again, whole = fits
    np.testing.assert_array_equal(first["map"].component_indices_, whole["map"].component_indices_)
    assert np.abs(first["map"].components_ - whole["map"].components_).max() < 0.1
    np.testing.assert_array_equal(first["svc"].coef_, again["svc"].coef_)
    agree = [first, whole] = [one.predict(features) for one in (first, whole)]
    assert (agree[0] == agree[1]).mean() > 0.98


@pytest.mark.parametrize("what", ["mission", "group"])
def test_of_very_many_patches_some_blocks_are_judged(what, fabricate, monkeypatch):
    monkeypatch.setattr(split_module, "MAX_JUDGED", 200)
    numbers = [n % 40 if what == "mission" else n for n in range(480)]
    missions = [f"dive_{n // 40:02d}" if what == "mission" else "dive" for n in range(480)]
    groups = [f"{name}#{n // 10:03d}" for name, n in zip(missions, numbers, strict=True)]
    labels = ["reef" if n // 10 % 2 else "ocean" for n in numbers]
    dataset = fabricate(labels, groups, numbers, missions)
    table = np.random.default_rng(0).normal(size=(480, 3))
    sites = ["small=dive_03", "pair=dive_00,dive_01"] if what == "mission" else []
    split = Split.of(dataset, 2, 2, None, None, sites)
    settings = replace(PLAIN, penalties=(1.0,))
    held_out = cross_validate(dataset, table, settings, split, quiet)
    judged = held_out.fold >= 0
    assert 160 <= judged.sum() <= 200 and np.isfinite(held_out.values[judged]).all()
    assert np.isnan(held_out.values[~judged]).all()
    units = dataset.patches.group
    assert set(units[judged]).isdisjoint(units[~judged])
    if sites:  # every site is there, held out as a whole
        site = dataset.patches.mission.map(split.sites)[judged]
        assert set(site.dropna()) == {"small", "pair"}
        assert (pd.Series(held_out.fold[judged]).groupby(site.to_numpy()).nunique() == 1).all()
    said = f"Judged are {judged.sum()} of {len(table)} patches"
    assert said in split.judged_words(dataset)
    chosen = choose_hyperparameters(dataset.patches, table, dataset.targets(), settings, split)
    assert (np.isfinite(chosen.values[:, 0]) == judged).all()


def test_class_weights_are_linearsvcs_and_the_simpler_choice_comes_first():
    rng = np.random.default_rng(3)
    targets = (np.arange(200) % 10 == 0).astype(np.int64)
    values = rng.normal(size=(200, 3)) + targets[:, None]
    svc = fit_classifier(values, targets, Hyperparameters(0.1, "balanced"), PLAIN)["svc"]
    scaled = StandardScaler().fit_transform(values)
    own = LinearSVC(C=0.1, class_weight="balanced", dual=False).fit(scaled, targets)
    assert np.array_equal(svc.coef_, own.coef_)
    both = weighted(replace(PLAIN, penalties=(1.0, 0.1)), "auto")
    order = [(0.1, None), (0.1, "balanced"), (1.0, None), (1.0, "balanced")]
    assert both.choices == tuple(Hyperparameters(*one) for one in order)
    refuses("none, balanced, auto, not 'heavy'", weighted, PLAIN, "heavy")


def test_balanced_weights_are_chosen_where_they_score_better(blocks):
    """Ten clear patches to one obstacle, and much overlap: unweighted, nothing is called one."""
    rng = np.random.default_rng(8)
    features = (blocks.targets() + rng.normal(0, 1.4, 300))[:, None]
    settings = replace(PLAIN, penalties=(1e-4,), class_weights=(None, "balanced"))
    asked = (blocks.patches, features, blocks.targets(), settings, Split(3, 2))
    chosen = choose_hyperparameters(*asked)
    assert chosen.choice == Hyperparameters(1e-4, "balanced")
    assert chosen.values.shape == (300, 1) and np.isfinite(chosen.values).all()


def test_features_that_nothing_can_be_learnt_from_are_refused(blocks):
    features = np.random.default_rng(0).normal(size=(300, 4))
    features[:, 2] = 7.0  # one that is the same everywhere does no harm
    assert np.isfinite(cross_validate(blocks, features, PLAIN, Split(3, 2), quiet).values).all()
    for bad in (np.nan, np.inf):
        features[[41, 50], 1] = bad
        words = "2 patches.*not a finite.*left frame 41, row 0, col 0"
        refuses(words, cross_validate, blocks, features, PLAIN, Split(3, 2), quiet)
    same = (blocks, np.full((300, 4), 3.0), PLAIN, Split(3, 2), quiet)
    refuses("same features.*blank", cross_validate, *same)


def test_too_few_blocks_or_folds_are_named_before_the_features(fabricate, request_for, tmp_path):
    """Two blocks of reef: one to test on, and one to learn from leaves none to choose on."""
    labels = ["reef" if n // 10 in (2, 7) else "ocean" for n in range(100)]
    made = fabricate(labels, [f"dive#{n // 10:03d}" for n in range(100)])
    few = TrainRequest(made, "m", extractor_named("lbp"), "lbp", PLAIN, Split(4, 1))
    folds = replace(request_for("plain"), split=Split(30, 1))
    for request, words in ((few, "reef is in a single block"), (folds, "too few for 30 folds")):
        refuses(words, fit_and_measure, request, tmp_path / "cache", quiet)
    assert not (tmp_path / "cache").exists()


def test_a_damaged_feature_cache_is_computed_anew(trained, tmp_path, no_progress):
    dataset = open_dataset("tiny", trained / "datasets")
    spec = extractor_named("lbp").spec
    first = np.array(cached_features(dataset, spec, tmp_path, no_progress, jobs=1))
    (file,) = tmp_path.glob("*.npy")
    whole = file.read_bytes()
    flipped = whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:]
    for damaged in (whole[: len(whole) // 2], flipped, b""):
        file.write_bytes(damaged)
        assert (cached_features(dataset, spec, tmp_path, no_progress, jobs=1) == first).all()
        assert file.read_bytes() == whole


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("--preset", "plain", "--least-patches", 101), "frames of 100 patches never show 101"),
        (("--preset", "plain", "--least-patches", "9" * 5000), "--least-patches is auto or"),
        (("--preset", "thesis", "--frame-rule", "2/3"), "preset thesis has the thesis's rule"),
        (("--preset", "plain", "--changes", "gain_0_5"), "no picture change 'gain_0_5'"),
        (("--preset", "best", "--fixed-boundary"), "with preset best it is fixed anyway"),
    ],
)
def test_what_cannot_be_asked_for_is_said_before_the_work(trained, tmp_path, refused, asked, said):
    (tmp_path / "datasets").symlink_to(trained / "datasets")
    (tmp_path / "mlflow.db").symlink_to(trained / "mlflow.db")
    where = ("--folds", 3, "--embargo", 1, "--workspace", tmp_path)
    assert refused(said, "train", "tiny", *asked, *where).count("\n") == 1
    assert not (tmp_path / "cache").exists()
