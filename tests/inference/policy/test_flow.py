"""Points followed between two pictures, and what one rigid motion explains."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.swimming import HEIGHT, NOTHING, WIDTH, motion, pictured, texture
from tests.tiers import scaled
from tokt.inference.policy.flow import FlowPicture, Tracks, common_motion, follow, moves_as_one

FOCAL_PX = 590.0
MIDDLE = np.array([WIDTH, HEIGHT]) / 2
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
    assert len(tracks.then) >= 20
    assert np.median(np.abs(tracks.now - really)) < 0.2
    assert moves_as_one(tracks).mean() > 0.9
    made = common_motion(tracks)
    assert made is not None
    np.testing.assert_allclose(made, motion(1, shift, turn_deg, growth), atol=0.5)


def projected(points):
    return MIDDLE + FOCAL_PX * points[:, :2] / points[:, 2:]


def in_view(rng, count):
    """Points 1.5 to 8 m before the camera, m."""
    depth = rng.uniform(1.5, 8.0, count)
    across = rng.uniform(-0.28, 0.28, (count, 2)) * [1, 0.75]
    return np.column_stack([across * depth[:, None], depth])


def tracks_of(before, after, rng):
    noise = rng.normal(0, 0.15, (2, len(before), 2))
    there = (projected(points) + each for points, each in zip((before, after), noise, strict=True))
    return Tracks(*(points.astype(np.float32) for points in there))


@given(seeds, st.integers(10, 60))
@settings(max_examples=scaled(60))
def test_one_motion_explains_what_stands_however_the_camera_moves(seed, count):
    rng = np.random.default_rng(seed)
    points = in_view(rng, count)
    turned = cv2.Rodrigues(rng.uniform(-0.03, 0.03, 3))[0]
    after = points @ turned.T + rng.uniform(-0.1, 0.1, 3) * [1, 1, 1.5]
    assert moves_as_one(tracks_of(points, after, rng)).mean() > 0.9


@given(seeds, st.integers(20, 60))
@settings(max_examples=scaled(60))
def test_one_motion_does_not_explain_a_school(seed, count):
    rng = np.random.default_rng(seed)
    points = in_view(rng, count)
    own_ways = rng.normal(0, 0.08, (count, 3))
    assert moves_as_one(tracks_of(points, points + own_ways, rng)).mean() < 0.9


def test_a_few_points_prove_nothing():
    rng = np.random.default_rng(1)
    points = in_view(rng, 6)
    tracks = tracks_of(points, points + rng.normal(0, 0.1, points.shape), rng)
    assert moves_as_one(tracks).all() and common_motion(tracks) is None


def test_what_does_not_move_at_all_moves_as_one():
    points = np.arange(40, dtype=np.float32).reshape(20, 2)
    assert moves_as_one(Tracks(points, points)).all()
    same = np.ones((20, 2), np.float32)
    assert moves_as_one(Tracks(same, same)).all()


@pytest.mark.parametrize("level", [0, 30, 255])
def test_a_picture_without_corners_has_no_points(level):
    blank = FlowPicture(np.full((HEIGHT, WIDTH), level, np.uint8))
    points = blank.points(NOTHING)
    assert points.shape == (0, 2) and follow(blank, blank, points).flow.shape == (0, 2)


def test_most_points_are_where_something_was_seen():
    seen = NOTHING.copy()
    seen[100:170, 100:260] = 255
    picture, _ = pictured(texture(3), motion(0))
    x, y = FlowPicture(picture).points(seen).astype(int).T
    assert 20 < np.count_nonzero(seen[y, x]) <= 60 and np.count_nonzero(seen[y, x] == 0) <= 40
