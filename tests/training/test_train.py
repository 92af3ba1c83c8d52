"""Training and its cross-validation: the same each time, and honest."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from sklearn.metrics import average_precision_score, precision_recall_fscore_support
from sklearn.model_selection import StratifiedKFold
from sklearn.svm import LinearSVC
from tokt.features.errors import ToktError
from tokt.features.extractor import extractor_named
from tokt.models.registry import Registry
from tokt.training import cross_validation
from tokt.training.classifier import fit_classifier, linear_model
from tokt.training.cross_validation import (
    HeldOut,
    Split,
    cross_validate,
    held_out_metrics,
    ocean_frame_statuses,
)
from tokt.training.dataset import open_dataset
from tokt.training.feature_table import feature_table
from tokt.training.metrics import class_metrics, first_of_three, obstacle_metrics
from tokt.training.presets import PRESETS, extractor_for, settings_named
from tokt.training.splits import blocked_folds
from tokt.training.train import TrainRequest, frame_id, train

PLAIN = settings_named("plain")


@pytest.fixture
def request_for(trained, tmp_path):
    """A request to train on the tiny dataset."""

    def make(preset: str, extractor: str = "lbp", **more) -> TrainRequest:
        dataset = open_dataset("tiny", trained / "datasets")
        settings = settings_named(preset)
        chosen = extractor_for(extractor, preset)
        return TrainRequest(dataset, "m", chosen, extractor, settings, Split(3, 1), **more)

    return make


# --- the same each time ------------------------------------------------------------------------


@pytest.mark.slow
def test_another_process_trains_bit_identical_weights(trained, workspace):
    command = [sys.executable, "-m", "tokt", "train", "tiny", "--extractor", "lbp"]
    command += ["--preset", "plain", "--folds", "3", "--embargo", "1"]
    subprocess.run([*command, "--workspace", str(workspace)], capture_output=True, check=True)
    one = Registry(trained).bundle("tiny-lbp/1").content
    two = Registry(workspace).bundle("tiny-lbp/2").content
    assert one.model.weights.tobytes() == two.model.weights.tobytes()
    assert one.model.bias.tobytes() == two.model.bias.tobytes()
    assert one.metrics == two.metrics
    assert one.golden.decision_values.tobytes() == two.golden.decision_values.tobytes()


def test_features_do_not_depend_on_the_number_of_processes(
    trained, tmp_path, no_progress, monkeypatch
):
    dataset = open_dataset("tiny", trained / "datasets")
    spec = extractor_for("lbp", "plain").spec
    monkeypatch.setenv("LOKY_MAX_CPU_COUNT", "2")
    many = feature_table(dataset, spec, tmp_path / "two", no_progress, jobs=2)
    one = feature_table(dataset, spec, tmp_path / "one", no_progress, jobs=1)
    assert np.array_equal(many, one)


def test_features_are_computed_once(trained, tmp_path, no_progress):
    dataset = open_dataset("tiny", trained / "datasets")
    spec = extractor_for("lbp", "plain").spec
    first = feature_table(dataset, spec, tmp_path, no_progress)

    def refuse(items, total, what):
        raise AssertionError("computed again")

    assert np.array_equal(feature_table(dataset, spec, tmp_path, refuse), first)
    with pytest.raises(AssertionError):
        feature_table(dataset, extractor_for("lbp_24_8", "plain").spec, tmp_path, refuse)


# --- honest ------------------------------------------------------------------------------------


@pytest.fixture
def blocks(fabricate):
    """A dataset of 30 blocks of 10 frames of one patch each; labels change by block only."""
    rng = np.random.default_rng(11)
    sides = rng.permutation(np.arange(30) % 3 == 0)
    labels = ["reef" if sides[n // 10] else "ocean" for n in range(300)]
    return fabricate(labels, [f"dive#{n // 10:03d}" for n in range(300)])


def pooled_ap(dataset, features, split=None):
    split = split or Split(5, 5)
    held_out = cross_validate(
        dataset, features, replace(PLAIN, penalties=(1.0,)), split, lambda items, *_: items
    )
    return average_precision_score(dataset.targets(), held_out.values[:, 0])


def test_what_only_tells_frames_apart_is_worth_nothing(blocks):
    """Random features of a block and the frame number: a random split calls them perfect."""
    prevalence, random_split, ours = blocks.targets().mean(), [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        number = np.arange(300)
        of_block = rng.normal(size=(30, 40))[number // 10]
        features = np.column_stack([of_block + rng.normal(0, 0.05, of_block.shape), number])
        ours.append(pooled_ap(blocks, features))
        values = np.empty(300)
        shuffled = StratifiedKFold(5, shuffle=True, random_state=seed)
        for learn, test in shuffled.split(features, blocks.targets()):
            model = LinearSVC(max_iter=5000).fit(features[learn], blocks.targets()[learn])
            values[test] = model.decision_function(features[test])
        random_split.append(average_precision_score(blocks.targets(), values))
    assert np.mean(random_split) > 0.95
    assert np.mean(ours) < prevalence + 0.15


def test_a_real_signal_is_found(blocks):
    rng = np.random.default_rng(0)
    features = np.column_stack([blocks.targets() + rng.normal(0, 0.2, 300), rng.normal(size=300)])
    assert pooled_ap(blocks, features) > 0.97


def test_choice_and_weights_of_a_fold_do_not_see_its_test_part(blocks, monkeypatch):
    """Turn around the labels of one fold's test rows: its C and its decision values stay."""
    rng = np.random.default_rng(5)
    truth = blocks.targets()
    features = np.column_stack([truth + rng.normal(0, 1.2, 300), rng.normal(size=(300, 30))])
    split = Split(3, 2)
    folds = blocked_folds(blocks.patches, truth, 3, 2)
    original = blocked_folds

    def same_outer_folds(patches, targets, n_folds, embargo):
        return folds if len(patches) == 300 else original(patches, targets, n_folds, embargo)

    monkeypatch.setattr(cross_validation, "blocked_folds", same_outer_folds)

    def run(targets):
        monkeypatch.setattr(type(blocks), "targets", lambda self: targets)
        return cross_validate(blocks, features, PLAIN, split, lambda items, *_: items)

    clean = run(truth)
    for number, fold in enumerate(folds):
        poisoned = truth.copy()
        poisoned[fold.test] = 1 - poisoned[fold.test]
        found = run(poisoned)
        assert found.penalties[number] == clean.penalties[number]
        assert np.array_equal(found.values[fold.test], clean.values[fold.test])
        others = np.setdiff1d(np.arange(300), fold.test)
        assert not np.array_equal(found.values[others], clean.values[others])


def test_rows_within_the_embargo_are_not_learnt_from(blocks, monkeypatch):
    seen = []

    def spy(features, targets, penalty, settings):
        seen.append(features[:, 0])
        return fit_classifier(features, targets, penalty, settings)

    monkeypatch.setattr(cross_validation, "fit_classifier", spy)
    number = np.arange(300, dtype=float)
    held_out = cross_validate(
        blocks,
        np.column_stack([number, number % 7]),
        replace(PLAIN, penalties=(1.0,)),
        Split(5, 5),
        lambda items, *_: items,
    )
    for index, learnt in enumerate(seen):
        tested = np.flatnonzero(held_out.fold == index)
        assert np.abs(learnt[:, None] - tested).min() > 5


# --- figures -----------------------------------------------------------------------------------


def test_held_out_metrics_against_scikit_learn(request_for, tmp_path, no_progress):
    trained = train(request_for("plain"), tmp_path, no_progress)
    dataset, held_out = trained.request.dataset, trained.held_out
    truth, score = dataset.targets(), held_out.values[:, 0]
    precision, recall, f1, _ = precision_recall_fscore_support(truth, score > 0)
    patch = trained.metrics["patch"]
    assert np.isclose(patch["precision"], precision[1])
    assert np.isclose(patch["recall"], recall[1])
    assert np.isclose(patch["f1"], f1[1])
    assert np.isclose(patch["average_precision"], average_precision_score(truth, score))
    assert np.isclose(patch["macro_f1"], f1.mean())
    assert trained.metrics["patches_tested"] == len(truth) == 3950
    for index, fold in enumerate(trained.metrics["folds"]):
        mine = held_out.fold == index
        own = precision_recall_fscore_support(truth[mine], score[mine] > 0, average="binary")
        assert np.isclose(fold["f1"], own[2])
        assert fold["penalty"] in PLAIN.penalties
    assert 0.8 < patch["f1"] < 1


def test_figures_without_any_obstacle_or_any_alarm_are_none_not_zero():
    none = obstacle_metrics(np.zeros(3, bool), np.array([-1.0, -1, -1]))
    assert (none["precision"], none["recall"], none["f1"]) == (None, None, None)
    assert none["average_precision"] is None
    missed = obstacle_metrics(np.ones(3, bool), np.array([-1.0, 0, -1]))
    assert (missed["precision"], missed["recall"], missed["f1"]) == (None, 0.0, 0.0)
    figures = class_metrics(np.array([0, 0]), np.array([0, 1]), ("a", "b", "c"))
    assert figures["per_class"]["b"] == {"precision": 0.0, "recall": None, "f1": 0.0, "n": 0}
    assert figures["per_class"]["c"]["precision"] is None
    assert np.isclose(figures["macro_f1"], 2 / 3)


@pytest.mark.parametrize(
    ("status", "first"),
    [([0, 1, 1, 0, 1, 1, 1], 14), ([1, 1], None), ([1, 1, -1, 1, 1], None), ([1, 1, 1], 10)],
)
def test_first_of_three(status, first):
    assert first_of_three(list(range(10, 10 + len(status))), status) == first


def test_ocean_frames_are_whole_clear_tested_frames(trained, tiny_truth):
    dataset = open_dataset("tiny", trained / "datasets")
    patches = dataset.patches
    said, tested = np.zeros(len(patches), bool), np.ones(len(patches), bool)
    said[(patches.frame == 2) & (patches.row == 0) & (patches.col == 0)] = True
    said[patches.frame == 5] = True
    tested[(patches.frame == 1) & (patches.row == 9)] = False
    clear = [n for n in range(1, 41) if not tiny_truth.cells(n)]
    found = ocean_frame_statuses(dataset, said, tested)
    assert found["ocean_frames"] == len(clear) - 1  # frame 1 was not tested whole
    # One patch of 100 is a mean of 2.55, over the threshold of 0.345.
    assert found["false_status_frames"] == ["tiny:2"]
    nobody = ocean_frame_statuses(dataset, said, np.zeros(len(patches), bool))
    assert nobody == {"ocean_frames": 0, "false_status": 0, "false_status_frames": []}


# --- presets -----------------------------------------------------------------------------------


def test_thesis_preset_is_the_thesiss(request_for, tmp_path, no_progress, tiny_truth):
    request = request_for("thesis")
    trained = train(request, tmp_path, no_progress)
    svc = trained.pipeline.named_steps["svc"]
    assert list(trained.pipeline.named_steps) == ["svc"]  # unscaled
    assert (svc.C, svc.random_state) == (100.0, 42)
    assert trained.penalty == 100.0
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


def test_thesis_images_of_the_dataset_are_both_left_out(request_for, tiny, tmp_path, no_progress):
    images = {
        "ocean_image": tiny.path / "Left" / "tiny_L_2.png",
        "other_image": tiny.path / "Left" / "tiny_L_5.png",
    }
    trained = train(request_for("thesis", **images), tmp_path, no_progress)
    left_out = trained.request.dataset.patches.frame[trained.held_out.fold < 0]
    assert set(left_out) == {2, 5}
    assert "ocean = tiny_L_2.png and other = tiny_L_5.png" in trained.metrics["split"]


def test_thesis_weights_are_linearsvcs_own(request_for, tiny, tmp_path, no_progress):
    """The same two images through scikit-learn by hand."""
    other = tmp_path / "other.png"
    noise = np.random.default_rng(2).integers(0, 255, (272, 360), np.uint8)
    cv2.imwrite(str(other), noise)
    ocean = tiny.path / "Left" / "tiny_L_2.png"
    request = request_for("thesis", ocean_image=ocean, other_image=other)
    trained = train(request, tmp_path / "cache", no_progress)
    grid = request.dataset.grid
    pictures = (cv2.imread(str(ocean), cv2.IMREAD_UNCHANGED), noise)
    rows = np.vstack([request.extractor.describe(picture, grid) for picture in pictures])
    svc = LinearSVC(C=100, random_state=42, dual=True, max_iter=5000)
    svc.fit(rows, [0] * 100 + [1] * 100)
    assert np.array_equal(svc.coef_, trained.model.weights)


def test_thesis_preset_needs_whole_frames_and_two_sides(fabricate, tmp_path, no_progress):
    made = fabricate(["ocean", "reef"] * 10)
    made.block_frames = None
    settings = settings_named("thesis")
    request = TrainRequest(made, "m", extractor_for("lbp", "thesis"), "lbp", settings, Split(2, 0))
    with pytest.raises(ToktError, match="folder of patches"):
        train(request, tmp_path, no_progress)


def test_best_widens_the_plain_names_and_plain_does_not():
    assert extractor_for("lbp", "plain").dim == 12
    assert extractor_for("haralick", "plain").dim == 13
    assert extractor_for("lbp", "best").dim == 52
    assert extractor_for("haralick", "best").dim == 13 + 12 + 26
    assert extractor_for("lbp_10_5_frame", "best").dim == 12
    assert extractor_for("haralick", "thesis").spec["ignore_zeros"] is True
    assert {name: preset.seed for name, preset in PRESETS.items()} == dict.fromkeys(PRESETS, 42)


def test_best_trains_better_than_plain_on_its_own_ground(request_for, tmp_path, no_progress):
    best = train(request_for("best"), tmp_path, no_progress)
    assert best.metrics["converged"]
    assert best.metrics["patch"]["f1"] > 0.9
    assert best.penalty in PRESETS["best"].penalties
    assert len(best.trained_on) == 40
    # The folded model and the pipeline are one and the same.
    features = feature_table(best.request.dataset, best.request.extractor.spec, tmp_path, None)
    theirs = best.pipeline.decision_function(np.asarray(features))
    assert np.abs(theirs - best.model.decision_values(features)[:, 0]).max() <= 1e-9


def test_three_classes_are_scored_by_class(fabricate):
    """held_out_metrics of a model of three classes, two of them obstacles."""
    labels = ["ocean", "reef", "subsea_installation"] * 10
    made = fabricate(labels)
    made.task = "classes"
    targets = made.targets()
    values = np.eye(3)[targets]
    values[1] = [0, 0, 2]  # a reef taken for an installation: the right side, the wrong class
    values[0] = [0, 2, 0]  # water taken for a reef: a false alarm
    trained = fit_classifier(values, targets, 1.0, PLAIN)
    model = linear_model(trained, made.classes(), made.obstacle_flags())
    held_out = HeldOut(values, np.arange(30) % 2, (1.0, 1.0))
    figures = held_out_metrics(made, held_out, model)["patch"]
    assert figures["recall"] == 1.0
    assert figures["precision"] == 20 / 21
    assert figures["confusion"]["counts"][1] == [0, 9, 1]
    assert figures["per_class"]["reef"]["recall"] == 0.9


def test_early_refusal_comes_before_the_features(request_for, tmp_path, no_progress):
    request = replace(request_for("plain"), split=Split(30, 1))
    with pytest.raises(ToktError, match="too few for 30 folds"):
        train(request, tmp_path / "cache", no_progress)
    assert not (tmp_path / "cache").exists()


def test_a_damaged_feature_cache_is_computed_anew(trained, tmp_path, no_progress):
    dataset = open_dataset("tiny", trained / "datasets")
    spec = extractor_named("lbp").spec
    first = np.array(feature_table(dataset, spec, tmp_path, no_progress, jobs=1))
    (file,) = tmp_path.glob("*.npy")
    whole = file.read_bytes()
    flipped = whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:]
    for damaged in (whole[: len(whole) // 2], flipped, b""):
        file.write_bytes(damaged)
        assert (feature_table(dataset, spec, tmp_path, no_progress, jobs=1) == first).all()
        assert file.read_bytes() == whole


def test_a_model_with_obstacles_only_has_no_obstacle_figures():
    """Everything is an obstacle and called one: an F1 of 1 would say nothing."""
    truth = np.ones(5, bool)
    figures = obstacle_metrics(truth, np.full(5, np.inf))
    assert {figures[name] for name in ("f1", "precision", "recall", "average_precision")} == {None}
    assert obstacle_metrics(truth, np.array([1.0, 1, 1, -1, 1]))["recall"] == 0.8
