import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.test_faults import hold_row
from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.stereo import disparity as module
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.disparity import Closing, ClosingSpeed, DisparityDetector, Matches
from tokt.inference.stereo.matching import NEAREST_M, disparity_range
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.stereo.rectify import Rectifier
from tokt.inference.verdict import verdict_from_mask

from .plain_rig import (
    CAMERA,
    HEIGHT,
    PLAIN,
    SQUARE_PX,
    WIDTH,
    even_sea,
    lit_sea,
    pair_with,
    sea_trial_pair,
    square_texture,
    unfit_pairs,
)

DISPARITY_PX = 200  # at full size: 2200 * 0.3 / 200 = 3.3 m
DEPTH_M = 3.3


@pytest.fixture
def plain():
    return DisparityDetector(PLAIN, Grid())


def pair(x: int, y: int = 350, disparity_px: int = DISPARITY_PX, seed: int = 0) -> list[np.ndarray]:
    """An even sea with one textured square, at (x, y) in the left view and nearer than it."""
    return pair_with(square_texture(), x, y, disparity_px, seed)


def test_a_square_is_found_where_it_is_at_its_distance(plain):
    found = plain.detect(Frame(1, 0.0, *pair(700)))
    assert found.mask is not None and found.mask.shape == (271, 360)
    assert found.distance_m == pytest.approx(DEPTH_M, rel=0.01)
    assert found.sight.reach_m == pytest.approx(DEPTH_M, rel=0.03)
    for number in range(2, 18):  # as long as the last pairs had anything to match
        empty = [
            view.round().astype(np.uint8) for view in (even_sea(0, number), even_sea(1, number))
        ]
        sight = plain.detect(Frame(number, 0.0, *empty)).sight
        assert (sight.reach_m is None) == (number > 15)
        assert ("visibility_m" in sight.to_fields()) == (number <= 15)
    verdict = verdict_from_mask(found.mask, "disparity")
    assert verdict.status == 1 and verdict.box is not None
    x0, y0, width, height = verdict.box
    corners = np.array([x0, y0, x0 + width, y0 + height]) * WIDTH / 360
    expected = np.array([700, 350, 700 + SQUARE_PX, 350 + SQUARE_PX])
    assert np.abs(corners - expected).max() <= 24  # half a block, in pixels at full size


def sea(camera: int = 0, seed: int = 0, light: float = 1.0) -> np.ndarray:
    """A view with nothing in it."""
    return even_sea(camera, seed, light).round().clip(0).astype(np.uint8)


def test_a_saturated_pair_can_show_an_obstacle_but_is_never_clear(plain):
    left, right = pair(700, y=650)
    left[:600], right[:600] = 255, 255
    found = plain.detect(Frame(1, 0.0, left, right))
    assert found.mask is not None and found.mask.any()
    left[600:], right[600:] = sea()[600], sea()[600]
    found = plain.detect(Frame(1, 0.0, left, right))
    assert found.mask is None and "saturated" in found.fault


def test_texture_that_matches_nowhere_is_unknown_not_clear(plain):
    left, right = pair(700)
    found = plain.detect(Frame(1, 0.0, left, np.ascontiguousarray(right[::-1])))
    assert found.mask is None and "do not match" in found.fault and found.vetoes_clear


def plane(depth_m: float, columns: slice, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Two empty views before which a textured wall stands in those columns of the left one."""
    disparity_px = round(CAMERA[0, 0] * 0.3 / depth_m)
    rng = np.random.default_rng(seed)
    wide = (WIDTH + disparity_px, HEIGHT)
    texture = cv2.resize(rng.uniform(20, 120, (HEIGHT // 8, wide[0] // 8)), wide)
    wall = np.zeros(wide[0], bool)
    wall[columns] = True
    views = sea(0, seed), sea(1, seed)
    for view, seen in zip(views, (np.s_[:WIDTH], np.s_[disparity_px:]), strict=True):
        view[:, wall[seen]] = texture[:, seen][:, wall[seen]]
    return views[0], views[1]


EVERYWHERE, THIRD = slice(None), slice(WIDTH // 3, 2 * WIDTH // 3)


@pytest.mark.parametrize("columns", [EVERYWHERE, THIRD])
@pytest.mark.parametrize("depth_m", [1.0, 1.4])
def test_what_is_nearer_than_is_searched_is_unknown_not_clear(depth_m, columns, plain):
    found = plain.detect(Frame(1, 0.0, *plane(depth_m, columns)))
    assert found.mask is None and "something too near" in found.fault and found.vetoes_clear


def test_something_too_near_before_a_wall_is_told_beside_the_walls_distance(plain):
    wall = plane(6.0, EVERYWHERE)
    alone = plain.detect(Frame(1, 0.0, *wall))
    near_x = (THIRD.start, THIRD.start - round(CAMERA[0, 0] * 0.3 / 1.0))
    for view, near, x in zip(wall, plane(1.0, THIRD, seed=5), near_x, strict=True):
        seen = slice(max(x, 0), max(x + WIDTH // 3, 0))
        view[:, seen] = near[:, seen]
    both = plain.detect(Frame(2, 0.1, *wall))
    for found in (alone, both):
        assert found.mask is not None and found.distance_m == pytest.approx(6.0, rel=0.02)
    assert not alone.note and "something may be nearer" in both.note


def test_too_little_light_for_texture_is_no_open_water(plain):
    sides = zip((0, 1), pair(700), strict=True)
    left, right = (view // 4 + sea(side, 1, 0) for side, view in sides)
    found = plain.detect(Frame(1, 0.0, left, right))
    assert found.mask is not None and found.mask.any() and found.note
    left, right = sea(0, 2, 0.3), sea(1, 2, 0.3)
    found = plain.detect(Frame(2, 0.1, left, right))
    assert found.mask is None and "too dim" in found.fault and not found.vetoes_clear


def test_a_damaged_pair_can_show_an_obstacle_but_is_never_clear(plain):
    whole = plain.detect(Frame(1, 0.0, *pair(700, y=100)))
    left, right = pair(700, y=100, seed=1)  # a picture repeated is a frozen camera's
    left[700:] = 128
    found = plain.detect(Frame(1, 0.0, left, right))
    assert whole.mask is not None and found.mask is not None and found.mask.any()
    assert "left: " in found.note and not whole.note
    left, right = sea(0, 2), sea(1, 2)
    left[700:] = 128
    found = plain.detect(Frame(1, 0.0, left, right))
    assert found.mask is None and "left: flat" in found.fault and found.vetoes_clear


def test_an_unfit_right_frame_is_unknown(plain):
    left, right = pair(700)
    blank = {"right: flat": Frame(1, 0.0, sea(), np.full_like(right, 90))}
    for word, frame in {**unfit_pairs(left, right), **blank}.items():
        found = plain.detect(frame)
        assert found.mask is None and word in found.fault
        # What nobody sees through the left camera texture does not see either.
        assert found.vetoes_clear == word.startswith("left: ")


AWAY = {"R": cv2.Rodrigues(np.array([0.0, 0.9, 0.0]))[0], "T_mm": np.array([[-10.0], [0], [9.0]])}


@pytest.mark.parametrize(
    ("changes", "scale", "message"),
    [
        (AWAY, 0.5, "out of view"),
        ({"D2": np.array([1e6, 0, 0, 0, 0])}, 0.5, "sees 1 % of what the left one does"),
        ({"T_mm": -PLAIN.T_mm}, 0.5, "not right of the left one"),
        ({"T_mm": 10 * PLAIN.T_mm}, 1.0, "at most 2047 can be"),
    ],
)
def test_a_calibration_with_which_hardly_anything_is_searched_is_refused(changes, scale, message):
    refuses(message, DisparityDetector, replace(PLAIN, **changes), Grid(), scale=scale)


@pytest.mark.parametrize("scale", [0.05, 0.2, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("baseline_mm", [5.0, 60.0, 300.0, 305.5])
def test_all_depths_are_searched_and_none_behind_infinity(baseline_mm, scale):
    shift = np.array([[-baseline_mm], [0.0], [0.0]])
    rectifier = Rectifier(replace(PLAIN, T_mm=shift), scale)
    smallest, count = disparity_range(rectifier)
    nearest_m = rectifier.focal_baseline_px_m / (smallest + count - 1)
    assert smallest >= 1 and nearest_m <= NEAREST_M


@pytest.fixture(scope="module")
def real(calibration_path):
    return DisparityDetector(load_calibration(calibration_path), Grid())


def matched(detector, mission, left, right, turn=False) -> Matches:
    return detector.match(*sea_trial_pair(mission, left, right, turn))


@pytest.mark.mission
def test_control_another_right_frame_leaves_no_match(mission, real):
    assert matched(real, mission, 180, 180).valid.mean() > 0.2
    for other in (50, 170, 175, 183, 186, 200):
        assert matched(real, mission, 180, other).valid.mean() <= 0.003
    assert matched(real, mission, 180, 180, turn=True).valid.mean() <= 0.003


@pytest.mark.mission
def test_the_tower_is_an_obstacle_at_its_measured_depth(mission, real):
    for number, depth_m in ((142, 9.6), (170, 5.1), (186, 1.84), (205, 4.8)):
        found = matched(real, mission, number, number)
        median = real.rectifier.focal_baseline_px_m / np.median(found.disparity_px[found.valid])
        assert median == pytest.approx(depth_m, rel=0.03)
        detection = real.detect(Frame(number, 0.0, *sea_trial_pair(mission, number, number)))
        assert verdict_from_mask(detection.mask, "disparity").status == 1
        assert 0.9 * depth_m < detection.distance_m < 1.03 * depth_m


def test_a_few_matches_are_no_status_and_no_clear(plain):
    left, right = (view.round().astype(np.uint8) for view in lit_sea(1))
    speck = np.array([[12, 0], [0, 12]], np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    left[400:416, 720:736] += speck
    right[400:416, 720 - DISPARITY_PX : 736 - DISPARITY_PX] += speck
    found = plain.detect(Frame(1, 0.0, left, right))
    assert found.mask is None and found.distance_m is None and found.vetoes_clear
    assert found.fault == "too few matches for a status, at 3.3 m"
    hold_row(
        "a few matches, too few for a status (`disparity`)", "unknown `stereo`", "frames by reason"
    )


def test_the_blind_margin_is_not_searched(plain):
    left, right = pair(700)
    searched = plain.match(left, right).searched
    # Half size, without rotation: the right view begins where the smallest disparity leads.
    assert not searched[:, :31].any() and searched[:, 33:].all()


@pytest.mark.parametrize(("matcher", "scale"), [("sgbm", 0.5), ("bm", 1.0), ("bm", 0.25)])
def test_other_matchers_and_scales_measure_the_same(matcher, scale):
    detector = DisparityDetector(PLAIN, Grid(), matcher, scale)
    found = detector.detect(Frame(1, 0.0, *pair(700)))
    assert found.distance_m == pytest.approx(DEPTH_M, rel=0.02)


@pytest.mark.parametrize("kind", [DisparityDetector, PushbroomDetector])
def test_views_made_side_by_side_are_the_same(kind):
    one, two = (kind(PLAIN, Grid(), threads=threads) for threads in (1, 2))
    flat = np.full((HEIGHT, WIDTH), 80, np.uint8)
    pairs = [pair(700), [sea(), sea(1)], [flat, sea(1)], [sea(), flat], pair(600, seed=2)]
    for number, views in enumerate(pairs):
        found, other = (each.detect(Frame(number, 0.1 * number, *views)) for each in (one, two))
        assert (found.mask is None) == (other.mask is None)
        assert found.mask is None or np.array_equal(found.mask, other.mask)
        assert np.array_equal(found.sight.causes, other.sight.causes)
        for name in ("fault", "note", "distance_m", "vetoes_clear"):
            assert getattr(found, name) == getattr(other, name), name


def test_closing_speed_needs_times_that_mean_something():
    detectors = [DisparityDetector(PLAIN, Grid()) for _ in range(2)]
    rng = np.random.default_rng(7)
    for number in range(12):
        left, right = pair(700 + 10 * number, disparity_px=200 + 4 * number)
        right += rng.integers(0, 2, right.shape, np.uint8)
        live, replayed = (
            detector.detect(Frame(number, 0.2 * number, left, right, timed=timed))
            for detector, timed in zip(detectors, (True, False), strict=True)
        )
    assert live.closing_m_s == pytest.approx((660 / 208 - 660 / 244) / 1.8, rel=0.05)
    assert live.contact_s == pytest.approx(live.distance_m / live.closing_m_s, rel=0.1)
    assert (replayed.closing_m_s, replayed.contact_s) == (None, None)


STEP_S = 0.1


def after(distances: list[float | None], step_s: float = STEP_S) -> Closing:
    """What is known after distances at a regular pace."""
    speed = ClosingSpeed()
    return [speed.add(index * step_s, distance) for index, distance in enumerate(distances)][-1]


def approach(n: int, closing_m_s: float = 0.5, from_m: float = 8.0) -> list[float]:
    return [from_m - closing_m_s * STEP_S * index for index in range(n)]


def test_an_even_approach_is_exact_at_irregular_times():
    times = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.3, 40))
    speed = ClosingSpeed()
    found = [speed.add(float(t), 9.0 - 0.4 * float(t)) for t in times][-1]
    assert found.closing_m_s == pytest.approx(0.4, abs=1e-9)
    assert found.contact_s == pytest.approx(9.0 / 0.4 - times[-1], abs=1e-6)


def test_the_stated_error_of_the_speed_holds():
    rng = np.random.default_rng(1)
    full, least = [], []
    for _ in range(100):
        speed = ClosingSpeed()
        noisy = np.array(approach(30)) + rng.normal(0, 0.03, 30)
        found = [speed.add(index * STEP_S, distance) for index, distance in enumerate(noisy)]
        speeds = [each.closing_m_s for each in found if each.closing_m_s is not None]
        full.append(speeds[-1])
        least.append(speeds[0])
    assert np.std(full) == pytest.approx(0.012, abs=0.003)
    assert np.std(least) == pytest.approx(0.03, abs=0.008)
    assert np.mean(full) == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize("closing_m_s", [-0.3, module.MIN_CLOSING_M_S * 0.9])
def test_a_retreat_or_hardly_any_motion_has_no_contact(closing_m_s):
    found = after(approach(30, closing_m_s, from_m=2.0))
    assert found.closing_m_s == pytest.approx(closing_m_s, abs=1e-9)
    assert found.contact_s is None


def test_too_few_points_or_too_short_a_time_give_no_speed():
    whole = math.ceil(module.MIN_SPAN_S / STEP_S)
    assert after(approach(whole)) == Closing()
    assert after(approach(whole + 1)).closing_m_s is not None
    assert after(approach(module.MIN_POINTS - 1), step_s=0.5) == Closing()


def test_a_missed_distance_gives_no_speed_itself_but_leaves_the_line():
    distances = approach(30)
    assert after([*distances, None]) == Closing()
    distances[20:24] = [None] * 4
    assert after(distances).closing_m_s == pytest.approx(0.5, abs=1e-9)


def test_a_long_gap_starts_anew():
    missed = math.ceil(module.GAP_S / STEP_S)
    assert after([*approach(30), *[None] * missed, 3.0]) == Closing()


def test_stray_distances_are_dropped():
    distances = approach(30)
    for stray in (8, 15, 22, 28):
        distances[stray] = 2.0
    assert after(distances).closing_m_s == pytest.approx(0.5, abs=1e-9)
    distances[29] = 2.0  # the last: not yet known to be one
    assert after(distances[:30]) == Closing()


def test_a_jump_that_stays_starts_a_new_line():
    jumped = [*approach(30), *approach(12, closing_m_s=0.2, from_m=3.0)]
    assert after(jumped[:32]) == Closing()
    assert after(jumped).closing_m_s == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize("t_s", [1.0, 2.9, math.nan, -math.inf, math.inf])
def test_time_that_does_not_go_on_starts_anew(t_s):
    speed = ClosingSpeed()
    for index, distance in enumerate(approach(30)):
        speed.add(index * STEP_S, distance)
    assert speed.add(t_s, 6.5) == Closing()
    start = t_s if math.isfinite(t_s) else 100.0
    found = [speed.add(start + 0.1 * (index + 1), 6.0 - 0.03 * index) for index in range(20)]
    assert found[5] == Closing()
    assert found[-1].closing_m_s == pytest.approx(0.3, abs=0.01)


numbers = st.floats(allow_nan=True, allow_infinity=True, width=32)


@settings(max_examples=scaled(60))
@given(st.lists(st.tuples(numbers | st.integers(0, 9), st.none() | numbers | st.floats(0, 9))))
def test_nothing_raises_and_contact_only_lies_ahead(points):
    speed = ClosingSpeed()
    for t_s, distance in points:
        found = speed.add(t_s, distance)
        if found.contact_s is not None:
            assert found.closing_m_s >= module.MIN_CLOSING_M_S
            assert 0 <= found.contact_s < math.inf
