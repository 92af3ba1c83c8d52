"""The rule that training chooses and the runtime applies: its words, bounds and states."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.calls import refuses
from tokt.models.operating_point import (
    CLEAR,
    OBSTACLE,
    UNKNOWN,
    MofNRule,
    MofNState,
    OperatingPoint,
)

RULES = st.integers(1, 5).flatmap(
    lambda window: st.builds(
        MofNRule,
        margin=st.floats(0, 10),
        min_patches=st.integers(1, 4),
        m=st.integers(1, window),
        n=st.just(window),
        instant_margin=st.none() | st.floats(10, 20),
    )
)
PATCHES = 3
SCORES = st.lists(st.sampled_from([-1.0, 5.0, 15.0, 30.0]), min_size=PATCHES, max_size=PATCHES)
FRAMES = st.lists(SCORES | st.none(), max_size=20)


def _added(state: MofNState, scores: list[float] | None) -> int:
    return state.add(None if scores is None else np.array(scores))


def _status_by_definition(rule: MofNRule, frames: list[list[float] | None], white: int) -> int:
    """Of the last frame; patch by patch, with what is not known once as nothing, once as over."""
    window = ([None] * rule.n + frames)[-rule.n :]
    now = window[-1]
    if now is None:
        return UNKNOWN
    certain = possible = strong = 0
    for patch in range(PATCHES):
        over = sum(past is not None and past[patch] > rule.margin for past in window)
        open_ = sum(past is None for past in window)
        certain += over >= rule.m
        possible += over > 0 and over + open_ >= rule.m
        strong += rule.instant_margin is not None and now[patch] > rule.instant_margin
    needed = max(rule.min_patches, white)
    if certain >= needed or strong >= white:
        return OBSTACLE
    return UNKNOWN if possible >= needed else CLEAR


@given(RULES, FRAMES, st.sampled_from([1, 1, 2]))
def test_the_states_are_those_of_the_definition(rule, frames, white):
    state = MofNState(rule)

    statuses = [state.add(None if scores is None else np.array(scores), white) for scores in frames]

    expected = [_status_by_definition(rule, frames[: i + 1], white) for i in range(len(frames))]
    assert statuses == expected


@given(RULES, FRAMES, st.integers(0, 8), FRAMES)
def test_a_gap_is_as_many_frames_that_were_not_judged(rule, before, gap, after):
    skipped, added = MofNState(rule), MofNState(rule)
    for scores in before:
        _added(skipped, scores), _added(added, scores)
    skipped.skip(gap)
    for _ in range(gap):
        added.add(None)

    for scores in after:
        assert _added(skipped, scores) == _added(added, scores)


@given(RULES, st.lists(st.tuples(SCORES, st.booleans()), max_size=20))
def test_frames_not_judged_turn_no_obstacle_that_was_seen_into_clear(rule, frames):
    """Each frame: its scores, and whether it could be judged."""
    full, partly = MofNState(rule), MofNState(rule)
    seen: list[NDArray[np.bool_]] = []

    for scores, judged in frames:
        truth = _added(full, scores)
        told = _added(partly, scores if judged else None)
        seen.append(judged & (np.array(scores) > rule.margin))
        # The patches that are confirmed were over in a frame of the window that was judged.
        of_window = np.any(seen[-rule.n :], axis=0)
        shown = np.count_nonzero(full.confirmed & of_window) >= rule.min_patches
        if not judged or (shown and truth == OBSTACLE):
            assert told != CLEAR


def test_a_doubted_frame_that_shows_nothing_is_not_known_and_what_it_shows_stays():
    rule = MofNRule(0.5, 1, 2, 3)
    for before, then in (([0.0], UNKNOWN), ([1.0], OBSTACLE)):
        state = MofNState(rule)
        for scores in ([0.0], [0.0], before):
            _added(state, scores)
        state.doubt()
        assert _added(state, [1.0]) == then


@given(RULES)
def test_an_operating_point_is_the_same_after_json(rule):
    point = OperatingPoint(rule, {"target_rate": 1e-4})
    assert OperatingPoint.from_json(json.loads(json.dumps(point.to_json()))) == point


@pytest.mark.parametrize(
    "wrong",
    [{"margin": value} for value in (-0.1, math.nan, math.inf, 10**400, 2e9, "0", None)]
    + [{"margin_now": value} for value in (10**400, math.inf, "1")]
    + [{"least_patches": 0}, {"least_patches": 1.0}, {"hits": 0}, {"hits": True}]
    + [{"hits": 3, "window": 2}, {"hits": 1, "window": 61}, {"margin": 2.0, "margin_now": 1.9}],
)
def test_a_rule_out_of_bounds_is_refused_in_words(wrong):
    refuses("frame rule", MofNRule.from_json, {**MofNRule().to_json(), **wrong})


def test_a_patch_seen_before_a_gap_and_not_now_is_not_clear_yet():
    """With the frame in the gap known it might have been 2 of 3."""
    state = MofNState(MofNRule(0.5, 1, 2, 3))
    frames = ([0.0], [0.0], [1.0], None, [0.0], [0.0])
    assert [_added(state, scores) for scores in frames] == [0, 0, 0, -1, -1, 0]
