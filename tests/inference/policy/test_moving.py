"""Things that move by themselves: told from what stands, and what a status makes of them."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.inference.swimming import (
    HEIGHT,
    NOTHING,
    STEP_S,
    WIDTH,
    Told,
    frame,
    in_patches,
    motion,
    pictured,
    school,
    texture,
)
from tests.tiers import scaled
from tokt.inference.config import ALL, NEAR, NONE
from tokt.inference.frame import MANY_MISSED
from tokt.inference.policy.moving import KNOWN_PAIRS, NEAR_M, MovingThings
from tokt.inference.reason import Reason
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN

STEPS = 6
OWN = {"shift": (3.0, 1.0), "turn_deg": 0.5, "growth": 1.01}


def swum(
    told,
    swimmers,
    own=OWN,
    seed=1,
    avoid=NEAR,
    steps=STEPS,
    standing=None,
    t=None,
    threads=1,
    **more,
):
    """The verdicts on a school before a scene, and the share of the view that it covers."""
    policy, scene, verdicts, shares = MovingThings(told, avoid, threads), texture(seed), [], []
    for step in range(steps):
        picture, mask = pictured(scene, motion(step, **own), swimmers, step, seed)
        told.mask = in_patches(mask)
        if standing is not None:
            told.mask[standing] = 255
        shares.append((told.mask > 0).mean())
        at = {} if t is None else {"t": 1e9 + t(step)}
        verdicts.append(policy.judge(frame(step, picture, **at, **more)).verdict)
    return verdicts, shares


def test_a_school_alone_is_unknown_once_that_is_known():
    verdicts, shares = swum(Told(), school(1))
    assert {verdict.status for verdict in verdicts[:KNOWN_PAIRS]} == {OBSTACLE}
    assert [verdict.moving for verdict in verdicts[:KNOWN_PAIRS]] == [None] * KNOWN_PAIRS
    last = verdicts[-1]
    assert (last.status, last.reason, last.box) == (UNKNOWN, Reason.MOVING, None)
    assert last.moving == pytest.approx(shares[-1], abs=0.1)
    assert last.health.startswith("only moving things are seen, in ")


def test_points_followed_beside_the_policy_are_the_same():
    alone, beside = (swum(Told(), school(1), threads=threads)[0] for threads in (1, 2))
    assert alone == beside and alone[-1].reason == Reason.MOVING


@given(st.integers(0, 1000), st.tuples(st.floats(-6, 6), st.floats(-4, 4)), st.floats(-1, 1))
@settings(max_examples=scaled(12))
def test_a_school_is_told_however_the_vehicle_moves(seed, shift, turn_deg):
    own = {"shift": shift, "turn_deg": turn_deg, "growth": 1.01}
    # Where the ways of a school fit one motion it is not told: that is no error.
    found = [swum(Told(), school(seed + k), own, seed)[0][-1].moving for k in range(3)]
    assert any(found), found


@given(
    st.integers(0, 1000),
    st.tuples(st.floats(-10, 10), st.floats(-8, 8)),
    st.floats(-2, 2),
    st.floats(0.98, 1.04),
    st.floats(-20, 20),
)
@settings(max_examples=scaled(30))
def test_what_stands_is_never_lost(seed, shift, turn_deg, growth, parallax):
    """A near thing before a far scene, whatever moves: the vehicle, or what is a rigid vehicle."""
    told, near, far = Told(), texture(seed + 1), texture(seed)
    policy = MovingThings(told)
    for step in range(STEPS):
        picture, _ = pictured(far, motion(step, shift, turn_deg, growth), step=step, seed=seed)
        moved = motion(step, (shift[0] + parallax, shift[1]), turn_deg, growth)
        thing = NOTHING.copy()
        left = int(np.clip(140 + step * parallax, 0, WIDTH - 60))
        thing[60:210, left : left + 60] = 255
        closer, _ = pictured(near, moved, step=step, seed=seed)
        picture[thing > 0] = closer[thing > 0]
        told.mask = in_patches(thing)
        verdict = policy.judge(frame(step, picture)).verdict
        assert verdict.status == OBSTACLE and verdict.box is not None
        assert verdict.reason is Reason.OK and not verdict.moving


def test_what_stands_beside_a_school_keeps_the_status():
    for standing in (np.s_[:, :36], np.s_[54:81, 324:]):
        verdicts, _ = swum(Told(), school(1), standing=standing)
        assert {verdict.status for verdict in verdicts} == {OBSTACLE}
        assert verdicts[-1].moving > 0


@pytest.mark.parametrize(
    ("avoid", "distance_m", "status"),
    [
        (NEAR, None, UNKNOWN),
        (NEAR, NEAR_M + 0.1, UNKNOWN),
        (NEAR, NEAR_M - 0.1, OBSTACLE),
        (ALL, NEAR_M + 0.1, OBSTACLE),
        (NONE, NEAR_M - 0.1, UNKNOWN),
    ],
)
def test_which_moving_things_are_avoided(avoid, distance_m, status):
    verdicts, _ = swum(Told(distance_m=distance_m), school(1), avoid=avoid)
    assert verdicts[-1].status == status and verdicts[-1].moving > 0
    assert verdicts[-1].distance_m == (None if status == UNKNOWN else distance_m)


def test_a_large_school_is_avoided():
    crowd = [replace(one, half=(50, 30)) for one in school(1, 14)]
    for avoid, status in ((NEAR, OBSTACLE), (NONE, UNKNOWN)):
        verdicts, shares = swum(Told(), crowd, avoid=avoid)
        assert shares[-1] > 0.35 and verdicts[-1].moving > 0 and verdicts[-1].status == status


@pytest.mark.parametrize(
    ("seed", "count", "own"),
    [(seed, 2, {"shift": (7.0, 2.0), "growth": 1.01}) for seed in (7, 13)]
    + [(seed, 3, {"shift": (5.0, 1.0), "growth": 1.02}) for seed in (7, 10)],
)
def test_dirt_on_the_glass_is_not_the_water(seed, count, own):
    """It stands still in the picture: by it alone all that stands in the scene would swim."""
    rng, scene, dirt = np.random.default_rng(seed), texture(seed), np.zeros((HEIGHT, WIDTH))
    policy = MovingThings(told := Told())
    for x, y in rng.uniform([10, 10], [WIDTH - 10, HEIGHT - 10], (40, 2)):
        cv2.circle(dirt, (int(x), int(y)), 4, 60, -1)
    poles = rng.uniform([60, 60], [300, 210], (count, 2))
    for step in range(12):
        moved, _ = pictured(scene, motion(step, **own), step=step, seed=seed)
        standing = NOTHING.copy()
        for x, y in poles + step * np.array(own["shift"]):
            cv2.circle(standing, (int(x), int(y)), 16, 255, -1)
        picture = np.where(standing > 0, moved, 60) + dirt + rng.normal(0, 1, dirt.shape)
        told.mask = in_patches(standing)
        said = policy.judge(frame(step, np.clip(picture, 0, 255).astype(np.uint8))).verdict
        assert said.reason is not Reason.MOVING


def test_in_water_without_a_point_nothing_is_known():
    policy = MovingThings(told := Told())
    told.mask = in_patches(255 * (np.hypot(*(np.mgrid[:HEIGHT, :WIDTH] - 150)) < 45).astype("u1"))
    inner = cv2.erode(told.mask, np.ones((9, 9)))
    for step in range(STEPS):
        picture, _ = pictured(texture(1), motion(step, (9.0, 2.0)))
        picture = np.where(inner > 0, picture, np.uint8(60))
        verdict = policy.judge(frame(step, picture)).verdict
    assert (verdict.status, verdict.moving) == (OBSTACLE, None)


@pytest.mark.parametrize("more", [{"timed": False}, {"missed": MANY_MISSED}])
def test_without_the_frame_before_nothing_is_known(more):
    verdicts, _ = swum(Told(), school(1), **more)
    assert {(verdict.status, verdict.moving) for verdict in verdicts} == {(OBSTACLE, None)}


@pytest.mark.parametrize("size", [(271, 361), (300, 360), (63, 90), (20, 30)])
def test_another_size_of_picture_begins_anew(size):
    told = Told()
    policy, scene = MovingThings(told), texture(1)
    for step in range(STEPS):
        picture, mask = pictured(scene, motion(step, **OWN), school(1), step)
        told.mask = in_patches(mask)
        assert policy.judge(frame(step, picture)).verdict
    other = np.zeros(size, np.uint8)
    told.mask = other
    assert policy.judge(frame(STEPS, other)).verdict.moving is None


def test_frames_that_follow_each_other_fast_tell_as_much():
    slow = [replace(one, velocity=tuple(np.array(one.velocity) / 5)) for one in school(1)]
    own = {"shift": (0.6, 0.2), "turn_deg": 0.1, "growth": 1.002}
    verdicts, _ = swum(Told(), slow, own, steps=5 * STEPS, t=lambda step: step * STEP_S / 5)
    reasons = {(verdict.status, verdict.reason) for verdict in verdicts}
    assert reasons == {(OBSTACLE, Reason.OK), (UNKNOWN, Reason.MOVING)}


@pytest.mark.parametrize(("gap_s", "known"), [(0.9, True), (1.1, False)])
def test_over_a_gap_in_time_nothing_is_compared(gap_s, known):
    late = gap_s - STEP_S
    verdicts, _ = swum(Told(), school(1), t=lambda at: STEP_S * at + late * (at == STEPS - 1))
    assert (verdicts[-1].moving is not None) == known


def test_a_school_that_left_is_forgotten():
    """One fish alone is an obstacle again, though many swam before."""
    told, scene, statuses = Told(), texture(1), []
    policy = MovingThings(told)
    for step in range(20):
        fish = school(1) if step < STEPS else school(1, 1)
        picture, mask = pictured(scene, motion(step, **OWN), fish, step % STEPS, 1)
        told.mask = in_patches(mask)
        statuses.append(policy.judge(frame(step, picture)).verdict.status)
    assert UNKNOWN in statuses[:STEPS] and statuses[-1] == OBSTACLE


def test_without_fish_nothing_moves():
    verdict = swum(Told(), [])[0][-1]
    assert (verdict.status, verdict.moving, verdict.reason) == (CLEAR, 0.0, Reason.OK)
    assert verdict.mask_size == (HEIGHT, WIDTH)
