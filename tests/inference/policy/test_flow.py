"""Points followed between two pictures, and the motion that most of them share."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.swimming import HEIGHT, NOTHING, WIDTH, motion, pictured, texture
from tests.tiers import scaled
from tokt.inference.policy.flow import FlowPicture, PointFlow, common_motion, follow

ways = st.tuples(st.floats(-12, 12), st.floats(-12, 12))
seeds = st.integers(0, 10_000)


def followed(seed, **how):
    """The tracks over a scene that moved so, and how each point really went."""
    scene, moved = texture(seed), motion(1, **how)
    before, after = (
        FlowPicture(pictured(scene, motion(step, **how), step=step, seed=seed)[0])
        for step in (0, 1)
    )
    tracks = follow(before, after, before.points(NOTHING))
    return tracks, tracks.then @ moved[:, :2].T + moved[:, 2]


@given(seeds, ways, st.floats(-2, 2), st.floats(0.97, 1.04))
@settings(max_examples=scaled(60))
def test_points_go_as_the_scene_does(seed, shift, turn_deg, growth):
    tracks, really = followed(seed, shift=shift, turn_deg=turn_deg, growth=growth)
    assert len(tracks.then) >= 12
    assert np.median(np.abs(tracks.now - really)) < 0.2
    made = common_motion(tracks, np.ones(len(tracks.then), bool))
    assert made is not None
    np.testing.assert_allclose(made, motion(1, shift, turn_deg, growth), atol=0.5)


def test_a_few_points_prove_nothing_nor_do_those_that_go_their_own_ways():
    points = np.random.default_rng(1).uniform(0, 200, (40, 2)).astype(np.float32)
    every = np.ones(len(points), bool)
    assert common_motion(PointFlow(points, points), every) is not None
    assert common_motion(PointFlow(points, points), every & (np.arange(40) < 6)) is None
    assert common_motion(PointFlow(points, points[::-1].copy()), every) is None


@pytest.mark.parametrize("level", [0, 30, 255])
def test_a_picture_without_corners_has_no_points(level):
    blank = FlowPicture(np.full((HEIGHT, WIDTH), level, np.uint8))
    points = blank.points(NOTHING)
    assert points.shape == (0, 2) and follow(blank, blank, points).now.shape == (0, 2)
