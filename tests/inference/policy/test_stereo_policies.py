"""Policies on the sea trial's own frames: each loss of a part, and what is said then."""

from functools import cache

import numpy as np
import pytest

from tests.inference.attacks import ATTACKS, attacked
from tests.inference.conftest import NoiseScorer
from tokt.features.frames.image_file import read_image
from tokt.features.frames.mission import LEFT, RIGHT, open_mission
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import StereoSetup, assemble
from tokt.inference.policy.policy import Policy
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN
from tokt.models.bundle.bundle import read_bundle

pytestmark = pytest.mark.mission
TOWER, WATER = 180, 30


@pytest.fixture(scope="module")
def stereo(calibration_path):
    return StereoSetup(load_calibration(calibration_path))


@pytest.fixture(scope="module")
def pair(mission):
    opened = open_mission(mission)

    @cache
    def read(number: int) -> Frame:
        return Frame(number, 0.0, opened.read(number, LEFT), opened.read(number, RIGHT))

    return read


class Sees(NoiseScorer):
    """Texture where the tower is, by brightness: a scorer for frames of the mission's size."""

    def __init__(self) -> None:
        super().__init__("bright/1", frame_sizes=((1024, 1360),))

    def values_of(self, features: np.ndarray) -> np.ndarray:
        return features - 15.0


@pytest.fixture
def policy(stereo):
    def build(name: str) -> Policy:
        load = None if name == "disparity" else Sees
        return assemble(name, load, None if name == "texture" else stereo).policy

    return build


POLICIES = ("texture", "disparity", "either", "fallback")


@pytest.mark.parametrize("name", POLICIES)
def test_the_tower_is_an_obstacle_and_the_water_clear(name, policy, pair):
    judge = policy(name)
    assert judge.judge(pair(WATER)).verdict.status == CLEAR
    verdict = judge.judge(pair(TOWER)).verdict
    assert verdict.status == OBSTACLE and verdict.health == "ok"
    measured = name in ("disparity", "either")
    assert (verdict.distance_m is not None) == measured
    if measured:
        assert verdict.distance_m == pytest.approx(2.8, abs=0.1)


@pytest.mark.parametrize(
    ("name", "tower", "method"),
    [
        ("texture", OBSTACLE, "texture"),
        ("disparity", UNKNOWN, "none"),
        ("either", OBSTACLE, "texture"),
        ("fallback", OBSTACLE, "texture"),
    ],
)
def test_without_the_right_camera(name, tower, method, policy, pair):
    gone = Fault(Reason.CAMERA_LOST, "the right camera is gone")
    frame = Frame(TOWER, 0.0, pair(TOWER).left, None, NO_FAULT, gone)
    verdict = policy(name).judge(frame).verdict
    assert (verdict.status, verdict.method) == (tower, method)
    if name in ("disparity", "either"):
        assert "the right camera is gone" in verdict.health


@pytest.mark.parametrize("name", POLICIES)
@pytest.mark.parametrize("number", [TOWER, WATER])
def test_a_dark_left_camera_is_unknown_whatever_the_policy(name, number, policy, pair):
    seen = pair(number)
    frame = Frame(number, 0.0, seen.left // 32, seen.right)
    verdict = policy(name).judge(frame).verdict
    assert verdict.status == UNKNOWN and "dark" in verdict.health


def test_a_killed_model_file_leaves_disparity(bundle_file, tmp_path, stereo, pair):
    killed = tmp_path / "killed.tokt"
    killed.write_bytes(bundle_file.read_bytes()[:-200])
    judge = assemble("fallback", lambda: read_bundle(killed), stereo).policy
    verdict = judge.judge(pair(TOWER)).verdict
    assert (verdict.status, verdict.method) == (OBSTACLE, "disparity")
    assert verdict.distance_m == pytest.approx(2.8, abs=0.1)
    assert verdict.health.startswith("texture: no model: ") and "killed.tokt" in verdict.health
    # The frame rule of what is faint first has to have seen that nothing stays.
    water = [judge.judge(pair(number)).verdict.status for number in range(WATER - 5, WATER + 1)]
    assert water[-1] == CLEAR


@pytest.mark.parametrize("name", ["disparity", "either"])
@pytest.mark.parametrize(
    "change", ["turned 180", "turned 90", "mirrored", "zoom", "the right camera's"]
)
@pytest.mark.parametrize("number", [TOWER, WATER])
def test_a_left_view_that_is_not_what_it_should_be_is_never_clear(
    change, name, number, policy, pair
):
    seen = pair(number)
    left = attacked(change, seen.left) if change in ATTACKS else seen.right
    verdict = policy(name).judge(Frame(number, 0.0, left, seen.right)).verdict
    if name == "disparity":
        assert verdict.status == UNKNOWN
    assert verdict.status != CLEAR


def test_a_right_frame_of_another_moment_is_unknown_to_stereo_alone(policy, pair, mission):
    other = read_image(mission / "Right" / f"tokt1_R_{TOWER - 10}.jpg")
    frame = Frame(TOWER, 0.0, pair(TOWER).left, other)
    assert policy("disparity").judge(frame).verdict.status == UNKNOWN
    assert policy("either").judge(frame).verdict.status == OBSTACLE
