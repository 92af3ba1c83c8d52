"""Random changes of frames: the same each time, labels that move along, and never tested on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.extractors.extractor import extractor_named
from tokt.training.datasets import changed_patches as module
from tokt.training.datasets.augmentations import augment
from tokt.training.datasets.changed_patches import (
    FRAMES_A_DIVE,
    PATCHES_A_FRAME,
    ChangedPatches,
    changed_patches,
)
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.folds import Dives
from tokt.training.datasets.frame_changes import WIDTH, at_width, changed
from tokt.training.fitting.classifier import fit_rows
from tokt.training.fitting.presets import Hyperparameters, settings_named

SPEC = extractor_named("lbp").spec


def half_and_half(rows=10, cols=10):
    """A dark frame whose right half, and no other, is a bright obstacle."""
    frame = np.full((540, WIDTH, 3), 40, np.uint8)
    frame[:, WIDTH // 2 :] = 200
    obstacle = np.zeros((rows, cols), bool)
    obstacle[:, cols // 2 :] = True
    return frame, obstacle


@settings(max_examples=scaled(60), deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 12), st.integers(1, 12))
def test_a_change_is_the_same_each_time_and_says_where_its_patches_come_from(seed, rows, cols):
    frame, obstacle = half_and_half(rows, cols)
    known = np.random.default_rng(seed).random(obstacle.shape) < 0.9
    one, two = (changed(frame, obstacle, known, np.random.default_rng(seed)) for _ in range(2))
    assert np.array_equal(one.frame, two.frame) and np.array_equal(one.source, two.source)
    assert one.frame.dtype == np.uint8 and one.frame.shape[1:] == (WIDTH, 3)
    assert one.source.shape == (rows * cols,)
    assert (one.source >= -1).all() and (one.source < rows * cols).all()


def test_labels_follow_what_is_cut_out():
    """Whatever is done to it, the bright half stays the brighter one."""
    frame, obstacle = half_and_half()
    kinds = set()
    for seed in range(120):
        made = changed(frame, obstacle, np.ones_like(obstacle), np.random.default_rng(seed))
        height = made.frame.shape[0]
        told = made.source >= 0
        solid = obstacle.ravel()[made.source] & told
        water = ~obstacle.ravel()[made.source] & told
        middle = np.array(
            [
                made.frame[height * row // 10 : height * (row + 1) // 10, 72 * col : 72 * (col + 1)]
                .astype(float)
                .mean()
                for row in range(10)
                for col in range(10)
            ]
        )
        kinds.add((bool(solid.any()), bool(water.any())))
        if solid.any() and water.any():
            assert np.median(middle[solid]) > np.median(middle[water])
    assert kinds == {(True, True), (True, False), (False, True)}, "all obstacle, all water, both"


@pytest.mark.parametrize("size", [(480, 640), (1024, 576), (3, 7)])
def test_frames_of_any_size_are_brought_to_one_width(size):
    for shape in (size, (*size, 3)):
        frame = at_width(np.full(shape, 7, np.uint8))
        assert frame.shape[1:] == (WIDTH, 3) and (frame == 7).all()


@pytest.fixture
def tiny_dataset(trained):
    return open_dataset("tiny", trained / "datasets")


def test_a_dives_frames_are_changed_and_each_patch_has_its_source(
    tiny_dataset, tmp_path, no_progress
):
    table = changed_patches(tiny_dataset, SPEC, "random_2", tmp_path, no_progress, 1)
    frames = min(len(tiny_dataset.frames), FRAMES_A_DIVE)
    assert len(table.source) == len(table.features) == 2 * frames * PATCHES_A_FRAME
    assert table.features.shape[1] == extractor_named("lbp").dim
    assert table.source.min() >= -1 and table.source.max() < len(tiny_dataset.patches)
    again = changed_patches(tiny_dataset, SPEC, "random_2", tmp_path / "other", no_progress, 2)
    assert np.array_equal(table.features, again.features)
    assert np.array_equal(table.source, again.source)
    kept = table.source.reshape(-1, PATCHES_A_FRAME)
    groups = tiny_dataset.patches.frame.to_numpy()
    for row in kept:
        assert len(set(groups[row[row >= 0]])) <= 1, "of one frame"
    refuses("only learnt from", augment, np.zeros((4, 4), np.uint8), "random_2")


def test_an_augmentation_by_name_leaves_patches_where_they_are(tiny_dataset, tmp_path, no_progress):
    table = changed_patches(tiny_dataset, SPEC, "gain_0.5", tmp_path, no_progress, 1)
    assert table.source.tolist() == list(range(len(tiny_dataset.patches)))


def test_a_part_of_a_table_is_that_of_a_part_of_the_dataset():
    table = ChangedPatches(np.arange(12.0).reshape(6, 2), np.array([4, -1, 0, 2, 4, 3]))
    part = table.part(np.array([4, 0, 3]))
    assert part.source.tolist() == [0, 1, 0, 2]
    assert part.features[:, 0].tolist() == [0, 4, 8, 10]


def test_only_changes_of_training_patches_are_learnt_from_and_dives_keep_their_weight(monkeypatch):
    """The changed ones of a tested patch have features that would be seen in the fit."""
    seen = {}

    def fit(features, targets, choice, settings, weights, *rest):
        seen.update(features=features, targets=targets, weights=weights)

    monkeypatch.setattr("tokt.training.fitting.classifier.fit_classifier", fit)
    rng = np.random.default_rng(0)
    features, targets = rng.random((40, 3)), np.arange(40) % 2
    dives = np.repeat([0, 1], [30, 10])
    source = np.concatenate([rng.integers(0, 40, 100), [-1] * 5])
    table = ChangedPatches(100.0 + source[:, None] * np.ones(3), source)
    train = np.arange(0, 40, 2)
    preset = replace(settings_named("water"), landmarks=0, change_weight=0.5)
    fit_rows(features, targets, train, Hyperparameters(1.0), preset, [table], Dives.of(dives))
    changed = seen["features"][:, 0] >= 100
    learnt = seen["features"][changed, 0].astype(int) - 100
    assert set(learnt) <= set(train.tolist())
    assert len(learnt) == np.isin(source, train).sum()
    assert np.array_equal(seen["targets"][changed], targets[learnt])
    plain = np.bincount(dives[train], seen["weights"][~changed])
    assert np.bincount(dives[learnt], seen["weights"][changed]) == pytest.approx(plain / 2)


def test_long_dives_share_as_many_changes(tiny_dataset, monkeypatch):
    monkeypatch.setattr(module, "FRAMES_A_DIVE", 3)
    tasks = module._tasks(tiny_dataset, SPEC, "random_2")
    assert len(tasks) == 6 and len({task.digest for task in tasks}) == 6, "spread over the dive"
