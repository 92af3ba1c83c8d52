from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.models.linear import LinearModel

CLASSES = ("ocean", "sand", "reef", "wreck", "tower")


def _model(obstacle: tuple[bool, ...], thresholds: Any, dim: int = 4) -> LinearModel:
    outputs = len(thresholds)
    weights, limits = np.ones((outputs, dim)), np.asarray(thresholds, np.float64)
    return LinearModel(weights, np.zeros(outputs), limits, CLASSES[: len(obstacle)], obstacle)


@settings(max_examples=scaled(100))
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 60), st.floats(-8, 8))
def test_folding_changes_nothing(seed, outputs, dim, size):
    rng = np.random.default_rng(seed)
    mean, scale = rng.normal(0, 10**size, dim), 10 ** rng.uniform(-3, 3, dim)
    coef, intercept = rng.normal(size=(outputs, dim)), rng.normal(size=outputs)
    features = mean + scale * rng.normal(size=(30, dim))
    classes = CLASSES[: 2 if outputs == 1 else outputs]
    obstacle = (False, *[True] * (len(classes) - 1))
    model = LinearModel.fold(coef, intercept, mean, scale, np.zeros(outputs), classes, obstacle)
    assert model.dim == dim
    values = model.decision_values(features)
    # Relative to the largest term of a sum: what cancels is the data's, not the folding's.
    terms = coef[None] * ((features - mean) / scale)[:, None]
    sizes = np.abs(coef / scale)[None] * np.maximum(np.abs(features), np.abs(mean))[:, None]
    largest = np.maximum(sizes.max(axis=2), np.abs(intercept))
    assert (np.abs(values - (terms.sum(axis=2) + intercept)) <= 1e-12 * largest * dim).all()


def test_the_bias_is_the_exact_sum_rounded_once():
    """No processor's way of adding up has a part in it: one model is one bundle anywhere."""
    mean, scale = np.array([1e16, 3.0, 1e16, 0.1]), np.ones(4)
    coef = np.array([[1.0, 1.0, -1.0, 1.0]])
    model = LinearModel.fold(coef, np.zeros(1), mean, scale, np.zeros(1), ("a", "b"), (False, True))
    assert model.bias.tolist() == [-3.1]


excesses = st.floats(-100, 100, allow_nan=False)


@settings(max_examples=scaled(200))
@given(
    st.sampled_from([(False, True), (False, False), (True, True)]),
    st.floats(-5, 5),
    st.lists(excesses, min_size=1, max_size=8),
)
def test_two_classes(obstacle, threshold, column):
    model = _model(obstacle, [threshold])
    values = np.array(column)[:, None]
    predicted = model.predicted(values)
    assert predicted.tolist() == [int(value > threshold) for value in column]
    found = model.obstacle_patches(values)
    assert found.tolist() == [obstacle[index] for index in predicted]
    assert ((model.obstacle_score(values) > 0) == found).all()


@settings(max_examples=scaled(300))
@given(st.data(), st.integers(2, 5))
def test_several_classes(data, n):
    obstacle = tuple(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    thresholds = data.draw(st.lists(st.floats(-5, 5), min_size=n, max_size=n))
    rows = data.draw(st.lists(st.lists(excesses, min_size=n, max_size=n), min_size=1, max_size=6))
    model = _model(obstacle, thresholds)
    values = np.array(rows)
    predicted = model.predicted(values)
    found = model.obstacle_patches(values)
    score = model.obstacle_score(values)
    assert predicted.dtype == np.int64 and found.dtype == bool and score.shape == (len(rows),)
    for row, index, flag, mark in zip(rows, predicted, found, score, strict=True):
        excess = [value - threshold for value, threshold in zip(row, thresholds, strict=True)]
        assert index == excess.index(max(excess))
        assert flag == obstacle[index]
        if mark != 0:
            assert (mark > 0) == flag
        else:
            assert excess.count(max(excess)) > 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_features_that_are_not_finite(bad):
    model = _model((False, True), [0.0])
    features = np.ones((5, 4))
    model.decision_values(features)
    features[3, 2] = bad
    with pytest.raises(ValueError, match="not finite"):
        model.decision_values(features)
    zero = LinearModel(np.zeros((1, 4)), np.zeros(1), np.zeros(1), ("a", "b"), (False, True))
    with pytest.raises(ValueError, match="not finite"), np.errstate(invalid="ignore"):
        zero.decision_values(features)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("sigma", [0.0, np.nan])
def test_a_scale_of_zero_is_refused(sigma):
    with pytest.raises(ValueError, match="finite"):
        LinearModel.fold(
            *(np.ones((1, 2)), np.zeros(1), np.zeros(2), np.array([1.0, sigma]), np.zeros(1)),
            *(("ocean", "other"), (False, True)),
        )


def test_an_overflow_is_an_error_and_no_warning_beside(recwarn):
    weights = np.full((1, 2), 1e308)
    model = LinearModel(weights, np.zeros(1), np.zeros(1), ("ocean", "other"), (False, True))
    with pytest.raises(ValueError, match="not finite"):
        model.decision_values(np.full((3, 2), 1e9))
    assert not recwarn.list


def test_classes_are_named_but_water_obstacles_first():
    names, obstacle = ("ocean", "fish", "pipe", "net"), (False, False, True, True)
    model = LinearModel(np.eye(4), np.zeros(4), np.zeros(4), names, obstacle)
    assert model.named_classes == ("pipe", "net", "fish")
    values = np.eye(4)[[0, 1, 1, 3, 1, 2, 2]]
    assert model.class_patches(values) == {"pipe": (5, 6), "net": (3,), "fish": (1, 2, 4)}
    two = LinearModel(np.eye(1), np.zeros(1), np.zeros(1), ("ocean", "other"), (False, True))
    assert two.named_classes == ()
