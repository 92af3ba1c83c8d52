"""Which frames are kept."""

import pytest

from tests.calls import refuses
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.clip_trigger import DOUBTS, MAX_S, REST_S, ClipTrigger
from tokt.inference.verdict import Verdict, unknown_verdict

OBSTACLE = Verdict(1, 3, 4, None, 9.0, None, "texture", "reef/7")
CLEAR = Verdict(0, 0, 0, None, 0.0, None, "texture", "reef/7")
DARK = unknown_verdict(Fault(Reason.DARK, "too dark"))
RULE = unknown_verdict(Fault(Reason.FRAME_RULE, "frames before are not known"))
LOST = unknown_verdict(Fault(Reason.CAMERA_LOST, "gone"))


def kept(trigger, verdict_at, seconds) -> list[float]:
    """Times of the frames that are kept, at 10 a second."""
    times = [tenth / 10 for tenth in range(round(10 * seconds))]
    return [now for now in times if trigger.should_keep(now, verdict_at(now))]


def test_every_reason_is_decided():
    """What a thing never learnt looks like is what a person should label first."""
    no_picture = {"ok", "no_frame", "stale", "stalled", "overload", "missing", "unreadable"}
    no_picture |= {"incomplete", "unpaired", "camera_lost", "frozen", "no_model"}
    assert set(Reason) - set(DOUBTS) == no_picture


def test_a_detection_is_kept_with_what_comes_after():
    trigger = ClipTrigger(2, 1)
    times = kept(trigger, lambda now: OBSTACLE if 5 <= now < 6 or now == 6.5 else CLEAR, 20)
    assert times == [t / 10 for t in range(50, 76)]
    assert (trigger.clip, trigger.cause) == (1, "obstacle")


def test_two_detections_far_apart_are_two_moments():
    trigger = ClipTrigger(0, 0)
    opened = [
        (now, trigger.clip)
        for now in (1.0, 2.0, 3.0, 10.0)
        if trigger.should_keep(now, OBSTACLE if now != 2 else CLEAR) and trigger.opened
    ]
    assert opened == [(1.0, 1), (3.0, 2), (10.0, 3)]


def test_hours_before_a_wall_are_a_frame_a_second():
    trigger = ClipTrigger(2, 2)
    times = kept(trigger, lambda now: OBSTACLE, 100)
    full = sum(t <= MAX_S for t in times)
    assert full == 10 * MAX_S + 1 and len(times) - full == 69
    # In parts, so that the oldest can make room for the newest.
    assert trigger.clip == 4


@pytest.mark.parametrize("verdict", [DARK, RULE])
def test_a_doubt_is_kept_when_it_begins(verdict):
    trigger = ClipTrigger(2, 1)
    assert kept(trigger, lambda now: CLEAR if now < 5 else verdict, 200) == [
        t / 10 for t in range(50, 61)
    ]
    assert trigger.cause == verdict.reason.value


def test_a_doubt_that_comes_and_goes_is_kept_once_a_minute():
    trigger = ClipTrigger(2, 0)
    kept(trigger, lambda now: DARK if now % 2 < 1 else CLEAR, 3 * REST_S + 1)
    assert trigger.clip == 4


def test_what_has_no_picture_is_no_cause():
    assert kept(ClipTrigger(2, 2), lambda now: LOST, 10) == []


def test_a_moment_can_be_asked_for():
    trigger = ClipTrigger(1, 1)
    times = []
    for tenth in range(1300):
        if tenth in (50, 60, 700):  # the second one within the minute
            trigger.request("drift")
        if trigger.should_keep(tenth / 10, CLEAR):
            times.append(tenth)
    assert times == [*range(50, 61), *range(700, 711)]
    assert trigger.cause == "drift"


def test_what_a_user_can_get_wrong():
    for around in ((-1, 0), (0, 31), (float("nan"), 0)):
        refuses("0 to 30 s", ClipTrigger, *around)
