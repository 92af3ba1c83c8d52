"""Whether a stereo pair can be believed."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame as Pair
from tokt.inference.reason import Reason
from tokt.inference.stereo import pair_health
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.epipolar_drift import EpipolarDriftCorrection, EpipolarOffset
from tokt.inference.stereo.matching import Matches
from tokt.inference.stereo.pair_health import MISFIT, PairFault, PairHealth, pair_fault

from .plain_rig import sea_trial

HEIGHT, WIDTH = 128, 170

View = NDArray[np.float32]


def water(level: float = 30, seed: int = 0) -> View:
    """An open-water view with a camera's noise."""
    noise = np.random.default_rng(seed).normal(0, 0.5, (HEIGHT, WIDTH))
    return np.asarray(level + noise, np.float32)


def with_texture(view: View, columns: slice) -> View:
    coarse = np.random.default_rng(9).normal(0, 10, (HEIGHT // 8, WIDTH // 8 + 1))
    texture = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    view = view.copy()
    view[:, columns] += texture[:, columns].astype(np.float32)
    return view


def matches(textured=0.0, matched=0.0, searched=True, seed=0) -> Matches:
    """Matches of a view of which one part is textured and another matched."""
    order = np.random.default_rng(seed).permutation(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
    part = order / (HEIGHT * WIDTH)
    disparity, searched = np.full(part.shape, 40, np.float32), np.full(part.shape, searched)
    return Matches(disparity, part < matched, part < textured, searched)


OPEN_WATER = matches()
SEEN = matches(textured=0.3, matched=0.2)
GOOD = EpipolarOffset(0.2, 0.3, 0.1, 0.05, 0.95)


def test_texture_where_the_right_camera_cannot_see_is_no_misfit():
    assert pair_fault(water(), water(), matches(textured=0.3, searched=False), None) is None


@pytest.mark.parametrize("rows", [slice(None), slice(HEIGHT // 2, None), slice(HEIGHT // 2)])
def test_a_covered_camera_is_named_in_open_water(rows):
    bright, covered = water(30), water(30)
    covered[rows] = water(3)[rows]
    left = pair_fault(covered, bright, OPEN_WATER, None)
    right = pair_fault(bright, covered, OPEN_WATER, None)
    assert "the left view is 8 times darker" in left.reason
    assert "the right view is 8 times darker" in right.reason
    # The texture detector looks through the left camera: its clear would be wrong, too.
    assert left.vetoes_clear and not right.vetoes_clear
    assert pair_fault(bright, covered, SEEN, None).vetoes_clear


def test_what_the_right_camera_alone_sees_is_not_clear():
    fault = pair_fault(water(), with_texture(water(), slice(60, 160)), OPEN_WATER, None)
    assert "the right view shows" in fault.reason
    assert fault.vetoes_clear
    both = with_texture(water(), slice(60, 160))
    assert pair_fault(both, both, OPEN_WATER, None) is None
    # A thing that reaches beyond the left view is no fault while enough of it matches.
    assert pair_fault(water(), both, SEEN, GOOD) is None


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_view_too_dim_for_texture_leaves_only_an_obstacle_standing(side):
    views = (water(9), water(20)) if side == "left" else (water(20), water(9))
    fault = judge(PairHealth(), *views, EpipolarDriftCorrection())
    assert f"the {side} view is too dim" in fault.reason
    assert fault.matches_stand and not fault.vetoes_clear


@pytest.mark.parametrize(
    ("offset", "told"),
    [
        (replace(GOOD, spread_px=2.0), "2.0 px"),
        (replace(GOOD, agreeing=0.3), "px"),
        (replace(GOOD, turn_deg=-1.0), "-1.0 degrees"),
    ],
)
def test_rows_that_do_not_agree(offset, told):
    fault = pair_fault(water(), water(), SEEN, offset)
    assert fault.vetoes_clear
    assert "rows" in fault.reason and told in fault.reason


def judge(health, left, right, drift) -> PairFault | None:
    return health.judge(left, right, OPEN_WATER, None, drift)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_frozen_camera_is_named(side):
    health, drift = PairHealth(), EpipolarDriftCorrection()
    for number in range(3):
        views = {"left": water(seed=number), "right": water(seed=100 + number)}
        assert judge(health, views["left"], views["right"], drift) is None
    for number in range(3, 6):
        moving = water(seed=number)
        left, right = (views[side], moving) if side == "left" else (moving, views[side])
        fault = judge(health, left, right, drift)
        assert f"the {side} camera repeats" in fault.reason
        assert fault.vetoes_clear == (side == "left")
    assert judge(health, water(seed=50), water(seed=51), drift) is None


def test_a_repeated_pair_and_a_view_without_noise_are_not_frozen():
    health, drift = PairHealth(), EpipolarDriftCorrection()
    flat = np.full_like(water(), 30)
    for left, right in ((water(seed=1), water(seed=2)),) * 6:
        assert judge(health, left, right, drift) is None
    for number in range(2):
        assert judge(health, water(seed=number), flat, drift) is None


def test_both_cameras_frozen_are_no_open_water():
    health, drift = PairHealth(), EpipolarDriftCorrection()
    faults = [judge(health, water(seed=1), water(seed=2), drift) for _ in range(8)]
    assert faults[:6] == [None] * 6
    for fault in faults[6:]:
        assert "both cameras repeat" in fault.reason and fault.vetoes_clear
    assert judge(health, water(seed=3), water(seed=4), drift) is None


@pytest.mark.parametrize(
    ("deviation_px", "variation_px", "told"),
    [
        (None, None, None),
        (0.5, 0.2, None),
        (2.5, 0.2, "2.5 px"),
        (None, 1.4, "1.4 px from pair to pair"),
    ],
)
def test_rows_that_differ_from_those_before_are_out_of_step(deviation_px, variation_px, told):
    """The last pair's do not agree, or those that are remembered."""
    drift = SimpleNamespace(deviation_px=deviation_px, variation_px=variation_px)
    fault = PairHealth().judge(water(), water(seed=1), SEEN, GOOD, drift)
    assert (fault is None) == (told is None)
    if told is not None:
        assert told in fault.reason and fault.vetoes_clear
    # Later open water shows nothing that could be at a wrong distance.
    assert PairHealth().judge(water(), water(seed=1), OPEN_WATER, None, drift) is None


Frame = NDArray[np.uint8]
LEFT = np.arange(12, dtype=np.uint8).reshape(3, 4)
RIGHT = LEFT + 100


@pytest.mark.parametrize(
    ("left", "right", "told"),
    [
        (RIGHT, LEFT, "swapped"),
        (LEFT, np.rot90(RIGHT, 2), "right camera is upside down"),
        (np.rot90(LEFT, 2), RIGHT, "left camera is upside down"),
        (LEFT, RIGHT[::-1], MISFIT),
    ],
)
def test_the_cause_of_a_misfit_is_found_with_one_matching_a_pair(left, right, told):
    matched: list[tuple[Frame, Frame]] = []

    def match(one: Frame, other: Frame) -> Matches:
        matched.append((one, other))
        true_pair = np.array_equal(one, LEFT) and np.array_equal(other, RIGHT)
        return SEEN if true_pair else matches(textured=0.3)

    health, fault = PairHealth(), PairFault(MISFIT, vetoes_clear=True)
    for pair in range(5):
        explained = health.explained(fault, left, right, match)
        assert len(matched) <= pair + 1
    assert told in explained.reason and explained.vetoes_clear
    assert len(matched) <= len(pair_health.CAUSES)


def test_a_pair_that_fits_forgets_the_cause_and_other_faults_are_left_as_they_are():
    health, misfit = PairHealth(), PairFault(MISFIT, vetoes_clear=True)
    assert "swapped" in health.explained(misfit, LEFT, RIGHT, lambda *_: SEEN).reason
    assert health.judge(water(), water(seed=1), SEEN, GOOD, EpipolarDriftCorrection()) is None
    hopeless = matches(textured=0.3)
    assert health.explained(misfit, LEFT, RIGHT, lambda *_: hopeless) == misfit
    other = PairFault("the right camera repeats its last picture: frozen", vetoes_clear=False)
    assert health.explained(other, LEFT, RIGHT, lambda *_: SEEN) == other


@pytest.fixture(scope="module")
def told(mission, calibration_path):
    """Why pairs (left number, right number) of the sea trial are not believed, or empty.

    A negative number is the other camera's frame.
    """
    calibration = load_calibration(calibration_path)

    def frame(side: str, number: int) -> Frame:
        side = side if number > 0 else {"Left": "Right", "Right": "Left"}[side]
        return sea_trial(mission, side, abs(number))

    def run(pairs: list[tuple[int, int]]) -> list[str]:
        detector = DisparityDetector(calibration, Grid())
        frames = (Pair(1, 0.0, frame("Left", one), frame("Right", two)) for one, two in pairs)
        faults = [detector.detect(pair).fault for pair in frames]
        return ["" if fault.reason is Reason.FRAME_RULE else str(fault) for fault in faults]

    return run


@pytest.mark.mission
def test_pairs_of_the_sea_trial(told):
    numbers = [*range(1, 100, 28), *range(145, 190, 8), *range(190, 246, 16)]
    assert not any(told([(number, number) for number in numbers]))
    assert told([(180, 50)]) == [MISFIT]
    assert told([(-180, -180)]) == ["the left and right cameras are swapped"]
    assert "the right view shows" in told([(50, 180)])[0]
    assert "the right camera repeats" in told([(60, 60), (61, 60)])[1]
    one_late = told([(number, number - 1) for number in range(160, 176)])
    assert sum(map(bool, one_late)) >= 12
