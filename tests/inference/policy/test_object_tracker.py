"""Holding a named object: what is held is seen in that frame, and is never another one."""

import math

import numpy as np
import pytest

from tests.inference.policy.named_object import BOX, MIDDLE, own, picture, twin
from tokt.inference.policy.object_model import ObjectModel
from tokt.inference.policy.object_tracker import (
    AGAIN,
    HELD,
    LOST,
    SEARCHED,
    SEARCHING,
    ObjectTracker,
)


@pytest.fixture(scope="module")
def model():
    return ObjectModel(picture(own()), BOX)


class Dive:
    """Frames of things, one after the other, to a tracker."""

    def __init__(self, model, **more):
        self.tracker, self.frames = ObjectTracker(model, **more), 0

    def see(self, *things, **more):
        self.frames += 1
        return self.tracker.look(picture(*things, seed=self.frames), **more)

    def held(self, *things, frames=AGAIN + 5, **more):
        """The last of some frames, all alike."""
        return [self.see(*things, **more) for _ in range(frames)][-1]


def test_it_is_followed_as_it_moves_and_grows(model):
    dive = Dive(model)
    assert [dive.see(own()) is not None for _ in range(4)] == [False, False, True, True]
    for step in range(20):
        x, y, size = 180 + 4 * step, 132 - 2 * step, 1.02**step
        place = dive.see(own(x, y, size))
        assert math.hypot(place.x - x, place.y - y) < 3 and dive.tracker.state == HELD
        assert place.size == pytest.approx(math.log(size), abs=0.05)


def test_covered_it_is_told_at_once_and_held_again_where_it_comes_out(model):
    dive = Dive(model)
    dive.held(own())
    for _ in range(10):
        assert dive.see() is None and dive.tracker.state == SEARCHING
    again = [dive.see(own(195, 138)) for _ in range(AGAIN)]
    assert again[:-1] == [None] * (AGAIN - 1) and again[-1].x == pytest.approx(195, abs=3)


def test_a_frame_without_a_picture_or_of_another_shape_holds_nothing(model):
    dive = Dive(model)
    for frame in (None, np.zeros((300, 300), np.uint8), np.zeros((1, 400), np.uint8)):
        dive.held(own())
        assert dive.tracker.state == HELD
        assert dive.tracker.look(frame) is None and dive.tracker.state == SEARCHING


@pytest.mark.parametrize("away", [0, 15, 40, 100])
def test_another_of_its_make_is_never_held_in_its_place(model, away):
    dive = Dive(model)
    dive.held(own())
    for frame in range(60):
        assert dive.see(twin(MIDDLE[0] + away), missed=frame % 2) is None
    assert dive.held(own(), twin(MIDDLE[0] + 110)).x == pytest.approx(MIDDLE[0], abs=3)


def test_what_passes_beside_it_does_not_take_it_along(model):
    dive = Dive(model)
    dive.held(own())
    for x in range(300, 20, -6):
        place = dive.see(twin(x, 150), own())  # it is the nearer one
        assert place is None or math.hypot(place.x - MIDDLE[0], place.y - MIDDLE[1]) < 4


def test_far_from_where_it_was_it_is_not_looked_for(model):
    dive = Dive(model)
    dive.held(own())
    dive.see()
    assert dive.held(own(60, 200)) is None and dive.tracker.state == SEARCHING
    assert Dive(model, anywhere=True).held(own(60, 200)) is not None


def test_named_some_frames_ago_it_may_have_moved_meanwhile(model):
    assert Dive(model).see(own(225)) is None
    assert Dive(model, unseen=12).held(own(225)) is not None


def test_lost_for_long_it_is_lost_for_good_but_one_named_before_the_run_is_not(model):
    dive, waits = Dive(model), Dive(model, anywhere=True)
    dive.held(own())
    for each in (dive, waits):
        each.tracker.look(None, missed=SEARCHED)
        each.tracker.look(None)
    assert dive.held(own()) is None and dive.tracker.state == LOST
    assert waits.held(own()) is not None and waits.tracker.state == HELD


def test_missing_frames_let_it_be_farther_on(model):
    dive = Dive(model)
    dive.held(own())
    assert dive.see(own(MIDDLE[0] + 40)) is None
    dive.held(own())
    assert dive.see(own(MIDDLE[0] + 40), missed=2).x == pytest.approx(MIDDLE[0] + 40, abs=3)


def test_a_thing_as_large_in_the_picture_at_half_the_distance_is_another(model):
    dive = Dive(model)
    dive.held(own(), frames=10, distance=lambda _: 4.0)
    assert dive.see(own(), distance=lambda _: 4.2) is not None
    assert dive.see(own(), distance=lambda _: 2.0) is None
    assert dive.held(own(), distance=lambda _: 2.0) is None
    assert dive.held(own()) is not None  # not measured
