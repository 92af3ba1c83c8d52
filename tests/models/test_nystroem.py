"""The map before the weights: scikit-learn's, limited, in numpy alone, and in a bundle."""

import dataclasses
import json

import numpy as np
import pytest

from tests.calls import refuses
from tests.models.conftest import small_content
from tests.models.parts import golden_of, rehash, unpack
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, weights_bytes
from tokt.models.linear import LinearModel
from tokt.models.nystroem import NystroemMap
from tokt.training.fitting.classifier import decision_values, fit_classifier, linear_model
from tokt.training.fitting.presets import Hyperparameters, TrainingSettings

SIDES = ("clear", "obstacle"), (False, True)
SETTINGS = TrainingSettings("drawn", True, (1.0,), False, landmarks=30)


def rings(seed=0, n=400):
    """Patches of which those near the middle are obstacles: no plane tells them apart."""
    features = np.random.default_rng(seed).normal(0, [1, 1, 50], (n, 3)) + np.array([0, 3, 1000])
    return features, (np.hypot(features[:, 0], features[:, 1] - 3) < 1).astype(int)


@pytest.fixture(scope="module")
def fitted():
    features, targets = rings()
    return fit_classifier(features, targets, Hyperparameters(10.0), SETTINGS, np.ones(400))


def test_the_folded_model_is_scikit_learns(fitted):
    model = linear_model(fitted, *SIDES)
    assert model.dim == 3 and model.weights.shape == (1, 30)
    features, targets = rings(1)
    np.testing.assert_allclose(
        model.decision_values(features), decision_values(fitted, features), atol=1e-9
    )
    assert (model.predicted(model.decision_values(features)) == targets).mean() > 0.9


def test_what_lies_far_out_is_as_good_as_the_limit(fitted):
    model = linear_model(fitted, *SIDES)
    far = model.decision_values(np.array([[1e3, 3, 1000], [1e300, 3, 1000]]))
    assert far[0] == far[1]
    for wrong in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match="not finite"):
            model.decision_values(np.array([[0.0, wrong, 0]]))


def test_the_same_data_gives_the_same_map_and_landmarks_go_by_weight():
    features, targets = rings()
    features[200:] += 1e4
    weights = np.repeat([1.0, 0.0], 200)
    one, two = (
        linear_model(
            fit_classifier(features, targets, Hyperparameters(1.0), SETTINGS, weights), *SIDES
        )
        for _ in range(2)
    )
    assert np.array_equal(one.map.landmarks, two.map.landmarks)
    assert np.array_equal(one.weights, two.weights)
    alone = fit_classifier(features[:200], targets[:200], Hyperparameters(1.0), SETTINGS)
    np.testing.assert_allclose(one.map.scale, alone.named_steps["scaler"].scale_)
    assert np.abs(one.map.landmarks).max() <= 2.5


@pytest.fixture(scope="module")
def mapped_content():
    """A bundle's content whose model has a map, of random patches."""
    content = small_content(3)
    extractor = build_extractor(content.extractor_spec)
    frames = [decode_image(png, "golden") for png in content.golden.frames]
    features = [extractor.describe(frame, content.grid) for frame in frames]
    targets = content.golden.obstacle.ravel().astype(int)
    fitted = fit_classifier(np.vstack(features), targets, Hyperparameters(1.0), SETTINGS)
    model = linear_model(fitted, ("ocean", "other"), (False, True))
    values = [decision_values(fitted, each) for each in features]
    obstacle = [model.obstacle_patches(each) for each in values]
    golden = golden_of(frames, values, obstacle)
    return dataclasses.replace(content, model=model, golden=golden)


def test_a_bundle_with_a_map_is_the_same_model(mapped_content):
    data = bundle_bytes(mapped_content)
    read = bundle_from_bytes(data, "x.tokt")
    assert bundle_bytes(read.content) == data
    ours, theirs = mapped_content.model, read.model
    assert theirs.map.gamma == ours.map.gamma and theirs.map.limit == ours.map.limit
    assert np.array_equal(theirs.map.landmarks, ours.map.landmarks)
    frame = decode_image(read.golden.frames[0], "golden")
    features = read.extractor.describe(frame, read.grid)
    assert np.array_equal(ours.decision_values(features), theirs.decision_values(features))


def test_a_format_that_knew_no_map_has_none(mapped_content):
    members = unpack(bundle_bytes(mapped_content))
    manifest = json.loads(members["manifest.json"])
    assert manifest["format_version"] == 7
    older = rehash(members, {"format_version": 3, "sight": None, "frame_sizes": None})
    refuses("its format knows no map", bundle_from_bytes, older, "x.tokt")


@pytest.mark.parametrize(
    ("words", "edit"),
    [
        ("golden frame", {"gamma": lambda gamma: gamma * 1.01}),
        ("golden frame", {"landmarks": lambda landmarks: landmarks[::-1]}),
        ("does not fit together", {"limit": lambda limit: limit * 0}),
        ("does not fit together", {"gamma": lambda gamma: np.ones(2)}),
        ("does not fit together", {"scale": lambda scale: scale[1:]}),
        ("does not hold", {"scale": lambda scale: scale.astype(np.float32)}),
        ("features", {}),
    ],
)
def test_a_map_that_was_edited(mapped_content, words, edit):
    model = mapped_content.model
    arrays = {name: np.asarray(value) for name, value in vars(model.map).items()}
    for name, change in edit.items():
        arrays[name] = change(arrays[name])
    if not edit:  # one feature fewer than the extractor gives
        narrow = ("scale", "offset")
        arrays = {n: a[:-1] if n in narrow else a for n, a in arrays.items()}
        arrays["landmarks"] = arrays["landmarks"][:, :-1]
    forged = object.__new__(NystroemMap)
    for name, value in arrays.items():
        object.__setattr__(forged, name, value)
    broken = object.__new__(LinearModel)
    for name, value in {**vars(model), "map": forged}.items():
        object.__setattr__(broken, name, value)
    members = {**unpack(bundle_bytes(mapped_content)), "weights.npz": weights_bytes(broken)}
    refuses(words, bundle_from_bytes, rehash(members), "x.tokt")
