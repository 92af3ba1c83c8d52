"""The adjustment's geometry on simulated points: what is put in must come out."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.calls import refuses
from tokt.training.rig.calibrate.adjustment import LOSS_PX, Path, Problem
from tokt.training.rig.calibrate.matching import FrameMatches, Tracks, _one_geometry, build_tracks
from tokt.training.rig.calibrate.parameter_uncertainty import (
    FIXED,
    NOT_FIXED,
    parameter_uncertainty,
)
from tokt.training.rig.calibrate.rig_fit import PRIORS, fit_rig, triangulate
from tokt.training.rig.calibrate.rig_model import DISTORTION, FOCAL, POSE, PRINCIPAL, Rig
from tokt.training.rig.calibrate.vertical_error import (
    GOOD,
    SHIFTED,
    UNUSABLE,
    check_calibration,
    raw_error,
    vertical_error,
)

SIZE = (680, 512)
FRAMES, POINTS = 12, 160
NOISE_PX, WRONG = 0.3, 0.10
TRUE = {
    **{"rotation_x": 0.03, "rotation_y": -0.02, "rotation_z": 0.015},
    **{"direction_y": 0.025, "direction_z": 0.01},
    **{"focal_ratio": 1.004, "k1": 0.25, "k2": 0.3},
}


@dataclass(frozen=True)
class Dive:
    """A simulated approach to a cloud of points."""

    rig: Rig
    matches: list[FrameMatches]
    depths_m: list[np.ndarray]

    @property
    def plain(self):
        """What a calibration starts from."""
        return Rig.plain(1111.0, 305.5, SIZE)


def draw_dive(**other):
    """Twelve frames; positions off by 0.3 px, one match in ten in a wrong place on the right."""
    rng = np.random.default_rng(5)
    values = TRUE | other
    rig = Rig.plain(1111.0, 305.5, SIZE).moved(list(values), np.array(list(values.values())))
    cloud = rng.uniform([-1.2, -1.0, 6.0], [1.2, 1.0, 7.2], (POINTS, 3))
    looks = np.abs(rng.normal(size=(2, POINTS, 128))).astype(np.float32)
    looks *= 512 / np.linalg.norm(looks, axis=2, keepdims=True)
    matches, depths = [], []
    for number in range(FRAMES):
        turn = np.array([0.02, 0.05, 0.03]) * np.sin(number * np.array([0.9, 0.5, 0.7]))
        shift = np.array([0.2 * np.sin(number), 0.1 * np.cos(number), -0.4 * number])
        seen = cloud @ cv2.Rodrigues(turn)[0].T + shift
        pixels = rig.project(seen)
        inside = (pixels > 0).all(axis=1) & (pixels < np.array([*SIZE, *SIZE])).all(axis=1)
        pixels = pixels[inside] + rng.normal(0, NOISE_PX, (inside.sum(), 4))
        wrong = rng.random(len(pixels)) < WRONG
        pixels[wrong, 2:] += rng.uniform(-40, 40, (wrong.sum(), 2))
        look = looks[:, inside]
        matches.append(FrameMatches(number, pixels[:, :2], pixels[:, 2:], look[0], look[1]))
        depths.append(seen[inside, 2])
    return Dive(rig, matches, depths)


@pytest.fixture(scope="module")
def dive():
    return draw_dive()


@pytest.fixture(scope="module")
def fit(dive):
    """The rig fitted to the even frames."""
    return fit_rig(dive.matches[::2], dive.plain, DISTORTION)


@pytest.fixture(scope="module")
def sure(fit, dive):
    return parameter_uncertainty(fit, dive.matches[1::2])


def test_recovers_the_rig(fit):
    bounds = dict.fromkeys(POSE[:3], 5e-4) | {"direction_y": 2e-3, "direction_z": 1e-2}
    bounds |= {"focal_ratio": 1.5e-3, "k1": 0.05, "k2": 0.3}
    off = {name: abs(fit.rig.values[name] - value) for name, value in TRUE.items()}
    assert {name: error for name, error in off.items() if error > bounds[name]} == {}


def test_scipys_least_squares_finds_nothing_better(fit):
    """The same loss, as a sum of squares: each observation's residuals scaled by their length."""
    problem = fit.problem(fit.names, PRIORS)
    n = len(problem.tracks.frame)

    def scaled(vector):
        residuals = problem.residuals(vector)
        length = np.maximum(problem.lengths(residuals), 1e-9)
        factor = LOSS_PX * np.sqrt(np.log1p(np.square(length / LOSS_PX))) / length
        return residuals * np.append(np.repeat(factor, 4), np.ones(len(residuals) - 4 * n))

    end = problem.pack(fit.path)
    assert np.square(scaled(end)).sum() / 2 == pytest.approx(problem.cost(problem.residuals(end)))
    pattern = problem.jacobian(end) != 0
    better = least_squares(scaled, end, jac_sparsity=pattern, x_scale="jac", max_nfev=8)
    assert better.cost > 0.999 * problem.cost(problem.residuals(end))


def test_the_zero_of_disparity_is_found(fit, dive):
    """Depth errs by less than 1 % from 7 m to 2 m: a wrong yaw would bend it over the approach."""
    tracks = build_tracks(dive.matches)
    found = triangulate(fit.rig, tracks)[:, 2]
    for index, depths in enumerate(dive.depths_m):
        ratio = np.median(found[tracks.frame == index] / depths)
        assert ratio == pytest.approx(1, abs=0.01), f"at {np.median(depths):.1f} m"


def test_a_large_yaw_is_found():
    """Three degrees are 60 px of disparity; found even where the lens is taken for straight."""
    found = fit_rig(draw_dive(rotation_y=-0.05).matches[::2], Rig.plain(1111.0, 305.5, SIZE), ())
    assert found.rig.values["rotation_y"] == pytest.approx(-0.05, abs=2e-3)


def test_wrong_matches_are_dropped(fit):
    observed = len(fit.tracks.point) + fit.dropped
    assert 0.05 < fit.dropped / observed < 0.25


def test_says_what_the_data_cannot_fix(sure):
    verdicts = {one.name: one for one in sure.parameters}
    assert verdicts["baseline"].verdict == NOT_FIXED and verdicts["baseline"].held
    assert verdicts["focal"].held and verdicts["focal"].verdict != FIXED
    assert verdicts["rotation_y"].verdict == FIXED
    shorter = sure.focal[1]
    assert shorter.depth_scale == pytest.approx(0.95, abs=0.02)
    assert shorter.vertical_median_px < sure.focal[0].vertical_median_px + 0.1


def test_sigma_is_the_size_of_the_error(sure):
    for one in sure.parameters:
        if one.name in TRUE and one.sigma is not None:
            assert abs(one.value - TRUE[one.name]) < 5 * one.sigma, one.name


def test_jacobian_against_finite_differences(dive):
    names = (*POSE, *DISTORTION, *FOCAL, *PRINCIPAL)
    rng = np.random.default_rng(0)
    frame, point = np.repeat([0, 1, 2], 3), np.tile([0, 1, 2], 3)
    points = rng.uniform([-0.5, -0.5, 2], [0.5, 0.5, 3], (3, 3))
    path = Path(rng.normal(0, 0.1, (3, 3)), rng.normal(0, 0.1, (3, 3)), points, 1)
    path.rotation_vectors[1] = path.shifts_m[1] = 0
    pixels = rng.uniform(100, 400, (9, 4))
    tracks = Tracks([1, 2, 3], frame, point, pixels[:, :2], pixels[:, 2:])
    bent = np.array([0.2, 0.1, 0.01, -0.02, 0.3])
    rig = replace(dive.rig, aspect=(1.01, 0.98), left_distortion=bent)
    problem = Problem(rig, tracks, 1, names, {"k1": 0.5, "focal": 100.0})
    vector = problem.pack(path)
    analytic = problem.jacobian(vector).toarray()
    for i in range(problem.size):
        step = np.zeros(problem.size)
        step[i] = 1e-6 * max(1.0, abs(vector[i]))
        change = problem.residuals(vector + step) - problem.residuals(vector - step)
        column, numeric = analytic[:, i], change / (2 * step[i])
        atol = 2e-4 * np.abs(column).max()
        np.testing.assert_allclose(column, numeric, rtol=1e-5, atol=atol)


def test_vertical_error_is_zero_through_the_true_cameras(dive):
    rng = np.random.default_rng(1)
    pixels = dive.rig.project(rng.uniform([-0.5, -0.4, 2], [0.5, 0.4, 6], (50, 3)))
    none = np.zeros((50, 128), np.float32)
    exact = [FrameMatches(1, pixels[:, :2], pixels[:, 2:], none, none)]
    error = vertical_error(dive.rig.calibration(), exact)
    assert np.abs(error.row_px).max() < 0.01
    assert raw_error(exact, SIZE).median_px > 10
    regions = error.by_region()
    assert sum(cell["matches"] for row in regions for cell in row if cell) == 50


def of_points(frame, kept):
    """A frame's matches of some points only, or with some twice."""
    places = {"left": frame.left[kept], "right": frame.right[kept]}
    looks = {"left_look": frame.left_look[kept], "right_look": frame.right_look[kept]}
    return replace(frame, **places, **looks)


def _moved(matches, rows, swapped=False):
    """Matches with the right view higher by `rows`, or with the cameras exchanged."""
    down = np.array([0, -rows])
    if swapped:
        return [replace(one, left=one.right, right=one.left) for one in matches]
    return [replace(one, right=one.right + down) for one in matches]


def test_judges_good_shifted_unusable(dive):
    calibration = dive.rig.calibration()
    good = [  # nine in ten are right: without the others, p90 is of these
        of_points(one, np.abs(vertical_error(calibration, [one]).row_px) < 3)
        for one in dive.matches
    ]
    assert check_calibration(calibration, good).state == GOOD
    shifted = check_calibration(calibration, _moved(good, 2.5))
    assert shifted.state == SHIFTED
    assert shifted.trim_px == pytest.approx(2.5, abs=0.1)  # the right view is to go down again
    assert shifted.after_trim.median_px < 1
    assert check_calibration(calibration, _moved(good, 9.0)).state == UNUSABLE
    exchanged = check_calibration(calibration, _moved(good, 0, swapped=True))
    assert exchanged.state == UNUSABLE
    level = Rig.plain(1111.0, 305.5, SIZE).calibration()
    assert check_calibration(level, good).state == UNUSABLE


def test_points_that_cannot_be_followed_are_one_line(dive):
    rng = np.random.default_rng(2)
    strangers = []
    for one in dive.matches[:4]:
        left, right = rng.random((2, *one.left_look.shape), np.float32)
        strangers.append(replace(one, left_look=left, right_look=right))
    refuses("can be followed over", fit_rig, strangers, dive.plain)


def test_matches_without_one_geometry_are_none():
    """OpenCV ends in an assertion on these: eight of forty matches start at one place."""
    rng = np.random.default_rng(0)
    left = rng.uniform(0, 1000, (40, 2))
    right = np.add(left, (20, 0))
    left[:8], right[:8] = 3.0, rng.uniform(0, 1000, (8, 2))
    assert len(fit := _one_geometry(left, right)) == 40 and not fit.any()


def test_a_track_that_returns_to_a_frame_falls_apart(dive):
    one, two = dive.matches[0], dive.matches[1]
    twins = of_points(one, [*range(len(one.left)), 0])
    twins.left_look[-1] *= 0.98
    twins.right_look[-1] *= 0.98
    tracks = build_tracks([twins, two])
    pairs = np.stack([tracks.point, tracks.frame], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs)
