"""Holding a named object: what is held is seen in that frame, and is never another one."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.policy.named_object import (
    BOX,
    HEIGHT,
    MIDDLE,
    SHARES,
    WIDTH,
    like,
    own,
    picture,
    twin,
)
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.policy.object_model import ObjectModel, detail_picture, inside
from tokt.inference.policy.object_naming import ObjectNaming, parse_named
from tokt.inference.policy.object_tracker import (
    AGAIN,
    HELD,
    LOST,
    MATCH_FINDS,
    SEARCHED,
    SEARCHING,
    ObjectTracker,
)
from tokt.inference.policy.policy import Judgement
from tokt.inference.policy.temporal_cues import Anchor, TemporalCues
from tokt.inference.verdict import verdict_from_mask


@pytest.fixture(scope="module")
def model():
    return ObjectModel(detail_picture(picture(own())), SHARES)


class Dive:
    """Frames of things, one after the other, to a tracker."""

    def __init__(self, model):
        self.tracker, self.frames = ObjectTracker(model), 0

    def see(self, *things, **more):
        self.frames += 1
        return self.tracker.look(picture(*things, seed=self.frames), **more)

    def held(self, *things, frames=AGAIN + 5, **more):
        """The last of some frames, all alike."""
        return [self.see(*things, **more) for _ in range(frames)][-1]


def test_wherever_it_is_it_is_found_and_followed_as_it_moves_and_grows(model):
    dive = Dive(model)
    assert [dive.see(own(220, 150)) is not None for _ in range(4)] == [False, False, True, True]
    for step in range(20):
        x, y, size = 220 + 3 * step, 150 - 2 * step, 1.02**step
        place = dive.see(own(x, y, size))
        assert math.hypot(place.x - x, place.y - y) < 3 and dive.tracker.state == HELD
        assert place.size == pytest.approx(math.log(size), abs=0.05)
    box = model.box_at(place)
    assert box[2] * WIDTH == pytest.approx(BOX[2] * size, rel=0.05)


def test_covered_it_is_told_at_once_and_held_again_where_it_comes_out(model):
    dive = Dive(model)
    dive.held(own())
    for _ in range(10):
        assert dive.see() is None and dive.tracker.state == SEARCHING
    again = [dive.see(own(195, 138)) for _ in range(AGAIN)]
    assert again[:-1] == [None] * (AGAIN - 1) and again[-1].x == pytest.approx(195, abs=3)


def test_a_frame_without_a_picture_or_of_another_shape_holds_nothing(model):
    dive = Dive(model)
    blank = np.full((HEIGHT, WIDTH), 9, np.uint8)
    shapes = [(300, 300), (1, 400), (400, 1), (9,), (0, 0), (HEIGHT, WIDTH, 4)]
    others = [np.zeros(shape, np.uint8) for shape in shapes]
    for frame in (None, blank, blank.astype(float), *others):
        dive.held(own())
        assert dive.tracker.state == HELD
        assert dive.tracker.look(frame) is None and dive.tracker.state == SEARCHING


@pytest.mark.parametrize("away", [0, 15, 40, 100])
def test_another_of_its_make_is_never_held_in_its_place(model, away):
    dive = Dive(model)
    dive.held(own())
    for frame in range(15):
        assert dive.see(twin(MIDDLE[0] + away), missed=frame % 2) is None
    assert dive.held(own(), twin(MIDDLE[0] + 110)).x == pytest.approx(MIDDLE[0], abs=3)


def test_two_that_are_nearly_the_same_are_told_from_each_other_by_none(model):
    for other in (own(250), (250, 132, 1.0, 1.45)):
        assert Dive(model).held(own(100), other) is None


def test_one_frame_of_it_does_not_lend_its_like_a_name(model):
    dive = Dive(model)
    best = model.find(detail_picture(picture(like(250))), model.place, math.inf, math.inf)
    assert 0.86 < best.match < MATCH_FINDS
    for x in (100, 250, 240):  # of these two the like is not far from where the object was
        dive.see(own(x))
        assert [dive.see(like(250)) for _ in range(8)] == [None] * 8


def test_what_jumps_is_not_held(model):
    dive = Dive(model)
    assert [dive.see(own(100 + 150 * (step % 2))) for step in range(12)] == [None] * 12


@pytest.mark.parametrize("step", [1.5, 6])
def test_its_like_in_front_of_it_is_let_go_when_it_comes_out(model, step):
    dive = Dive(model)
    dive.held(own())
    for x in np.arange(270, 60, -step):
        place = dive.see(own(), like(x))
        hidden = abs(x - MIDDLE[0]) < BOX[2]
        assert place is None or hidden or abs(place.x - MIDDLE[0]) < 4
    assert dive.held(own()).x == pytest.approx(MIDDLE[0], abs=3)


def test_what_passes_beside_it_does_not_take_it_along(model):
    dive = Dive(model)
    dive.held(own())
    for x in range(300, 20, -8):
        place = dive.see(twin(x, 150), own())  # it is the nearer one
        assert place is None or math.hypot(place.x - MIDDLE[0], place.y - MIDDLE[1]) < 4


def test_a_match_that_falls_at_once_is_another_thing(model):
    """Its like would do to go on holding it, to 0.7, had the match become less slowly."""
    dive = Dive(model)
    dive.held(own())
    assert dive.see(like(MIDDLE[0])) is None


def test_far_from_where_it_was_it_is_not_looked_for(model):
    dive = Dive(model)
    dive.held(own())
    dive.see()
    assert dive.held(own(60, 200)) is None and dive.tracker.state == SEARCHING


def test_searched_for_long_it_is_lost_but_not_before_it_was_held(model):
    dive, waits = Dive(model), Dive(model)
    dive.held(own())
    for _ in range(SEARCHED + 1):
        assert LOST not in (dive.tracker.state, waits.tracker.state)
        for each in (dive, waits):
            each.tracker.look(None)
    assert dive.held(own()) is None and dive.tracker.state == LOST
    assert waits.held(own()) is not None and waits.tracker.state == HELD


def test_missing_frames_let_it_be_farther_on(model):
    dive = Dive(model)
    dive.held(own())
    assert dive.see(own(MIDDLE[0] + 30)) is None
    dive.held(own())
    assert dive.see(own(MIDDLE[0] + 30), missed=4).x == pytest.approx(MIDDLE[0] + 30, abs=3)


@pytest.mark.parametrize("missed", [6, MANY_MISSED])
def test_after_many_missing_frames_it_is_searched_for(model, missed):
    dive = Dive(model)
    dive.held(own())
    assert dive.tracker.look(None, missed=missed) is None
    assert dive.see(own(), missed=missed) is None and dive.tracker.state == SEARCHING
    assert dive.held(own(), frames=2) is not None


def test_a_thing_as_large_in_the_picture_at_half_the_distance_is_another(model):
    dive = Dive(model)
    dive.held(own(), frames=10, distance=lambda _: 4.0)
    assert dive.see(own(), distance=lambda _: 4.2) is not None
    assert dive.see(own(), distance=lambda _: 2.0) is None
    assert dive.held(own(), distance=lambda _: 2.0) is None
    assert dive.held(own()) is not None  # not measured


@pytest.mark.parametrize(
    ("box", "why"),
    [
        ((0.4, 0.3, 0.05, 0.3), "1/15 of the picture's width"),
        ((0.9, 0.3, 0.2, 0.3), "not inside"),
        ((-0.1, 0.3, 0.2, 0.3), "not inside"),
        ((0.0, 0.0, 0.95, 0.95), "more than 80 %"),
        ((math.nan, 0.3, 0.2, 0.3), "not inside"),
        ((0.3, 0.3, 0.2, math.nan), "not inside"),
    ],
)
def test_what_cannot_be_held_is_refused(box, why):
    refuses(why, ObjectModel, detail_picture(picture(own())), box)
    refuses("nothing in it", ObjectModel, np.full((HEIGHT, WIDTH), 128, np.uint8), SHARES)
    refuses("no picture of a camera", detail_picture, np.zeros((1, 400), np.uint8))


share = st.floats(-0.2, 1.2)


@settings(max_examples=scaled(40))
@given(
    st.sampled_from(["blank", "noise", "object", "stripes"]),
    st.tuples(share, share, share, share),
    st.sampled_from([(HEIGHT, WIDTH), (90, 120), (60, 400)]),
)
def test_any_box_of_any_picture_is_searched_for_or_refused(kind, box, shape):
    rng = np.random.default_rng(1)
    stripes = np.tile(np.arange(shape[1]) // 8 % 2 * 200, (shape[0], 1)).astype(np.uint8)
    frame = {
        "blank": np.full(shape, 90, np.uint8),
        "noise": rng.integers(0, 255, shape, np.uint8),
        "object": picture(own())[: shape[0], : shape[1]],
        "stripes": stripes,
    }[kind]
    try:
        tracker = ObjectTracker(ObjectModel(detail_picture(frame), box))
    except ToktError as error:
        assert "\n" not in str(error)
        return
    for _ in range(AGAIN):
        place = tracker.look(frame)
    assert place is None or all(map(math.isfinite, place))


@settings(max_examples=scaled(60))
@given(
    st.one_of(st.integers(0, 10**9), st.just("a:b/c.png")), st.tuples(*[st.integers(0, 9999)] * 4)
)
def test_a_named_box_is_read_as_it_is_written(frame, box):
    read, found = parse_named(f" {frame}:{','.join(map(str, box))}")
    assert found == box
    assert read == frame if isinstance(frame, int) else read.endswith("/a:b/c.png")
    for text in ("", "3", ":1,2,3,4", "3:1,2,3", "3:1,2,3,x", "3:1,2,3,-4"):
        refuses("FRAME:X,Y,W,H", parse_named, text)


def test_a_named_object_is_held_from_the_next_frame_on():
    cues = SimpleNamespace(tracker=None, anchor=None)
    naming = ObjectNaming(cues, lambda: 12.0)
    detail = detail_picture(picture(own()))
    refuses("not inside", naming.name, 3, detail, (0.9, 0.9, 0.2, 0.2))
    assert naming.take() == [] and cues.tracker is None
    naming.name(3, detail, SHARES)
    assert cues.tracker is None
    (event,) = naming.take()
    assert (event.t, event.name, event.fields["frame"]) == (12.0, "object_named", 3)
    assert cues.tracker.state == SEARCHING and naming.take() == []
    refuses("only recorded frames", naming.name_before, "3:10,10,50,50", None, None)
    refuses("", naming.name_before, "not-there.png:10,10,50,50", None, None)


def test_a_size_out_of_reach_is_refused(model):
    for share, held in ((model.share, True), (1.9 * model.share, True), (2.1 * model.share, False)):
        naming = ObjectNaming(TemporalCues(Sees(SHARES), anchor=Anchor(share)), lambda: 0.0)
        if held:
            naming.name(1, detail_picture(picture(own())), SHARES)
        else:
            refuses("held at 0.026 to 0.1", naming.name, 1, detail_picture(picture(own())), SHARES)
        assert len(naming.take()) == held


def test_frames_of_another_shape_are_told_once():
    cues = TemporalCues(Sees(SHARES))
    naming = ObjectNaming(cues, lambda: 12.0)
    naming.name(1, detail_picture(picture(own())), SHARES)
    naming.take()
    said = []
    for _ in range(3):
        assert cues.tracker.look(np.zeros((WIDTH, HEIGHT), np.uint8)) is None
        said += naming.take()
    assert [(event.name, event.t) for event in said] == [("object_refused", 12.0)]
    assert "another shape" in said[0].words


class Sees:
    """A policy that sees one thing, as large as that box in shares of the picture, at 4 m."""

    def __init__(self, box):
        self.mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        self.mask[inside(box, self.mask.shape)] = 255

    def judge(self, frame):
        verdict = replace(verdict_from_mask(self.mask, "disparity"), distance_m=4.0)
        return Judgement(verdict, mask=self.mask)


def test_the_errors_are_the_object_s_own_and_its_distance_counts_where_nothing_else_is(model):
    for box, known in (((SHARES[0] + 0.05, *SHARES[1:]), True), ((0.0, 0.0, 1.0, 1.0), False)):
        cues = TemporalCues(
            Sees(box), anchor=Anchor(model.share / 1.5), tracker=ObjectTracker(model)
        )
        for number in range(1, 12):
            seen = Frame(number, float(number), picture(own(198), seed=number), None)
            judged = cues.judge(seen)
        verdict = judged.verdict
        assert verdict.anchor == HELD and judged.held[0] == pytest.approx(0.467, abs=0.01)
        found = verdict.anchor_x, verdict.anchor_y, verdict.anchor_size
        assert found == pytest.approx((0.1, -0.026, math.log(1.5) / 2), abs=0.03)
        assert (len(cues.tracker._own) > 0) == known
        judged = cues.judge(Frame(12, 12.0, None, None))
        assert judged.held is None and judged.verdict.anchor == SEARCHING
        assert judged.verdict.anchor_x is None and judged.verdict.anchor_size is None
