"""Limits of drift: held-back windows, counted the plain way beside it."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tokt.models.bundle.bundle import distribution_bytes, distribution_from_bytes
from tokt.models.distribution import MIN_TYPICAL, bin_counts, ks_distances, quantile_edges
from tokt.models.registry.registry import Registry
from tokt.training.fitting.drift_limits import training_distribution

LENGTH, GAP = 6, 2
FRAMES = {
    ("a", "left"): [*range(1, 31), *range(50, 61)],
    ("a", "right"): [*range(3, 20)],
    ("b", "left"): [*range(0, 60, 3)],  # labelled now and then: 2 of 6 numbers
}


def table(seed=0):
    """A dataset of 3 to 9 patches a frame whose features wander from frame to frame."""
    rng = np.random.default_rng(seed)
    rows, features = [], []
    for (mission, camera), numbers in FRAMES.items():
        for number in numbers:
            for patch in range(int(rng.integers(3, 10))):
                rows.append((mission, camera, number, patch))
                level = np.sin(number / 7)
                features.append([level + rng.normal(), rng.integers(0, 3), 5.0])
    patches = pd.DataFrame(rows, columns=["mission", "camera", "frame", "row"])
    patches["position"] = patches.frame
    return SimpleNamespace(block_frames=LENGTH, patches=patches), np.array(features, float)


def plain(dataset, features):
    """Each window's distances, one window after the other."""
    patches = dataset.patches
    edges = np.array([quantile_edges(column) for column in features.T])
    found = []
    for (mission, camera), numbers in FRAMES.items():
        spans = [[n for n in numbers if first <= n < first + LENGTH] for first in numbers]
        fullest = max(map(len, spans))
        for span in spans:
            if len(span) < fullest / 2:
                continue
            in_mission = patches.mission == mission
            inside = in_mission & (patches.camera == camera) & patches.frame.isin(span)
            near = in_mission & patches.frame.between(span[0] - GAP, span[0] + LENGTH + GAP - 1)
            assert inside.sum() <= (~near).sum()
            counts = [bin_counts(features[rows.to_numpy()], edges) for rows in (inside, ~near)]
            found.append(ks_distances(*counts))
    return np.array(found)


def test_limits_are_those_of_plain_held_back_windows():
    dataset, features = table()
    found = training_distribution(dataset, features, GAP)
    distances = plain(dataset, features)
    typical = np.maximum(distances.mean(axis=0), MIN_TYPICAL)
    assert found.windows == len(distances) and found.window_frames == LENGTH
    np.testing.assert_allclose(found.typical, typical, rtol=1e-12)
    assert found.factor == pytest.approx((distances / typical).max(), rel=1e-12)
    # No held-back window is out of range, and the furthest lies on its limit.
    assert (distances / found.limits).max() == pytest.approx(1)
    # a: from 1, 9, 17, 25, 50 and 58 (half full) on; b: from 0, 9, ..., 54 on.
    assert found.stretches == 6 + 7
    # The feature that never varies: any other value is out of range.
    assert found.typical[2] == MIN_TYPICAL and found.limits[2] < 1
    assert found.counts.sum(axis=1).tolist() == [len(features)] * 3


@pytest.mark.parametrize("block_frames", [None, 60])
def test_too_little_to_measure_on_is_no_distribution(block_frames):
    """Single patches; and windows so long that less is left than they hold."""
    dataset, features = table()
    dataset.block_frames = block_frames
    assert training_distribution(dataset, features, GAP) is None


def test_its_summary_stands_in_the_recipe_and_it_goes_into_the_bundle(trained):
    registry = Registry(trained)
    version = registry.find("tiny-lbp/1")
    bundle, recipe = registry.bundle("tiny-lbp"), registry.recipe(version)
    assert bundle.distribution is not None
    assert recipe["distribution"] == bundle.distribution.summary()
    kept = distribution_from_bytes(distribution_bytes(bundle.distribution), "bundle")
    assert kept.summary() == bundle.distribution.summary()
    assert "Input drift" in bundle.content.card and "8 of these windows" in bundle.content.card
    assert registry.bundle("tiny-lbp").sha256 == bundle.sha256
