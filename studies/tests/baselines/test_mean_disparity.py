"""Left, centre and right of the disparity map."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration, load_calibration
from tokt_studies.baselines.mean_disparity import Thirds
from tokt_studies.speed.cases import textured_frame

pytestmark = pytest.mark.xdist_group("baselines")

WIDTH, HEIGHT = 680, 512
CAMERA = np.array([[1100.0, 0, 339.5], [0, 1100.0, 255.5], [0, 0, 1]])
PLAIN = StereoCalibration(
    CAMERA,
    np.zeros(5),
    CAMERA,
    np.zeros(5),
    np.eye(3),
    np.array([[-300.0], [0.0], [0.0]]),
    (WIDTH, HEIGHT),
)
FOCAL_BASELINE_PX_M = 1100 * 0.3


def water(seed: int) -> NDArray[np.uint8]:
    fall = np.linspace(25, 45, WIDTH)[None].repeat(HEIGHT, 0)
    return (fall + np.random.default_rng(seed).normal(0, 0.5, fall.shape)).round().astype(np.uint8)


def pair_with(x: int, width: int, depth_m: float) -> Frame:
    """Water, and a textured board 200 high from column `x` of the left view."""
    left, right = water(1), water(2)
    board = textured_frame()[:200, :width, 0] // 2
    shift = round(FOCAL_BASELINE_PX_M / depth_m)
    left[150:350, x : x + width] = board
    right[150:350, x - shift : x - shift + width] = board
    return Frame(1, 0.0, left, right)


@pytest.mark.parametrize(
    ("x", "width", "depth_m", "status", "side"),
    [
        (250, 300, 3.0, 1, -1),  # centre and right: go left
        (160, 260, 3.0, 1, 1),  # left and centre: go right
        (480, 180, 3.0, 0, 0),  # at the right only: the way is free
        (250, 180, 8.0, 1, -1),  # in the centre, and far: a mean knows no distance
    ],
)
def test_the_centre_decides_and_the_emptier_side_is_the_way(x, width, depth_m, status, side):
    judged = Thirds(PLAIN).judge(pair_with(x, width, depth_m))
    assert judged.verdict.status == status
    assert np.sign(judged.verdict.x) == side
    assert judged.mask is not None and judged.mask.any()


def test_half_a_pair_and_a_wrong_one_are_never_clear():
    pair = pair_with(250, 180, 3.0)
    for right in (None, pair.right[::-1].copy()):
        unknown = Thirds(PLAIN).judge(replace(pair, right=right))
        assert unknown.verdict.status == -1
        assert unknown.mask is None
        assert unknown.verdict.health


def test_rendered_tower(dive, finds_tower):
    calibration = load_calibration(dive.folder / "calibration.yml")
    method, close = Thirds(calibration), dive.pair(15)
    assert finds_tower(lambda number: method.judge(dive.pair(number)).mask)
    assert Thirds(calibration).judge(close).verdict.status == 1
    turned = replace(close, right=close.right[::-1].copy())
    assert Thirds(calibration).judge(turned).verdict.status != 1
