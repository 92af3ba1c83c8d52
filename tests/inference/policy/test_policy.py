from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.calls import refuses
from tests.inference.conftest import NoiseScorer
from tests.inference.logged_runs import Seconds
from tests.inference.stereo.plain_rig import PLAIN as CALIBRATION
from tests.inference.test_faults import hold_row
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import StereoSetup, assemble
from tokt.inference.policy.policy import EitherPolicy, FallbackPolicy, SinglePolicy, judge_image
from tokt.inference.reason import Fault, Reason
from tokt.inference.sight import SightMeter
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import Detection, Verdict

NO_PICTURE = Fault(Reason.MISSING, "no picture")
FRAME = Frame(1, 0.0, None, None, NO_PICTURE, NO_PICTURE)
STEREO = StereoSetup(CALIBRATION)


def mask(*columns: int) -> np.ndarray:
    painted = np.zeros((50, 100), np.uint8)
    painted[10:20, list(columns)] = 255
    return painted


class Says:
    """A detector with a fixed answer: a mask, a fault, which may be a danger, or an exception."""

    def __init__(self, method: str, answer: Any, vetoes_clear: bool = False) -> None:
        self.method = method
        self.answer = answer
        self.vetoes_clear = vetoes_clear

    def detect(self, frame: Frame) -> Detection:
        if isinstance(self.answer, Exception):
            raise self.answer
        if isinstance(self.answer, str):
            fault = Fault(Reason.STEREO, self.answer)
            return Detection(None, self.method, fault=fault, vetoes_clear=self.vetoes_clear)
        model = "m/1" if self.method == "texture" else None
        distance_m = 2.5 if self.method == "disparity" else None
        return Detection(self.answer, self.method, model, distance_m)


ANSWERS = {
    "obstacle": mask(3, 4, 5),
    "clear": mask(),
    "unknown": "cannot judge",
    "raises": ZeroDivisionError("division\nby zero"),
}
STATUS = {"obstacle": 1, "clear": 0, "unknown": -1, "raises": -1}


@pytest.mark.parametrize("texture", ANSWERS)
@pytest.mark.parametrize("disparity", ANSWERS)
def test_unknown_never_becomes_clear(texture, disparity):
    first, second = Says("texture", ANSWERS[texture]), Says("disparity", ANSWERS[disparity])
    known = [STATUS[answer] for answer in (texture, disparity) if STATUS[answer] >= 0]

    either = EitherPolicy(first, second).judge(FRAME).verdict
    assert either.status == (max(known) if known else -1)
    assert (either.health == "ok") == (len(known) == 2 and len(set(known)) == 1)

    fallback = FallbackPolicy(first, second).judge(FRAME).verdict
    assert fallback.status == (known[0] if known else -1)
    assert (fallback.health == "ok") == (STATUS[texture] >= 0)

    alone = SinglePolicy(first).judge(FRAME).verdict
    assert alone.status == STATUS[texture]


def test_a_picture_in_memory_is_judged_like_a_frame(noise_scorer, draw_frame):
    image = draw_frame([(2, 3)])
    judged = judge_image(noise_scorer, image)
    expected = SinglePolicy(TextureDetector(noise_scorer)).judge(Frame(9, 8.0, image, None))
    assert judged.verdict == expected.verdict and judged.verdict.status == 1
    np.testing.assert_array_equal(judged.decision_values, noise_scorer.decision_values(image))
    assert judge_image(noise_scorer, np.zeros_like(image)).verdict.status == -1
    noise_scorer.features = None
    assert "TypeError" in judge_image(noise_scorer, image).verdict.health


def test_what_a_detector_raises_is_told_in_one_line():
    verdict = SinglePolicy(Says("texture", ANSWERS["raises"])).judge(FRAME).verdict
    assert verdict.health == "the texture detector failed: ZeroDivisionError: division by zero"
    assert verdict.method == "none" and verdict.model is None


def test_what_one_of_two_detectors_sees_alone_is_said():
    def health(texture: Any, disparity: Any) -> str:
        detectors = Says("texture", texture), Says("disparity", disparity)
        return EitherPolicy(*detectors).judge(FRAME).verdict.health

    assert health(mask(3), mask()) == (
        "texture that disparity does not see: far off, flat, or on the port"
    )
    assert health(mask(), mask(3)) == "disparity sees what the model takes for water"
    assert health(mask(3), mask(80)) == health(mask(), mask()) == "ok"


def test_either_joins_the_masks():
    policy = EitherPolicy(Says("texture", mask(3, 4)), Says("disparity", mask(80)))
    verdict = policy.judge(FRAME).verdict
    assert verdict.box == (3, 10, 78, 10)
    assert verdict.method == "texture+disparity"
    assert (verdict.model, verdict.distance_m) == ("m/1", 2.5)


def test_a_late_clear_is_left_to_disparity_and_a_late_obstacle_is_one():
    def late(texture: Any, disparity: Any) -> Verdict:
        detectors = Says("texture", texture), Says("disparity", disparity)
        return FallbackPolicy(*detectors, Seconds(1.0)).judge(FRAME).verdict

    verdict = late(mask(), mask(3))
    assert (verdict.status, verdict.method) == (1, "disparity")
    assert verdict.health == "texture: late: 1000 ms"
    assert late(mask(), "dark").status == -1
    verdict = late(mask(3), mask())
    assert (verdict.status, verdict.method, verdict.health) == (1, "texture", "late: 1000 ms")


def test_what_stereo_has_no_use_for_is_refused():
    for options, message in (
        ({"algorithm": "dense"}, "unknown stereo 'dense'"),
        ({"algorithm": "pushbroom", "scale": 0.25}, "a scale of its own"),
        ({"odometry": {}}, "odometry is for pushbroom only"),
    ):
        refuses(message, StereoSetup, CALIBRATION, **options)
    sight = SightMeter()
    assert isinstance(
        StereoSetup(CALIBRATION, "pushbroom").detector(Grid(), sight), PushbroomDetector
    )
    assert isinstance(StereoSetup(CALIBRATION, "sgbm").detector(Grid(), sight), DisparityDetector)


def broken_model() -> Any:
    raise ToktError("bundle x.tokt: a hash does not match")


@pytest.mark.parametrize(
    ("words", "name", "load", "stereo"),
    [
        ("a hash does not match", "texture", broken_model, None),
        ("a hash does not match", "either", broken_model, STEREO),
        ("a hash does not match", "fallback", broken_model, None),
        ("disparity uses no model", "disparity", broken_model, STEREO),
        ("texture uses no calibration", "texture", NoiseScorer, STEREO),
        ("needs a stereo calibration", "disparity", None, None),
        ("needs a stereo calibration", "either", NoiseScorer, None),
        ("needs a model", "texture", None, None),
        ("needs a model", "either", None, STEREO),
        ("needs a model", "fallback", None, STEREO),
        ("unknown policy 'both'", "both", NoiseScorer, STEREO),
    ],
)
def test_what_a_policy_lacks_or_has_no_use_for_is_refused(words, name, load, stereo):
    refuses(words, assemble, name, load, stereo)


def test_fallback_without_anything_to_fall_back_on(noise_scorer):
    policy = assemble("fallback", lambda: noise_scorer, None).policy
    assert "there is no stereo calibration" in policy.judge(FRAME).verdict.health


def test_frames_that_disparity_is_not_asked_about_are_missing_to_it():
    asked = []

    class Asked(Says):
        def detect(self, frame):
            asked.append(frame.missed)
            return super().detect(frame)

    texture = Says("texture", "dark")
    policy = FallbackPolicy(texture, Asked("disparity", mask()))
    for number, able in enumerate((False, True, True, False, False)):
        policy.texture = Says("texture", mask()) if able else texture
        policy.judge(replace(FRAME, number=number, missed=number % 2))
    assert asked == [0, 1 + 1 + 1 + 1, 0]
    hold_row(
        "frames that stereo is not asked about (`fallback`)",
        "missing to it: nothing it remembers is younger than it is",
        "nothing",
    )


def test_only_exceptions_are_guarded():
    class Interrupted(Says):
        def detect(self, frame: Frame) -> Detection:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        SinglePolicy(Interrupted("texture", None)).judge(FRAME)
