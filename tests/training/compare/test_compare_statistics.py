"""Intervals, tests and words of a comparison, against known answers and simulated truth."""

import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import average_precision_score, f1_score

from tokt.training.compare.bootstrap import (
    MAX_BLOCKS,
    ComparisonMetric,
    average_precision,
    block_numbers,
    compare_f1,
    drawn_blocks,
    f1,
    interval,
    macro_f1,
    obstacle_counts,
    ranked_counts,
    spread_of_ap,
    summed,
)
from tokt.training.compare.learning import learning_words
from tokt.training.compare.pairs import holm, permutation_test


def _blocks(seed, n_blocks, each=60):
    """Patches whose scores share an offset within their block, as frames of a dive do."""
    rng = np.random.default_rng(seed)
    block = np.repeat(np.arange(n_blocks), each)
    truth = rng.random(block.size) < 0.4
    offset = rng.normal(0, 0.5, n_blocks)[block]
    score = np.where(truth, 0.6, -0.9) + offset + rng.normal(0, 0.8, block.size)
    return rng, block, truth, score


def test_figures_from_counts_are_scikit_learns():
    rng, block, truth, score = _blocks(1, 7)
    score = score.round(1)  # ties
    counts = obstacle_counts(truth, score > 0, block, 7)
    assert f1(counts.sum(axis=0)) == pytest.approx(f1_score(truth, score > 0))
    ranked = ranked_counts(truth, score, block, 7)
    expected = average_precision_score(truth, score)
    assert average_precision(ranked.sum(axis=0)) == pytest.approx(expected)
    weights = drawn_blocks(7, seed=3, resamples=4)
    for row, found in zip(weights, spread_of_ap(weights, ranked), strict=True):
        drawn = np.repeat(range(7), row.astype(int))
        again = np.concatenate([np.flatnonzero(block == b) for b in drawn])
        assert found == pytest.approx(average_precision_score(truth[again], score[again]))
    targets, predicted = rng.integers(0, 3, (2, block.size))
    several = ComparisonMetric(3)
    sums = several.counts(targets, predicted, truth, truth, block, 7).sum(axis=0)
    assert several.figure(sums) == pytest.approx(f1_score(targets, predicted, average="macro"))
    assert macro_f1(np.zeros((2, 3))) == 0 and np.isnan(f1(np.zeros(3)))


def test_many_thresholds_change_average_precision_by_next_to_nothing():
    rng = np.random.default_rng(5)
    truth = rng.random(30_000) < 0.4
    score = truth + rng.normal(0, 1, truth.size)
    counts = ranked_counts(truth, score, np.zeros(truth.size, int), 1)
    assert counts.shape[1] <= 4096
    expected = average_precision_score(truth, score)
    assert average_precision(counts.sum(axis=0)) == pytest.approx(expected, abs=1e-3)


def test_the_interval_holds_the_truth_about_as_often_as_it_says():
    """Blocks of a known population; few blocks, where plain percentiles hold it in 88 % only."""
    _, block, truth, score = _blocks(7, 20_000, each=20)
    whole = obstacle_counts(truth, score > 0, block, 20_000)
    true_f1 = float(f1(whole.sum(axis=0)))
    rng, held, repeats = np.random.default_rng(8), 0, 200
    for repeat in range(repeats):
        mine = whole[rng.integers(0, len(whole), 10)]
        bounds = interval(f1(summed(drawn_blocks(10, repeat, 500), mine)), 10)
        held += bounds["low"] <= true_f1 <= bounds["high"]
    assert 0.90 <= held / repeats <= 0.98


def test_one_block_or_no_obstacles_give_no_interval():
    assert interval(np.full(100, 0.5), 1) is None
    assert interval(np.full(100, np.nan), 5) is None


@pytest.mark.parametrize("n_blocks", [8, 30])
def test_a_model_against_itself_is_luck_and_a_planted_difference_is_not(n_blocks):
    _, block, truth, score = _blocks(11, n_blocks)
    same = obstacle_counts(truth, score > 0, block, n_blocks)
    nothing = permutation_test(same, same.copy(), f1)
    assert (nothing.p, nothing.differing) == (1, 0)
    better = obstacle_counts(truth, score + np.where(truth, 0.5, -0.5) > 0, block, n_blocks)
    found = permutation_test(better, same, f1)
    assert found.differing == n_blocks and found.exact == (n_blocks == 8)
    # Better in every block: no other swap of signs is as extreme but the opposite one.
    assert found.p == (2 / 2**8 if n_blocks == 8 else 1 / 10_000)
    assert found.least_p == found.p
    assert permutation_test(same, better, f1).p == found.p


def test_exact_p_values_are_scipys():
    for seed in range(5):
        rng, block, truth, score = _blocks(seed, 6)
        scores = score + rng.normal(0, 0.6, (2, score.size))
        first, second = (obstacle_counts(truth, one > 0, block, 6) for one in scores)
        both = np.concatenate([first, second])

        def difference(a, b, axis, both=both):
            return f1(both[a].sum(axis=a.ndim - 1)) - f1(both[b].sum(axis=b.ndim - 1))

        asked = (np.arange(6), np.arange(6, 12)), difference
        expected = stats.permutation_test(*asked, permutation_type="samples", vectorized=True)
        assert permutation_test(first, second, f1).p == expected.pvalue


def test_p_values_of_equal_models_are_uniform():
    p_values = []
    for seed in range(100):
        rng, block, truth, score = _blocks(seed, 9, each=30)
        noise = rng.normal(0, 0.6, (2, block.size)) + rng.normal(0, 0.5, (2, 9))[:, block]
        counts = [obstacle_counts(truth, score + part > 0, block, 9) for part in noise]
        p_values.append(permutation_test(*counts, f1).p)
    below = np.mean(np.array(p_values) <= 0.1)
    assert abs(below - 0.1) < 4 * np.sqrt(0.1 * 0.9 / 100)
    assert 0.4 < np.median(p_values) < 0.6


def test_holm_is_the_textbooks():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.6, 0.9]) == pytest.approx([1.0, 1.0]) and holm([0.02]) == [0.02]


def test_thousands_of_blocks_are_joined_with_their_neighbours():
    groups = np.array([f"m#{number:06d}" for number in np.repeat(range(2500), 2)], object)
    names, block = block_numbers(groups)
    assert len(names) == MAX_BLOCKS == len(np.unique(block))
    assert (np.diff(block) >= 0).all() and np.bincount(block).max() <= 6


def test_two_classes_of_one_side_are_compared_by_macro_f1():
    """Sand against reef: F1 of the obstacles would be none, or count every patch as right."""
    assert ComparisonMetric.of([False, True]).name == "f1"
    assert [ComparisonMetric.of(side * 2).name for side in ([True], [False])] == ["macro_f1"] * 2
    targets, predicted = np.array([0, 0, 1, 1]), np.array([0, 1, 1, 1])
    neither, measure = np.zeros(4, bool), ComparisonMetric.of([False, False])
    counts = measure.counts(targets, predicted, neither, neither, np.arange(4), 4)
    expected = f1_score(targets, predicted, average="macro")
    assert measure.figure(counts.sum(axis=0)) == pytest.approx(expected)


def _patches(seed, n_blocks=12, each=200):
    rng = np.random.default_rng(seed)
    truth = rng.random(n_blocks * each) < 0.3
    groups = np.repeat([f"m#{block:05d}" for block in range(n_blocks)], each)
    return rng, truth, groups


def test_the_figures_are_scikit_learns():
    rng, truth, groups = _patches(1)
    first, second = truth ^ (rng.random(truth.size) < 0.1), truth ^ (rng.random(truth.size) < 0.2)
    found = compare_f1(truth, first, second, groups)
    assert np.isclose(found.f1_first, f1_score(truth, first))
    assert np.isclose(found.f1_second, f1_score(truth, second))
    assert found.verdict == "better" and found.low > 0 and found.blocks == 12
    turned = compare_f1(truth, second, first, groups)
    assert turned.verdict == "worse"
    assert np.isclose(turned.low, -found.high) and np.isclose(turned.high, -found.low)


def test_one_lucky_block_of_many_is_no_difference():
    """Hundreds of patches differ, but all in one block: whole blocks are what is independent."""
    _, truth, groups = _patches(3)
    first = truth.copy()
    second = np.where(groups == groups[0], ~truth, truth)
    assert compare_f1(truth, first, second, groups).verdict == "cannot tell"


def _curve(low, high):
    half = {"difference": 0.05, "low": 0.01, "high": 0.09}
    last = {"difference": 0.02, "low": low, "high": high}
    stretch = {"mission": "m", "obstacle": 3, "low": -0.01, "high": 0.03, "help": 0.01}
    harm = {"frames": "20-29", "help": -0.1, "low": -0.2, "high": -0.02}
    ocean = {"label": "ocean", "n": 90, "wrong": [0.02, 0.01, 0.01, 0.01]}
    kelp = {"label": "kelp", "n": 10, "wrong": [0.5, 0.4, 0.3, 0.2]}
    points = [{"fraction": fraction} for fraction in (0.25, 0.5, 0.75, 1.0)]
    stretches = [stretch | {"frames": "1-9"}, stretch | harm]
    labels = {"by_label": [ocean, kelp], "stretches": stretches}
    return {"measure_title": "F1", "points": points, "gains": [half, last], **labels}


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (0.005, 0.04, "More labels of this kind would probably still help"),
        (-0.004, 0.004, "More labels of this kind would hardly help"),
        (-0.01, 0.05, "Cannot tell whether"),
        (None, None, "Too few blocks to say"),
    ],
)
def test_the_last_blocks_decide(low, high, said):
    assert learning_words(_curve(low, high))[0].startswith(said)
