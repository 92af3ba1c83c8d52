import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.frozen_frames import StuckFrameDetector
from tokt.inference.reason import Reason

RNG = np.random.default_rng(3)


def noise() -> NDArray[np.uint8]:
    return RNG.integers(0, 255, (100, 60), np.uint8)


def test_a_picture_that_is_repeated_too_often_is_taken_away():
    watch, same = StuckFrameDetector(Limits(frozen_repeats=5)), noise()
    seen = [watch.remove(Frame(number, 0.0, same.copy(), None)) for number in range(8)]
    assert [frame.left is None for frame in seen] == [False] * 6 + [True] * 2
    assert seen[6].left_fault.reason is Reason.FROZEN and "6 times" in seen[6].left_fault
    moved = watch.remove(Frame(9, 0.0, noise(), None))
    assert moved.left is not None and not moved.left_fault


def test_a_picture_is_no_younger_for_being_repeated():
    watch, same = StuckFrameDetector(Limits(stale_s=0.5)), noise()
    times = (10.0, 10.3, 10.5, 10.6)
    seen = [watch.remove(Frame(1, 0.0, same.copy(), None, timed=True, arrived=t)) for t in times]
    assert [frame.left is None for frame in seen] == [False, False, False, True]
    untimed = StuckFrameDetector(Limits(stale_s=0.5))
    kept = [untimed.remove(Frame(1, 0.0, same, None, arrived=t)) for t in times]
    assert all(frame.left is not None for frame in kept)


@pytest.mark.parametrize("side", ["left", "right"])
def test_each_camera_freezes_for_itself(side):
    watch, same = StuckFrameDetector(Limits(frozen_repeats=1)), noise()
    for _ in range(4):
        left, right = (same, noise()) if side == "left" else (noise(), same)
        frame = watch.remove(Frame(1, 0.0, left, right))
    other = "right" if side == "left" else "left"
    assert getattr(frame, side) is None and getattr(frame, other) is not None
    assert side in getattr(frame, f"{side}_fault")


def test_one_grey_level_anywhere_is_another_picture():
    watch, picture = StuckFrameDetector(Limits(frozen_repeats=1)), noise()
    for index in range(20):
        frame = watch.remove(Frame(index, 0.0, picture.copy(), None))
        assert frame.left is not None
        picture[33, index] ^= 1  # a row that is not among those looked at first
