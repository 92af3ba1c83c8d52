"""Keypoints that grow."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.inference.frame import Frame
from tokt.training.fitting.train import rendered_other_image
from tokt_studies.baselines.size_change import SCALES, SizeChange, enlargement

pytestmark = pytest.mark.xdist_group("baselines")

SIDE = 360
SCENE = rendered_other_image(3)[:SIDE, :SIDE]


def seen_at(scale: float) -> NDArray[np.uint8]:
    """The scene about its centre, so many times larger."""
    middle = (SIDE - 1) / 2
    shift = middle * (1 - scale)
    move = np.array([[scale, 0, shift], [0, scale, shift]])
    return cv2.warpAffine(SCENE, move, (SIDE, SIDE), borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("scale", [1.0, 1.2, 1.3, 1.5, 0.8])
def test_how_much_larger_a_place_became(scale):
    middle = np.array([(SIDE - 1) / 2] * 2)
    found = enlargement(seen_at(1.0), middle, seen_at(scale), middle, 25)
    assert found == pytest.approx(max(scale, 1.0))
    assert found in SCALES


def statuses(method: SizeChange, scales: list[float]) -> list[int]:
    return [
        method.judge(Frame(turn, turn / 2, seen_at(scale), None)).verdict.status
        for turn, scale in enumerate(scales)
    ]


def test_only_what_comes_nearer_is_an_obstacle():
    assert statuses(SizeChange(back=1), [1.0, 1.3, 1.0]) == [-1, 1, 0]


def test_frames_are_held_against_those_before():
    """By the third frame nothing grew since the second, but all of it since the first."""
    assert statuses(SizeChange(back=2), [1.0, 1.3, 1.3]) == [-1, -1, 1]
    assert statuses(SizeChange(back=1), [1.0, 1.3, 1.3]) == [-1, 1, 0]


def test_where_it_is_and_no_word_of_a_frame_that_cannot_be_read():
    method = SizeChange(back=1)
    method.judge(Frame(1, 10.0, seen_at(1.0), None))
    unread = method.judge(Frame(2, 11.0, None, None))
    assert unread.verdict.status == -1 and unread.mask is None
    judged = method.judge(Frame(3, 12.0, seen_at(1.3), None))
    assert judged.mask is not None
    assert judged.verdict.mean == pytest.approx(judged.mask.mean())
    assert judged.mask.any()


def test_rendered_approach_and_retreat(dive):
    method = SizeChange(back=1)
    found = {}
    for number in range(12, 18):
        judged = method.judge(dive.pair(number))
        found[number] = judged.verdict.status
    assert found == {12: -1, 13: 1, 14: 1, 15: 1, 16: 0, 17: 0}
    last = method.judge(dive.pair(15))
    assert last.mask is not None
    tower = dive.tower(15)
    on, off = (last.mask[tower] > 0).mean(), (last.mask[~tower] > 0).mean()
    assert on > 4 * off
