"""The operating point: what it promises of open ocean, and that the figures for it are honest."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tests.calls import refuses
from tests.tiers import scaled
from tokt.models.operating_point import OBSTACLE, MofNRule, MofNState
from tokt.training.datasets.dataset import open_dataset
from tokt.training.evaluation.frame_scores import (
    FrameScores,
    FrameTable,
    frame_figures,
    frame_names,
    frame_table,
)
from tokt.training.fitting.choose_operating_point import FalseStatusTarget, choose_frame_rule
from tokt.training.fitting.exceedance_model import fit_exceedance_model

# --- the law of the tail -----------------------------------------------------------------------

RATE = 1e-4


def ocean(rng, blocks=5, copies=2, between=0.5):
    """20 frames a block, each value seen `copies` times: a Gumbel law and a block's own level."""
    levels = rng.normal(0, between, (blocks, 1))
    values = levels + np.repeat(rng.gumbel(size=(blocks, 20 // copies)), copies, axis=1)
    return values.ravel(), np.repeat(np.arange(blocks), 20).astype(object)


def test_extrapolated_margins_keep_the_rate_where_the_truth_is_known():
    """Over many simulated missions of 100 frames: what the true law says of the margins."""
    rng = np.random.default_rng(4)
    truth = np.sort(rng.normal(0, 0.5, 2_000_000) + rng.gumbel(size=2_000_000))

    def true_rate(margin):
        return 1 - np.searchsorted(truth, margin) / len(truth)

    tails = [fit_exceedance_model(*ocean(rng), RATE) for _ in range(60)]
    estimates = [true_rate(tail.margin(0.5)) for tail in tails]
    bounds = [true_rate(tail.margin(0.95)) for tail in tails]
    assert RATE / 10 < np.median(estimates) < 2 * RATE
    assert np.mean(np.array(bounds) <= RATE) >= 0.8
    normal = [true_rate(stats.norm.isf(RATE, *stats.norm.fit(ocean(rng)[0]))) for _ in range(20)]
    assert np.median(normal) > 5 * RATE  # why it is not a normal law


def test_margins_over_dives_keep_the_rate_on_dives_never_seen():
    """Dives differ more than their blocks: over blocks the same frames promise too much."""
    rng = np.random.default_rng(4)
    truth = np.sort(rng.normal(0, np.hypot(1, 0.5), 10**6) + rng.gumbel(size=10**6))
    kept = {"dive": [], "block": []}
    for _ in range(60):
        dives = [ocean(rng, blocks=4) for _ in range(3)]
        values = np.concatenate([one + rng.normal() for one, _ in dives])
        block = np.concatenate([number * 4 + blocks for number, (_, blocks) in enumerate(dives)])
        for unit, names in (("dive", block // 4), ("block", block)):
            margin = fit_exceedance_model(values, names, RATE).margin(0.95)
            kept[unit].append(1 - np.searchsorted(truth, margin) / len(truth) <= RATE)
    assert np.mean(kept["dive"]) >= 0.85 > np.mean(kept["block"])


def test_too_little_is_not_extrapolated():
    values, block = ocean(np.random.default_rng(3))
    assert fit_exceedance_model(values[:9], block[:9], RATE) is None
    assert fit_exceedance_model(values[:20], block[:20], RATE) is None  # one block
    for single in (1.0, 0.1, -1 / 3):  # whose mean is not always the very same number
        assert fit_exceedance_model(np.full(100, single), block, RATE) is None


@settings(max_examples=scaled(80))
@given(
    seed=st.integers(0, 10**6),
    gaps=st.lists(st.integers(1, 4), min_size=1, max_size=25),
    least=st.integers(1, 3),
    hits=st.integers(1, 4),
    more=st.integers(0, 3),
    white=st.integers(1, 2),
    unjudged=st.floats(0, 0.4),
)
def test_a_statistic_exceeds_the_margin_where_the_runtime_says_obstacle(
    seed, gaps, least, hits, more, white, unjudged
):
    rng = np.random.default_rng(seed)
    scores = rng.normal(size=(len(gaps), 4)).round(1)
    judged = rng.random(len(gaps)) >= unjudged
    rule = MofNRule(0.3, least, hits, hits + more)
    state, expected = MofNState(rule), []
    for gap, score, known in zip(gaps, scores, judged, strict=True):
        state.skip(gap - 1)
        expected.append(state.add(score if known else None, white) == OBSTACLE)
    n = len(gaps)
    number = np.zeros(n, np.int64)
    keys, places = pd.DataFrame(index=range(n)), np.cumsum(gaps)
    frames = FrameTable(keys, number, number, judged, np.full(n, white), places)
    laid_out = FrameScores(frames, np.where(judged[:, None], scores, -np.inf), judged)
    found = laid_out.statistic(rule.min_patches, rule.m, rule.n)
    assert (found > rule.margin).tolist() == expected


@pytest.fixture(scope="module")
def dataset(trained):
    return open_dataset("tiny", trained / "datasets")


@pytest.fixture(scope="module")
def frames(dataset):
    return frame_table(dataset)


@pytest.fixture
def score(dataset):
    """Made-up scores: -3 to -2 on water, 2 on the tower."""
    rng = np.random.default_rng(0)
    clear = -3 + rng.random(len(dataset.patches))
    return np.where(dataset.targets() == 1, 2.0, clear)


def put(dataset, score, frame, values, at=0):
    """Give some patches of a frame these scores, from a place in the grid on."""
    rows = np.flatnonzero(dataset.patches.frame == frame)[at : at + len(values)]
    score[rows] = values


def choose(dataset, score, **asked):
    every = np.ones(len(score), bool)
    return choose_frame_rule(dataset, score, every, FalseStatusTarget(**asked))


def test_margin_is_never_below_what_was_seen_unless_the_rate_allows_it(dataset, score):
    tight, seen = choose(dataset, score, least_patches=1, frame_rule=(1, 1))
    assert tight == MofNRule(0.0, 1) and seen["detected"] == seen["obstacle_frames"] == 25
    put(dataset, score, 2, [1.23456])
    rule, chosen = choose(dataset, score, least_patches=1, frame_rule=(1, 1))
    assert rule.margin >= 1.23456 and chosen["false_status"] == 0
    loose, allowed = choose(dataset, score, least_patches=1, frame_rule=(1, 1), rate=0.1)
    assert loose.margin < 1.23456 and allowed["false_status"] == 1  # of 15
    surer = choose(dataset, score, least_patches=1, frame_rule=(1, 1), confidence=0.95)[0]
    assert surer.margin > rule.margin


def test_the_rule_that_finds_most_is_chosen_and_the_simpler_one_of_equals(dataset, frames, score):
    for index, frame in enumerate(frames.keys.frame[frames.ocean]):
        # Snow: a patch, each time another.
        put(dataset, score, frame, [2.5 + 0.01 * (index % 5)], at=7 * index % 90)
    rule, chosen = choose(dataset, score)
    assert (rule.min_patches, rule.m, rule.instant_margin) == (2, 1, None)
    assert chosen["detected"] == 25 and len(chosen["candidates"]) == 8
    assert chosen["candidates"][0]["detected"] == 0  # one patch, at once
    put(dataset, score, 13, [2.5, 2.5, 2.5])  # something bright, in one frame alone
    rule, chosen = choose(dataset, score)
    # The tower covers a patch for two frames only.
    assert (rule.min_patches, rule.m, rule.n) == (1, 2, 3)
    assert chosen["detected"] == 21 and chosen["latency_frames"] == 1
    assert chosen["false_status"] == 0 and rule.margin < 2 < 2.5 <= rule.instant_margin


def test_a_strong_sudden_obstacle_does_not_wait(dataset, score):
    asked = {"least_patches": 1, "frame_rule": (2, 3)}
    score[dataset.targets() == 0] += 3
    put(dataset, score, 13, [2.5])  # a flash on open water
    for strength, detected in ((20.0, 25), (2.0, 21)):
        score[dataset.targets() == 1] = strength
        rule, chosen = choose(dataset, score, **asked)
        assert rule.margin < 2 and 2.5 <= rule.instant_margin < 20
        assert chosen["detected"] == detected


def test_what_the_data_cannot_show_is_said(dataset, score):
    _, chosen = choose(dataset, score)
    assert chosen["ocean_frames"] == 15 and chosen["ocean_blocks"] == 4
    assert chosen["reachable"] is False
    assert np.isclose(chosen["upper_bound"]["of_frames"], 1 - 0.05 ** (1 / 15))
    assert np.isclose(chosen["upper_bound"]["of_blocks"], 1 - 0.05 ** (1 / 4))
    for words in ("1 in 10,000", "0 of 15", "29956 independent ocean frames"):
        assert words in chosen["words"]
    assert "extrapolated, a best estimate, not a bound" in chosen["words"]
    assert "not a bound" not in choose(dataset, score, confidence=0.95)[1]["words"]
    assert choose(dataset, score, rate=0.3)[1]["reachable"] is True


def test_by_dive_the_level_changes_from_dive_to_dive(dataset, score, monkeypatch):
    def chosen_by_dive(tested):
        return choose_frame_rule(dataset, score, tested.to_numpy(), FalseStatusTarget(), True)[1]

    def named(last_of_a):
        for table in ("patches", "frames"):
            rows = getattr(dataset, table)
            missions = np.where(rows.frame > last_of_a, "b", "a")
            monkeypatch.setattr(dataset, table, rows.assign(mission=missions))

    number = dataset.patches.frame
    chosen = chosen_by_dive(number > 0)
    assert "unit" not in chosen and chosen["ocean_blocks"] == 4  # of one dive there are its blocks
    named(20)
    chosen = chosen_by_dive(number > 0)
    assert chosen["unit"] == "dive" and chosen["ocean_blocks"] == 2
    assert "(2 dives)" in chosen["words"] and "of dives" in chosen["words"]
    assert "from dive to dive" in chosen["method"]
    assert chosen["tail"][0]["blocks"] == 2
    # A single ocean frame of the other dive: that makes no law over dives.
    named(36)
    chosen = chosen_by_dive(number <= 37)
    assert "unit" not in chosen and chosen["extrapolated_rate"] is not None
    assert "blocks of near copies" in chosen["words"]
    assert "of another dive's water nothing was shown. The rate is unknown in b" in chosen["words"]
    assert chosen["rate_unknown_in"] == ["b"]
    # None at all.
    chosen = chosen_by_dive((number <= 36) | (dataset.targets() == 1))
    assert "unit" not in chosen and chosen["extrapolated_rate"] is not None


def test_without_ocean_frames_nothing_is_chosen(dataset, frames, score, monkeypatch):
    every = np.ones(len(score), bool)
    part = ~np.isin(frames.of_patch, np.flatnonzero(frames.ocean))
    for tested in (part, every):
        rule, chosen = choose_frame_rule(dataset, score, tested, FalseStatusTarget())
        assert rule == MofNRule() and chosen["method"] == "none" and chosen["words"]
        # Then a folder of patches: each of its "frames" is a patch.
        monkeypatch.setattr(dataset, "block_frames", None)


def test_rows_that_were_not_tested_do_not_matter(dataset, score):
    tested = (dataset.patches.frame <= 30).to_numpy()
    clean = choose_frame_rule(dataset, score, tested, FalseStatusTarget())
    score[~tested] = np.nan
    assert choose_frame_rule(dataset, score, tested, FalseStatusTarget()) == clean
    score[~tested] = 99.0
    assert choose_frame_rule(dataset, score, tested, FalseStatusTarget()) == clean


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"rate": 0.9999}, "between 1e-09 and 0.5"),
        ({"rate": float("nan")}, "between 1e-09 and 0.5, not at nan"),
        ({"rate": 1e-320}, "between 1e-09 and 0.5"),
        ({"confidence": 0.4}, "between 0.5 and 1"),
        ({"frame_rule": (3, 2)}, "K of N"),
        ({"least_patches": 0}, "at least 1 patch"),
    ],
)
def test_targets_out_of_bounds(asked, message):
    refuses(message, FalseStatusTarget, **asked)


def test_more_patches_than_a_frame_has_are_refused(fabricate):
    made = fabricate(["ocean", "reef"] * 10)
    refuses("frames of 1 patches never show 2", choose, made, np.zeros(20), least_patches=2)


def test_figures_judge_each_frame_by_its_folds_rule(dataset, score):
    number = dataset.patches.frame.to_numpy()
    fold = np.where(number <= 20, 0, 1)
    fold[number == 1] = -1
    put(dataset, score, 2, [0.5])
    put(dataset, score, 26, [0.5])  # an ocean frame of the second fold, whose rule asks for more
    missed = dataset.targets() * (number == 30) == 1
    score[missed] = 0.7
    found = frame_figures(dataset, score, fold, [MofNRule(), MofNRule(1.0, 2)])
    assert found["ocean_frames"] == 14 and found["obstacle_frames"] == 25
    assert found["false_status_frames"] == ["tiny:2"] and found["false_status"] == 1
    assert found["missed_frames"] == ["tiny:30"] and found["detected"] == 24
    assert found["first_obstacle_frame"] == {"tiny": 4}
    assert found["first_detection"] == {"tiny": 4}
    assert found["latency_frames"] == 0


def test_a_rule_over_frames_comes_later_and_lasts_over_an_obstacles_end(dataset, score):
    fold = np.zeros(len(score), int)
    found = frame_figures(dataset, score, fold, [MofNRule(0.0, 1, 2, 3)])
    # The tower stands in frames 4 to 11, 16 to 23 and 28 to 35, and 40.
    assert found["missed_frames"] == ["tiny:4", "tiny:16", "tiny:28", "tiny:40"]
    assert found["false_status_frames"] == ["tiny:12", "tiny:24", "tiny:36"]
    assert found["first_detection"] == {"tiny": 5} and found["latency_frames"] == 1
    late = [(one["first_obstacle_frame"], one["frames_late"]) for one in found["approaches"]]
    assert late == [(4, 1)]  # it never goes for long enough to come again
    rate = found["false_status_per_hour"]
    assert rate["in_frames"] == 1000 and rate["false_status"] == 1000 * 3 / found["ocean_frames"]


def test_figures_stop_at_gaps(dataset, score):
    """Frames 5 and 8 were not tested: no three in a row before 9, and no two of two at 6 or 9."""
    fold = np.where(np.isin(dataset.patches.frame, [5, 8]), -1, 0)
    found = frame_figures(dataset, score, fold, [MofNRule()])
    assert found["first_detection"] == {"tiny": 9}
    two = frame_figures(dataset, score, fold, [MofNRule(0.0, 1, 2, 2)])
    assert two["missed_frames"][:3] == ["tiny:4", "tiny:6", "tiny:9"]
    nobody = frame_figures(dataset, score, np.full(len(score), -1), [MofNRule()])
    assert nobody["ocean_frames"] == nobody["obstacle_frames"] == 0
    assert nobody["first_detection"] == {"tiny": None}
    assert nobody["approaches"] == [] and nobody["false_status_per_hour"] is None


def test_missions_and_cameras_are_runs_of_their_own(dataset, monkeypatch):
    for name in ("patches", "frames"):
        table = getattr(dataset, name)
        three = [table, table.assign(camera="right"), table.assign(mission="wreck")]
        monkeypatch.setattr(dataset, name, pd.concat(three, ignore_index=True))
    found = frame_table(dataset)
    assert len(found) == 120
    starts = np.flatnonzero(np.diff(found.place) > 1) + 1
    assert starts.tolist() == [40, 80] and (np.diff(found.place)[starts - 1] >= 60).all()
    assert frame_names(found.keys[found.keys.frame == 9]) == ["tiny:9", "tiny:right:9", "wreck:9"]
