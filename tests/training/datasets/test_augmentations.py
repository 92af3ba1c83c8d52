"""Changed pictures: what they are, that they are learnt from, and tested on beside."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from tests.calls import refuses
from tests.fixtures import quiet
from tokt.features.extractors.extractor import extractor_named
from tokt.training.datasets.augmentations import STRESS, augment
from tokt.training.datasets.changed_patches import ChangedPatches
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.split import Split
from tokt.training.fitting.cross_validation import cross_validate
from tokt.training.fitting.presets import settings_named, with_augmentations
from tokt.training.fitting.train import TrainRequest, fit_and_measure

PLAIN = replace(settings_named("plain"), penalties=(1.0,))


@pytest.mark.parametrize("shape", [(40, 60), (40, 60, 3)], ids=["gray", "colour"])
def test_changes_are_what_they_say(shape):
    frame = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    assert np.array_equal(augment(frame, "gain_0.5"), np.rint(frame / 2))
    doubled = augment(frame, "gain_2")
    assert np.array_equal(doubled, np.minimum(255, frame.astype(int) * 2))
    noisy = augment(frame, "noise_1")
    assert set(np.unique(noisy.astype(int) - frame)) == {-1, 0, 1}
    assert np.array_equal(noisy, augment(frame, "noise_1"))
    jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 60])[1]
    assert np.array_equal(augment(frame, "jpeg_60"), cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED))
    assert len(np.unique(augment(frame, "bits_3"))) == 8
    even = np.full_like(frame, 100)
    assert np.array_equal(augment(even, "motion_50"), even)
    assert (augment(even, "snow_60") >= 100).all() and augment(even, "snow_60").max() > 110
    assert (
        80 <= augment(even, "ripple_20").min() < 95 < 105 < augment(even, "ripple_20").max() <= 120
    )
    blue = np.zeros((2, 2, 3), np.uint8)
    blue[..., 0] = 200
    spreads = [np.ptp(augment(blue, name), axis=2).max() for name in ("gray_50", "gray_100")]
    assert spreads == [100, 0]
    assert np.array_equal(augment(blue[..., 0], "gray_100"), blue[..., 0])
    assert augment(blue, "hue_120")[0, 0].tolist() == [0, 0, 200]
    for name in STRESS:
        assert np.array_equal(augment(frame, name), augment(frame, name))
        assert augment(frame, name).shape == shape and augment(frame, name).dtype == np.uint8


@pytest.mark.parametrize(
    "name",
    [
        *("gain_0", "gain_nan", "gain_", "jpeg_60.5", "jpeg_101", "noise_0", "gain_1_0", "fog_1"),
        *("bits_8", "motion_0", "snow_1000", "hue_360", "gray_0", "gray_101"),
    ],
)
def test_unknown_changes_are_refused(name):
    refuses("no picture change", augment, np.zeros((4, 4), np.uint8), name)
    refuses("no picture change", with_augmentations, PLAIN, f"gain_0.5,{name}")


def test_changes_are_chosen_by_name():
    assert with_augmentations(PLAIN, "gain_0.5,jpeg_60,gain_0.5").changes == ("gain_0.5", "jpeg_60")
    with_some = replace(PLAIN, changes=("noise_1",))
    assert with_augmentations(with_some, None) == with_some
    assert with_augmentations(with_some, "none").changes == ()
    refuses("preset thesis", with_augmentations, settings_named("thesis"), "noise_1")


def test_training_parts_are_learnt_from_changed_too_and_tests_are_plain(fabricate):
    """Neither a tested frame nor its changed self is learnt from: against fits by hand."""
    made = fabricate(["ocean", "reef"] * 30, [f"dive#{n // 5:03d}" for n in range(60)])
    number, targets, split = np.arange(60.0), made.targets(), Split(3, 1)
    plain = np.column_stack([number, number % 2])
    other = plain + np.array([1000.0, 0])
    asked = (made, plain, replace(PLAIN, change_weight=0.25), split, quiet)
    augmented = [ChangedPatches(other, np.arange(60))]
    held_out = cross_validate(*asked, augmented=augmented, stress={"x": other})
    for index, fold in enumerate(split.cut(made.patches, targets)):
        assert np.flatnonzero(held_out.fold == index).tolist() == fold.test.tolist()
        both = np.vstack([plain[fold.train], other[fold.train]])
        weights = np.repeat([1.0, 0.25], len(fold.train))
        scaled = StandardScaler().fit(both)
        svc = LinearSVC(C=1.0, dual=False, random_state=42, max_iter=5000)
        svc.fit(scaled.transform(both), np.tile(targets[fold.train], 2), sample_weight=weights)
        model = make_pipeline(scaled, svc)
        for values, table in ((held_out.values, plain), (held_out.stressed["x"], other)):
            assert np.array_equal(values[fold.test, 0], model.decision_function(table[fold.test]))


def test_learning_from_darker_frames_helps_on_darker_frames(trained, tmp_path, no_progress):
    dataset = open_dataset("tiny", trained / "datasets")
    haralick = extractor_named("haralick")

    def run(settings):
        request = TrainRequest(dataset, "m", haralick, "haralick", settings, Split(3, 1))
        return fit_and_measure(request, tmp_path, no_progress, 1, stress=("gain_0.5",))

    plain, taught = run(PLAIN), run(replace(PLAIN, changes=("gain_0.5",)))
    before, after = (one.metrics["stress"]["gain_0.5"] for one in (plain, taught))
    assert after["f1"] > before["f1"] + 0.03 and after["f1"] > 0.8
    assert (before["learnt"], after["learnt"]) == (False, True)
    assert np.isclose(after["fall"], taught.metrics["patch"]["f1"] - after["f1"])
    assert after["ocean_frames"] == 15
    assert "counting 1 each, changed (gain_0.5)" in taught.metrics["split"]
    kept = (dataset, haralick.spec, tmp_path, None, 1)
    tables = [cached_features(*kept, augmentation=name) for name in ("", "gain_0.5")]
    assert len(list(tmp_path.glob("*.npy"))) == 2 and not np.array_equal(*tables)
