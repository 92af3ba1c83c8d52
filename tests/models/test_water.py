"""The state of the water: its prior, the boundary that moves with the frames, and its limits."""

import dataclasses
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from tests.calls import refuses
from tests.tiers import scaled
from tokt.models.water import WaterPrior, WaterState

PRIOR = WaterPrior(*(-1.2, 1.2, 0.5, 0.9, 0.3), limit=0.3, weight=30.0, sd_weight=300.0, rounds=6)
LOOSE = WaterPrior(-2.1, 3.3, 1.4, 2.4, 0.4)
"""As training makes it: it gives way to what the frames show."""


def frame(water, obstacle, share, seed=0, spread=0.2):
    """The scores of 100 patches, some of them obstacles."""
    rng = np.random.default_rng(seed)
    sides = np.where(np.arange(100) < 100 * share, obstacle, water)
    return sides + rng.normal(0, spread, 100)


def boundaries(frames, prior=PRIOR):
    state, found = WaterState(prior), []
    for scores in frames:
        state.begin()
        found.append(state.judge(scores))
    return found


def test_the_boundary_follows_a_water_that_lies_elsewhere():
    usual, brighter, darker = (
        PRIOR.boundary(frame(-1.2 + shift, 1.2 + shift, 0.3)) for shift in (0, 0.5, -0.5)
    )
    assert abs(usual) < 0.2
    assert brighter > usual + 0.1 and darker < usual - 0.1
    assert PRIOR.boundary(frame(-0.3, 2.5, 0.3)) == 0.3, "at most its limit"
    assert PRIOR.boundary(frame(0.5, 2.5, 0.3)) == -0.3, "too far: all of it is obstacles"


def test_faint_obstacles_bring_the_boundary_down():
    """Where they are half way to the water, and near the water the mixture is hard to part."""
    faint = np.concatenate([frame(-3.7, 0.0, 0.3, seed, 1.2) for seed in range(5)])
    assert LOOSE.boundary(faint) < -1.0
    assert dataclasses.replace(LOOSE, rounds=6).boundary(faint) > LOOSE.boundary(faint)


def by_the_formulas(prior, scores):
    """The boundary by EM as its paper has it: responsibilities, then moments of each side."""
    names = ("water", "obstacle")
    before = [norm(getattr(prior, name), getattr(prior, f"{name}_sd")) for name in names]
    sides, share = before, prior.share
    for _ in range(prior.rounds):
        logs = likelihoods(sides, share, scores)
        parts = [np.exp(log - np.logaddexp(*logs)) for log in logs]
        sides = [anew(prior, *pair, scores) for pair in zip(before, parts, strict=True)]
        share = (parts[1].sum() + prior.weight * prior.share) / (len(scores) + prior.weight)
    at = np.arange(-round(prior.limit * 100), round(prior.limit * 100) + 1) / 100
    water, obstacle = likelihoods(sides, share, at)
    beyond = at[(water < obstacle) & (at >= sides[0].mean())]
    return beyond[0] if len(beyond) else at[-1]


def likelihoods(sides, share, scores):
    pairs = zip(sides, (1 - share, share), strict=True)
    return [side.logpdf(scores) + np.log(part) for side, part in pairs]


def anew(prior, before, part, scores):
    mean = (part @ scores + prior.weight * before.mean()) / (part.sum() + prior.weight)
    squares = part @ (scores - mean) ** 2 + prior.sd_weight * before.var()
    return norm(mean, np.sqrt(squares / (part.sum() + prior.sd_weight)))


@settings(deadline=None, max_examples=scaled(60))
@given(
    st.floats(-5, 3),
    st.floats(0, 6),
    st.floats(0, 1),
    st.integers(0, 1000),
    st.sampled_from([PRIOR, LOOSE, replace(LOOSE, limit=4.0, share=0.05)]),
)
def test_the_boundary_is_that_of_the_formulas(water, apart, share, seed, prior):
    scores = frame(water, water + apart, share, seed, spread=0.7)
    # One step of 0.01 beside, where a last digit decides.
    assert abs(prior.boundary(scores) - by_the_formulas(prior, scores)) < 0.011


@pytest.mark.parametrize("rounds", [0, -1, 101, 10**9, 6.0, True, None])
def test_rounds_are_bounded_as_each_frame_takes_them(rounds):
    refuses("water's prior", WaterPrior.from_json, {**PRIOR.to_json(), "rounds": rounds})


def test_a_prior_without_rounds_is_of_an_older_tokt():
    told = PRIOR.to_json()
    assert WaterPrior.from_json(told) == PRIOR and told.pop("rounds") == 6
    assert WaterPrior.from_json(told) == PRIOR
    refuses("other entries", WaterPrior.from_json, {**told, "more": 1})


def test_frames_together_say_more_than_the_last_and_older_ones_are_forgotten():
    strange, usual = frame(-0.6, 1.5, 0.3), frame(-1.2, 1.2, 0.3)
    alone, long = PRIOR.boundary(usual), boundaries([strange] * 5 + [usual] * 5)
    assert long[5] != alone and long[-1] == boundaries([usual] * 5)[-1]
    state = WaterState(PRIOR)
    for missed in (0, 0, 4):
        state.begin(missed)
        last = state.judge(usual)
    assert last == alone, "after four missing frames only the newest is known"
    state.begin()
    assert state.judge(strange) == PRIOR.boundary(np.concatenate([usual, strange]))


SCORES = st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=40).map(np.array)


@settings(max_examples=scaled(200))
@given(st.lists(SCORES, min_size=1, max_size=8), st.floats(0.01, 10))
def test_it_never_moves_by_more_than_its_limit(frames, limit):
    prior = dataclasses.replace(PRIOR, limit=limit)
    for found in boundaries(frames, prior):
        assert abs(found) <= limit + 0.005 and round(found, 2) == found


@settings(max_examples=scaled(8))
@given(
    st.floats(0.05, 3),
    st.floats(0.0, 1.0),
    st.floats(0, 1),
    st.integers(0, 99),
    st.sampled_from([PRIOR, LOOSE]),
)
def test_an_obstacle_that_fills_the_view_is_never_clear(middle, spread, grain, seed, prior):
    """From frame 1 for 1,000 frames, weak or strong, even or not: it moves too little."""
    rng = np.random.default_rng(seed)
    view = middle + spread * rng.random(100)
    state = WaterState(prior)
    for index in range(1000):
        scores = view + grain * 0.1 * rng.normal(size=100) if index % 100 < 5 else view
        state.begin()
        boundary = state.judge(scores)
        if index < 10 or index % 100 < 5 or index == 999:
            assert (scores - boundary > 0).any()


def test_without_a_prior_it_stays():
    assert boundaries([frame(0.5, 2.5, 0.3)] * 3, None) == [0.0] * 3


def test_the_prior_is_of_dives_that_count_the_same():
    rng = np.random.default_rng(3)
    parts = [(-1.0, 1.0, 4000, 40), (-1.4, 2.0, 100, 100)]
    scores = np.concatenate(
        [
            rng.normal(at, 0.4, n)
            for water, other, w, o in parts
            for at, n in ((water, w), (other, o))
        ]
    )
    obstacle = np.concatenate([np.repeat([False, True], (w, o)) for _, _, w, o in parts])
    dive = np.repeat(["a", "b"], [w + o for _, _, w, o in parts])
    prior = WaterPrior.of(scores, obstacle, dive)
    assert prior.water == pytest.approx(-1.2, abs=0.1)
    assert prior.obstacle == pytest.approx(1.5, abs=0.1)
    assert prior.water_sd == pytest.approx(0.4, abs=0.1)
    assert prior.share == pytest.approx((40 / 4040 + 0.5) / 2)
    assert WaterPrior.of(scores, ~obstacle, dive) is None, "water above obstacles"
    assert WaterPrior.of(scores, np.zeros(len(scores), bool), dive) is None


def test_gray_frames_have_a_prior_of_their_own():
    """Obstacles stand out less there: what colour takes for water is one."""
    rng = np.random.default_rng(4)
    scores = np.concatenate([rng.normal(-1.0, 0.3, 60), rng.normal(1.2, 0.3, 40)])
    gray = replace(LOOSE, water=-1.2, obstacle=1.2, water_sd=0.5, obstacle_sd=0.5)
    both = replace(LOOSE, gray=gray)

    def boundary(prior, **how):
        state = WaterState(prior)
        state.begin()
        return state.judge(scores, **how)

    assert boundary(both, gray=True) == boundary(gray) != boundary(LOOSE)
    assert boundary(both) == boundary(LOOSE) == boundary(LOOSE, gray=True)
    assert WaterPrior.from_json(json.loads(json.dumps(both.to_json()))) == both
    assert "In gray frames: -1.20 and 1.20." in both.words() and "gray" not in LOOSE.words()
    without = {name: value for name, value in gray.to_json().items() if name != "rounds"}
    odd = ({"share": 2}, {"frames": 4}, {"limit": 1.0})
    for wrong in (both.to_json(), 3, {}, [], without, *({**gray.to_json(), **one} for one in odd)):
        refuses("water's prior", WaterPrior.from_json, {**LOOSE.to_json(), "gray": wrong})


def test_frames_of_the_other_kind_say_nothing_of_a_boundary():
    """As where a camera switches to infrared."""
    rng = np.random.default_rng(6)
    gray = replace(LOOSE, water=-1.6, obstacle=1.2, water_sd=0.8, obstacle_sd=1.0)
    state = WaterState(replace(LOOSE, gray=gray))
    colour = np.concatenate([rng.normal(-2.1, 1.0, 80), rng.normal(4.0, 1.5, 20)])
    infrared = np.concatenate([rng.normal(-1.6, 0.5, 95), rng.normal(1.0, 0.5, 5)])
    alone = WaterState(gray)
    alone.begin()
    expected = alone.judge(infrared)
    for _ in range(4):
        state.begin()
        state.judge(colour)
    state.begin()
    assert state.judge(infrared, gray=True) == expected
    assert (infrared > expected).any()


def test_what_is_no_prior_is_refused():
    kept = json.loads(json.dumps(PRIOR.to_json()))
    assert WaterPrior.from_json(kept) == PRIOR
    for name, value in (
        ("water", 2.0),
        ("obstacle_sd", float("nan")),
        ("share", 1),
        ("limit", 1e6),
        ("frames", 0),
        ("sd_weight", "300"),
    ):
        refuses("water", WaterPrior.from_json, {**kept, name: value})
    for wrong in (None, [], {}, {**kept, "more": 1}):
        refuses("a water's prior has other entries", WaterPrior.from_json, wrong)
