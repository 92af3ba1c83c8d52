"""A policy's verdicts followed over time: whose trend it is, and when there is none."""

from dataclasses import replace
from typing import Any

import pytest

from tests.inference.stereo.plain_rig import PLAIN
from tokt.inference.frame import Frame
from tokt.inference.outputs.udp import encode_v1
from tokt.inference.policy.assembly import StereoSetup, assemble
from tokt.inference.policy.policy import Judgement
from tokt.inference.policy.temporal_cues import Anchor, TemporalCues, wholly_in_view
from tokt.inference.reason import Fault, Reason
from tokt.inference.texture.detector import ReloadableTextureDetector
from tokt.inference.verdict import Verdict, unknown_verdict

SIZE = (271, 360)
WHOLE = (144, 108, 72, 81)
DARK = unknown_verdict(Fault(Reason.DARK, "dark"))
NOTHING = Verdict(0, 0, 0, None, 0.0, None, "texture", "m/1", mask_size=SIZE)


def obstacle(index: int, **more: Any) -> Verdict:
    """The frame of that index of an approach that ends 5 s after frame 20, 4 frames a second."""
    mean = 1000.0 / (10.0 - 0.25 * index) ** 2
    verdict = Verdict(1, 0, 0, WHOLE, mean, None, "texture", "m/1", mask_size=SIZE)
    return replace(verdict, **more)


class Said:
    """A policy that says what a test wants."""

    def __init__(self) -> None:
        self.next = NOTHING

    def judge(self, frame: Frame) -> Judgement:
        return Judgement(self.next)


class Dive:
    """Frames at 4 a second through a followed policy."""

    def __init__(self, **more: Any) -> None:
        self.said = Said()
        self.policy = TemporalCues(self.said, **more)
        self.frames = 0

    def judge(self, verdict: Verdict, timed: bool = True) -> Verdict:
        self.frames += 1
        self.said.next = verdict
        t = 1461149301.0 + 0.25 * self.frames
        return self.policy.judge(Frame(self.frames, t, None, None, timed=timed)).verdict

    def approach(self, first: int, last: int, **more: Any) -> Verdict:
        for index in range(first, last):
            found = self.judge(obstacle(index, **more))
        return found


@pytest.mark.parametrize("method", ["texture", "disparity", "pushbroom", "texture+disparity"])
def test_every_method_has_a_trend(method):
    found = Dive().approach(0, 21, method=method)
    assert found.trend == "growing" and found.trend_confidence is not None
    assert found.trend_confidence >= 0.9
    assert found.expansion_contact_s == pytest.approx(5.0, abs=0.1)
    assert (found.anchor_x, found.anchor_y, found.anchor_size) == (None, None, None)


def test_the_verdict_is_otherwise_the_policy_s_and_v1_is_the_same():
    dive = Dive(anchor=Anchor(0.1))
    found, plain = dive.approach(0, 21), obstacle(20)
    assert found.trend is not None and found.anchor_size is not None
    assert encode_v1(found) == encode_v1(plain)
    more = {name: getattr(found, name) for name in vars(found) if "anchor" in name}
    more |= {name: getattr(found, name) for name in ("trend", "trend_confidence")}
    assert found == replace(plain, **more, expansion_contact_s=found.expansion_contact_s)


def test_unknown_and_clear_have_none_and_leave_the_means_before_them():
    dive = Dive(anchor=Anchor(0.1))
    dive.approach(0, 16)
    for verdict in (DARK, NOTHING):
        assert dive.judge(verdict) == verdict
    assert dive.approach(18, 21).expansion_contact_s == pytest.approx(5.0, abs=0.1)


def test_frames_without_times_have_no_trend():
    dive = Dive(anchor=Anchor(0.1))
    for index in range(21):
        found = dive.judge(obstacle(index), timed=False)
    assert found.trend is None and found.anchor_size is not None


def test_another_method_begins_anew():
    dive = Dive()
    assert dive.approach(0, 16).trend == "growing"
    assert dive.judge(obstacle(16, method="disparity", mean=80.0)).trend is None
    assert dive.judge(DARK).trend is None
    # Texture again: its means before disparity's are not put together with these.
    assert dive.approach(18, 24).trend is None
    assert dive.approach(24, 26).trend == "growing"


def test_an_exchange_of_the_model_begins_anew_even_for_the_same_one():
    detector, again = (object() for _ in range(2))
    slot = ReloadableTextureDetector(detector)  # type: ignore[arg-type]
    dive = Dive(texture=slot)
    assert dive.approach(0, 16).trend == "growing"
    slot.put(detector)  # type: ignore[arg-type]
    assert dive.judge(obstacle(16)).trend == "growing"  # nothing has changed
    slot.put(again)  # type: ignore[arg-type]
    assert dive.approach(17, 23).trend is None
    assert dive.approach(23, 25).trend == "growing"


@pytest.mark.parametrize(
    "box",
    [(0, 100, 50, 50), (100, 0, 50, 50), (300, 100, 60, 50), (100, 220, 50, 50), (10, 100, 50, 50)],
)
def test_what_touches_the_edge_is_not_in_whole(box):
    assert wholly_in_view(obstacle(0)) and not wholly_in_view(obstacle(0, box=box))
    found = Dive().approach(0, 21, box=box)
    assert found.trend == "growing" and found.expansion_contact_s is None


def test_patches_next_to_the_edge_s_are_in_whole():
    assert wholly_in_view(obstacle(0, box=(36, 27, 288, 216)))  # all but the outer ones
    assert not wholly_in_view(obstacle(0, box=(36, 27, 288, 243)))  # the lowest ends at 270 of 271
    assert not wholly_in_view(obstacle(0, box=None)) and not wholly_in_view(
        obstacle(0, mask_size=None)
    )


def test_where_the_right_camera_does_not_see_it_is_cut_off():
    # 2200 px, 0.3 m, 1360 px wide: at 2 m the left quarter of the picture is blind.
    blind_m = StereoSetup(PLAIN).blind_m
    assert blind_m == pytest.approx(2200 * 0.3 / 1360)
    for x0, distance_m, whole in ((90, 2.0, False), (110, 2.0, True), (90, 4.0, True)):
        verdict = obstacle(0, box=(x0, 108, 72, 81), distance_m=distance_m)
        assert wholly_in_view(verdict, blind_m) == whole
    assert wholly_in_view(
        obstacle(0, box=(20, 108, 72, 81)), blind_m
    )  # texture: no distance, no pair
    assert not wholly_in_view(obstacle(0, distance_m=0.0), blind_m)


@pytest.mark.parametrize("name", ["texture", "disparity", "either", "fallback"])
def test_every_policy_is_followed(name, noise_scorer):
    stereo = None if name == "texture" else StereoSetup(PLAIN)
    load = None if name == "disparity" else lambda: noise_scorer
    policy = assemble(name, load, stereo, anchor=Anchor(0.2)).policy
    assert isinstance(policy, TemporalCues) and policy.anchor == Anchor(0.2)
