"""The look of a named object: learnt from one box, found where it is, refused where it is none."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.inference.policy.named_object import BOX, HEIGHT, WIDTH, own, picture, twin
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.inference.policy.object_model import Likeness, ObjectModel, Place, Reach


@pytest.fixture(scope="module")
def model():
    return ObjectModel(picture(own()), BOX)


def found(model, frame, reach=None):
    likeness = Likeness(model, frame)
    return likeness.refined(likeness.best(reach))


@pytest.mark.parametrize(
    ("x", "y", "size"), [(180, 132, 1.0), (233, 171, 1.0), (122, 99, 1.25), (200, 140, 0.8)]
)
def test_it_is_found_where_it_is_and_of_its_size(model, x, y, size):
    place, match = found(model, picture(own(x, y, size), seed=3))
    assert math.hypot(place.x - x, place.y - y) < 2.5
    assert place.size == pytest.approx(math.log(size), abs=0.04)
    assert place.likeness > 0.8 and match > 0.8


def test_a_third_out_of_the_picture_it_is_found_by_what_is_seen(model):
    place, match = found(model, picture(own(WIDTH - 10, 132), seed=3))
    assert place.x == pytest.approx(WIDTH - 10, abs=4) and match > 0.7


def test_a_larger_picture_of_the_same_is_the_same(model):
    frame = picture(own(200, 120), seed=3)
    place, _ = found(model, frame.repeat(2, 0).repeat(2, 1))
    assert (place.x, place.y) == pytest.approx((200, 120), abs=2.5)


def test_another_of_its_make_lacks_its_detail(model):
    mine, other = picture(own(), seed=3), picture(twin(180), seed=3)
    assert found(model, other)[1] < 0.8 < 0.9 < found(model, mine)[1]


def test_outside_its_reach_nothing_is_found(model):
    likeness = Likeness(model, picture(own(250, 132), seed=3))
    near = likeness.best(Reach(Place(100, 132, 0.0, 1.0), 30, 0.1))
    assert near is not None and near.likeness < 0.6 and math.hypot(near.x - 100, near.y - 132) <= 30
    assert likeness.best(Reach(Place(-300, 132, 0.0, 1.0), 30, 0.1)) is None


@pytest.mark.parametrize(
    ("box", "why"),
    [
        ((20, 20, 60, 80), "looks like what is around it"),  # open water
        ((150, 90, 10, 84), "too small"),
        ((150, 90, 20, 12), "too small"),
        ((330, 90, 60, 84), "not inside the picture of 360x271"),
        ((-1, 90, 60, 84), "not inside"),
        ((0, 0, 350, 260), "more than 80 %"),
        ((150, 90, 0, 84), "not inside"),
        ((math.nan, 90, 60, 84), "not inside"),
    ],
)
def test_what_cannot_be_held_is_refused(box, why):
    refuses(why, ObjectModel, picture(own()), box)


side = st.integers(-5, 400)


@settings(max_examples=scaled(40))
@given(
    st.sampled_from(["blank", "black", "noise", "object", "stripes"]),
    st.tuples(side, side, side, side),
    st.sampled_from([(HEIGHT, WIDTH), (90, 120), (40, 400), (3, 3)]),
)
def test_any_box_of_any_picture_is_held_or_refused(kind, box, shape):
    rng = np.random.default_rng(1)
    frames = {
        "blank": np.full(shape, 90, np.uint8),
        "black": np.zeros(shape, np.uint8),
        "noise": rng.integers(0, 255, shape, np.uint8),
        "object": picture(own())[: shape[0], : shape[1]],
        "stripes": np.tile(np.arange(shape[1]) // 8 % 2 * 200, (shape[0], 1)).astype(np.uint8),
    }
    try:
        model = ObjectModel(frames[kind], box)
    except ToktError as error:
        assert "\n" not in str(error)
        return
    place = Likeness(model, frames[kind]).best()
    assert place is not None and math.isfinite(place.likeness)
