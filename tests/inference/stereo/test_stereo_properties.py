"""Whatever pair comes in: a verdict, never an exception; and geometry held against cv2's own."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import EitherPolicy, FallbackPolicy, SinglePolicy
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.stereo.rectify import Rectifier, rectified
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Detection, Detector

GRID = Grid()
SIZES = ((161, 121), (160, 119), (163, 124))
DEPTH_M, BASELINE_MM = 3.0, 305.0
DETECTORS: dict[str, Callable[..., Detector]] = {
    "bm": DisparityDetector,
    "sgbm": partial(DisparityDetector, matcher="sgbm"),
    "pushbroom": PushbroomDetector,
}

Picture = np.ndarray[Any, np.dtype[Any]]


def calibration(size: tuple[int, int]) -> StereoCalibration:
    """Two parallel cameras that see a thing 3 m away with a disparity of 26 px."""
    focal = 26 * DEPTH_M * 1000 / BASELINE_MM
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    shift = np.array([[-BASELINE_MM], [0.0], [0.0]])
    return StereoCalibration(K, np.zeros(5), K, np.zeros(5), np.eye(3), shift, size)


@cache
def pair(size: tuple[int, int], noise: int = 0) -> tuple[Picture, Picture]:
    """Even, uneven and noisy water with a textured square 26 px further left in the right view."""
    coarse = np.random.default_rng(2).uniform(20, 140, (24, 24))
    texture = cv2.resize(coarse, (72, 72), interpolation=cv2.INTER_CUBIC)
    rng = np.random.default_rng(noise)
    width, height = size
    layers = [rng.normal(0, sd, (2, height, width)) for sd in (1.0, 6.0)]
    views = [
        30 + cv2.GaussianBlur(fine, (0, 0), 0.9) + cv2.GaussianBlur(uneven, (0, 0), 3)
        for fine, uneven in zip(*layers, strict=True)
    ]
    for view, left in zip(views, (60, 34), strict=True):
        view[24:96, left : left + 72] = texture
    return tuple(view.clip(0, 255).astype(np.uint8) for view in views)


def detector(kind: str, size: tuple[int, int]) -> Detector:
    return DETECTORS[kind](calibration(size), GRID)


def spread(picture: Picture) -> Picture:
    """The same picture as a part of a larger one: neither rows nor columns are contiguous."""
    large = np.zeros((picture.shape[0] * 2, picture.shape[1] * 3), np.uint8)
    large[::2, ::3] = picture
    return large[::2, ::3]


def read_only(picture: Picture) -> Picture:
    copy = picture.copy()
    copy.flags.writeable = False
    return copy


def colour(picture: Picture) -> Picture:
    return np.repeat(picture[..., None], 3, axis=2)


ALIKE: dict[str, Callable[[Picture], Picture]] = {
    "gray": lambda picture: picture,
    "colour": colour,
    "colour, reversed channels": lambda picture: colour(picture)[..., ::-1],
    "columns first": np.asfortranarray,
    "spread": spread,
    "read only": read_only,
    "turned twice": lambda picture: np.ascontiguousarray(picture[::-1, ::-1])[::-1, ::-1],
}
UNFIT: dict[str, Callable[[Picture], Picture | None]] = {
    "none": lambda picture: None,
    "float": lambda picture: picture.astype(np.float64),
    "16 bit": lambda picture: picture.astype(np.uint16) * 257,
    "bool": lambda picture: picture > 60,
    "one channel": lambda picture: picture[..., None],
    "four channels": lambda picture: np.repeat(picture[..., None], 4, axis=2),
    "empty": lambda picture: picture[:0],
    "one row": lambda picture: picture[0],
    "half": lambda picture: picture[::2, ::2].copy(),
    "a row less": lambda picture: picture[:-1],
    "black": np.zeros_like,
    "white": lambda picture: np.full_like(picture, 255),
    "blank": lambda picture: np.full_like(picture, 77),
}
LEVEL = {"black", "white", "blank"}
"""In which nothing is seen: no other detector's clear stands against that of the left camera."""
alike, unfit = st.sampled_from(sorted(ALIKE)), st.sampled_from(sorted(UNFIT))


@pytest.mark.parametrize("kind", DETECTORS)
@given(st.sampled_from(SIZES), alike, alike)
@settings(max_examples=scaled(12))
def test_a_pair_is_judged_however_it_lies_in_memory(kind, size, left, right):
    first, second = pair(size)
    plain = detector(kind, size).detect(Frame(1, 0.0, first, second))
    found = detector(kind, size).detect(Frame(1, 0.0, ALIKE[left](first), ALIKE[right](second)))
    assert found.mask.shape == GRID.resized(size[1], size[0]) and found.mask.dtype == np.uint8
    assert set(np.unique(found.mask)) == {0, 255} and np.array_equal(found.mask, plain.mask)
    assert found.distance_m == plain.distance_m == pytest.approx(DEPTH_M, rel=0.05)


class Texture:
    """A texture detector that says clear, or cannot judge."""

    method = "texture"

    def __init__(self, size: tuple[int, int], judges: bool) -> None:
        mask = np.zeros(GRID.resized(size[1], size[0]), np.uint8) if judges else None
        fault = NO_FAULT if judges else Fault(Reason.STEREO, "no")
        self._answer = Detection(mask, "texture", fault=fault)

    def detect(self, frame: Frame) -> Detection:
        return self._answer


@pytest.mark.parametrize("kind", DETECTORS)
@given(st.sampled_from(SIZES), st.tuples(alike | unfit, alike | unfit), st.booleans())
@settings(max_examples=scaled(30))
def test_any_pair_has_a_verdict_and_an_unfit_one_is_unknown(kind, size, names, judges):
    ways = [(ALIKE | UNFIT)[name] for name in names]
    pictures = [way(picture) for way, picture in zip(ways, pair(size), strict=True)]
    frame = Frame(1, 0.0, *pictures)
    texture = Texture(size, judges)
    left_is_unseen = names[0] in LEVEL and not set(names) & (set(UNFIT) - LEVEL)
    for policy in (
        SinglePolicy(detector(kind, size)),
        FallbackPolicy(texture, detector(kind, size)),
        EitherPolicy(texture, detector(kind, size)),
    ):
        verdict = policy.judge(frame).verdict
        assert "failed" not in verdict.health, verdict.health  # nothing raised
        if isinstance(policy, FallbackPolicy) and judges:
            assert verdict.status == CLEAR
        elif not set(names) & set(UNFIT):
            assert verdict.status == OBSTACLE and verdict.distance_m is not None
        elif isinstance(policy, EitherPolicy) and judges and not left_is_unseen:
            assert verdict.status == CLEAR and verdict.health != "ok"
        else:
            assert verdict.status == UNKNOWN and verdict.distance_m is None


@pytest.mark.parametrize("kind", DETECTORS)
@given(st.lists(st.tuples(alike, unfit, st.booleans()), max_size=8))
@settings(max_examples=scaled(8))
def test_a_good_pair_is_an_obstacle_whatever_came_before_it(kind, before):
    judge = SinglePolicy(detector(kind, SIZES[0])).judge
    for number, (fit, unfit, right_is_unfit) in enumerate(before):
        left, right = pair(SIZES[0], number)
        ways = (ALIKE[fit], UNFIT[unfit]) if right_is_unfit else (UNFIT[unfit], ALIKE[fit])
        frame = Frame(number, 0.1 * number, ways[0](left), ways[1](right))
        verdict = judge(frame).verdict
        assert verdict.status == UNKNOWN and "failed" not in verdict.health, verdict.health
    verdict = judge(Frame(len(before), 1.0, *pair(SIZES[0], len(before)))).verdict
    assert verdict.status == OBSTACLE, verdict.health


part = st.floats(-1, 1)


@st.composite
def rigs(draw: st.DrawFn) -> StereoCalibration:
    """Two cameras with distortion, turned by up to 3 degrees, of any (odd) frame size."""
    width, height = draw(st.integers(101, 199)), draw(st.integers(81, 159))

    def camera() -> np.ndarray:
        focal = width * (1.6 + 0.2 * draw(part))
        x, y = width * (0.5 + 0.03 * draw(part)), height * (0.5 + 0.03 * draw(part))
        return np.array([[focal, 0, x], [0, focal * (1 + 0.01 * draw(part)), y], [0, 0, 1]])

    def lens() -> np.ndarray:
        scales = (0.3, 0.3, 0.005, 0.005, 0.1)
        return np.array([scale * draw(part) for scale in scales])

    R = np.asarray(cv2.Rodrigues(np.array([0.05 * draw(part) for _ in range(3)]))[0])
    shift = np.array([[-300 + 50 * draw(part)], [15 * draw(part)], [15 * draw(part)]])
    return StereoCalibration(camera(), lens(), camera(), lens(), R, shift, (width, height))


def frames_of(points_m: Picture, rig: StereoCalibration) -> tuple[Picture, Picture]:
    """Where cv2 sees points of the left camera's axes, in the left and in the right frame."""
    none = np.zeros(3)
    turn = cv2.Rodrigues(rig.R)[0]
    left, _ = cv2.projectPoints(points_m, none, none, rig.K1, rig.D1)
    right, _ = cv2.projectPoints(points_m, turn, rig.T_mm / 1000, rig.K2, rig.D2)
    return left.reshape(-1, 2), right.reshape(-1, 2)


scales = st.sampled_from([0.5, 1.0, 0.27])
few = settings(max_examples=scaled(20))


def in_right_view(points: np.ndarray, rectifier: Rectifier) -> np.ndarray:
    rig, R, P = rectifier.calibration, rectifier.rotations[1], rectifier.projections[1]
    return rectified(points, rig.K2, rig.D2, R, P)


@given(rigs(), scales, st.integers(0, 1000))
@few
def test_both_views_see_a_point_in_one_row_with_the_disparity_of_its_depth(rig, scale, seed):
    rectifier = Rectifier(rig, scale)
    rng = np.random.default_rng(seed)
    rays = rng.uniform(-0.2, 0.2, (30, 2))
    points = np.column_stack([rays, np.ones(30)]) * rng.uniform(1.5, 8, (30, 1))
    left, right = frames_of(points, rig)
    left_view, right_view = rectifier.from_frame(left), in_right_view(right, rectifier)
    assert np.abs(left_view[:, 1] - right_view[:, 1]).max() < 1e-3
    depth = (points @ rectifier.rotations[0].T)[:, 2]
    disparity = left_view[:, 0] - right_view[:, 0]
    assert disparity == pytest.approx(rectifier.focal_baseline_px_m / depth, rel=1e-6)
    assert rectifier.to_frame(left_view) == pytest.approx(left, abs=1e-5)
    assert rectifier.focal_baseline_px_m / rectifier.focal_px == pytest.approx(
        np.linalg.norm(rig.T_mm) / 1000
    )


@given(rigs(), scales, st.integers(0, 1000))
@few
def test_points_in_metres_are_where_both_cameras_see_them(rig, scale, seed):
    rectifier = Rectifier(rig, scale)
    rng = np.random.default_rng(seed)
    width, height = rectifier.size
    disparity = (rectifier.focal_baseline_px_m / rng.uniform(1.5, 8, (height, width))).astype("f4")
    inside = np.zeros((height, width), bool)
    inside[height // 4 : -height // 4, width // 4 : -width // 4] = True
    valid = inside & (rng.uniform(size=inside.shape) < 0.05)
    points = rectifier.points_m(disparity, valid)
    rows, columns = np.nonzero(valid)
    left, right = frames_of(points, rig) if len(points) else (np.empty((0, 2)),) * 2
    assert points.shape == (valid.sum(), 3)
    places = np.column_stack([columns, rows]).astype(np.float64)
    assert rectifier.to_frame(places) == pytest.approx(left, abs=1e-5)
    assert rectifier.from_frame(left) == pytest.approx(places, abs=1e-4)
    shifted = places - np.column_stack([disparity[valid], np.zeros(len(rows))])
    assert in_right_view(right, rectifier) == pytest.approx(shifted, abs=1e-4)


@given(rigs(), st.sampled_from([0.5, 1.0]), st.floats(-4, 4))
@few
def test_the_views_show_what_the_points_say(rig, scale, shift_px):
    rectifier = Rectifier(rig, scale)
    width, height = rig.frame_size
    across = np.arange(width, dtype=np.uint8)[None].repeat(height, axis=0)
    down = np.ascontiguousarray(np.arange(height, dtype=np.uint8)[:, None].repeat(width, axis=1))
    rows, columns = np.indices(rectifier.size[::-1])
    places = rectifier.to_frame(np.column_stack([columns.ravel(), rows.ravel()]))
    views = np.stack([rectifier.left(picture).ravel() for picture in (across, down)], axis=1)
    within = ((places > 4) & (places < np.array([width, height]) - 5)).all(axis=1)
    assert within.any() and np.abs(views - places)[within].max() < 0.1
    # A right view that stands too high by the shift is moved down by it: it shows what was above.
    moved = rectifier.right(down) - rectifier.right(down, shift_px)
    centre = moved[rectifier.size[1] // 2, rectifier.size[0] // 2]
    assert centre == pytest.approx(shift_px, abs=0.1 + 0.1 * abs(shift_px))


@given(rigs(), st.sampled_from([(90, 120), (61, 77)]))
@few
def test_a_mask_of_the_view_is_moved_to_the_left_frame(rig, shape):
    rectifier = Rectifier(rig)
    width, height = rectifier.size
    view = np.arange(1, width + 1, dtype=np.uint8)[None].repeat(height, axis=0)
    found = rectifier.to_left(view, *shape)
    rows, columns = np.indices(shape)
    frame = (np.stack([columns, rows], axis=-1) + 0.5) * np.array(rig.frame_size)
    frame = frame / np.array(shape[::-1]) - 0.5
    places = rectifier.from_frame(frame.reshape(-1, 2)).reshape(*shape, 2)
    within = ((places > 1) & (places < np.array([width, height]) - 2)).all(axis=-1)
    beyond = ((places < -1) | (places > np.array([width, height]))).any(axis=-1)
    assert within.any() and np.abs(found - 1.0 - places[..., 0])[within].max() <= 0.55
    assert not found[beyond].any()
