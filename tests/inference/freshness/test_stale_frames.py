import numpy as np
import pytest

from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.freshness.stale_frames import StaleFrameDetector
from tokt.inference.reason import Reason

PERIOD_S = 0.1
PICTURE = np.zeros((4, 4), np.uint8)


def doubted(hand_clock, arrivals_s, missed=(), stale_s=0.5) -> list[int]:
    """Places of the frames whose pictures are removed, of those that arrive at these seconds."""
    detector, taken_away = StaleFrameDetector(hand_clock, Limits(stale_s=stale_s)), []
    for place, arrived_s in enumerate(arrivals_s):
        missed_before = dict(missed).get(place, 0)
        frame = Frame(place, 0.0, PICTURE, None, missed=missed_before, arrived=float(arrived_s))
        kept = detector.remove(frame)
        if kept.left is None:
            assert kept.left_fault.reason is Reason.STALE
            taken_away.append(place)
    return taken_away


BEFORE = list(PERIOD_S * np.arange(20))


def after(stall_s, *spacings_s):
    return list(BEFORE[-1] + stall_s + np.cumsum([0.0, *spacings_s]))


@pytest.mark.parametrize("stall_s", [0.6, 1.0, 3.0])
def test_frames_after_a_stall_are_in_doubt_until_one_comes_in_step(hand_clock, stall_s):
    held_up = [0.002] * 4
    told = doubted(hand_clock, BEFORE + after(stall_s, *held_up, 0.1, 0.1, 0.1))
    assert told == [20, 21, 22, 23, 24]


def test_frames_that_were_overtaken_are_counted_as_taken(hand_clock):
    """The loop sees some of those that come at once, as far apart as it takes to judge them."""
    arrivals_s = BEFORE + after(2.0, 0.09, 0.09, 0.1)
    assert doubted(hand_clock, arrivals_s, missed={21: 6, 22: 8}.items()) == [20, 21, 22]


def test_what_a_server_sends_after_it_as_fast_as_it_can_is_in_doubt_until_it_has_caught_up(
    hand_clock,
):
    """Twice as fast as it is taken: after a stall of 1 s that takes 1 s."""
    told = doubted(hand_clock, BEFORE + after(1.0, *[0.05] * 30))
    assert told in (list(range(20, 38)), list(range(20, 39)))  # a rounding apart


@pytest.mark.parametrize("spacing_s", [0.04, 0.2, 1.0, 3.0])
def test_a_camera_that_goes_on_at_another_rate_is_believed_again(hand_clock, spacing_s):
    told = doubted(hand_clock, BEFORE + after(2.0, *[spacing_s] * 60))
    assert 20 in told and max(told) < 60


def test_a_slow_camera_and_one_whose_frames_jitter_do_not_stall(hand_clock):
    assert not doubted(hand_clock, np.arange(20) * 1.0)
    jitter = np.random.default_rng(0).uniform(-0.09, 0.09, 200)
    assert not doubted(hand_clock, np.sort(PERIOD_S * np.arange(200) + jitter))


def test_frames_of_no_known_arrival_are_left_alone(hand_clock):
    detector = StaleFrameDetector(hand_clock, Limits())
    frames = [Frame(number, 0.0, PICTURE, None) for number in range(9)]
    assert [detector.remove(frame) for frame in frames] == frames
