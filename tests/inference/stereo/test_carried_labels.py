"""Labels of the left camera carried to the right one: where things are, never clear by guess."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.stereo.carried_labels import LabelCarrier

from .plain_rig import HEIGHT, PLAIN, SQUARE_PX, WIDTH, even_sea, pair_with, square_texture

GRID = Grid()
CLEAR = {"ocean"}


@pytest.fixture(scope="module")
def carrier():
    return LabelCarrier(PLAIN, GRID)


def coverage(x, y):
    """Share of each patch that the square at (x, y) covers."""
    mask = np.zeros((HEIGHT, WIDTH), np.float32)
    mask[y : y + SQUARE_PX, max(x, 0) : max(x + SQUARE_PX, 0)] = 1
    return GRID.cells(cv2.resize(mask, (360, 271), interpolation=cv2.INTER_AREA)).mean((1, 2))


def pair(x, y, disparity_px):
    """Both views of an even sea with one textured square."""
    return pair_with(square_texture(), x, y, disparity_px)


def labels_of(shares):
    return ["reef" if share >= 0.1 else "ocean" for share in shares]


@settings(max_examples=scaled(40), deadline=None)
@given(x=st.integers(450, 1000), y=st.integers(40, 600), disparity_px=st.integers(70, 390))
def test_a_square_is_carried_to_where_it_stands(carrier, x, y, disparity_px):
    frames = pair(x, y, disparity_px)
    carried = carrier.carry(*frames, labels_of(coverage(x, y)), CLEAR)
    assert set(carried) <= {"reef", None}  # clear is carried nowhere
    there = coverage(x - disparity_px, y)
    full = np.flatnonzero(there >= 0.9)
    assert sum(carried[cell] == "reef" for cell in full) >= len(full) / 2
    near = cv2.dilate((there.reshape(10, 10) > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    assert all(near.flat[cell] for cell, label in enumerate(carried) if label == "reef")


def test_what_is_not_found_or_has_no_label_is_not_carried(carrier):
    left, right = pair(700, 350, 200)
    labels = labels_of(coverage(700, 350))
    sea = even_sea().round().astype(np.uint8)
    for shown, said in ((sea, labels), (right * 0, labels), (right, [None] * 100)):
        assert set(carrier.carry(left, shown, said, CLEAR)) == {None}


def test_frames_of_another_size_are_refused(carrier):
    frame = np.zeros((512, 680), np.uint8)
    refuses("is for 1360x1024, not 680x512", carrier.carry, frame, frame, ["ocean"] * 100, CLEAR)


@settings(max_examples=scaled(40), deadline=None)
@given(x=st.integers(0, 1040), y=st.integers(0, 700), disparity_px=st.integers(0, 390))
def test_a_right_patch_is_clear_where_all_that_it_may_show_is(carrier, x, y, disparity_px):
    labels = labels_of(coverage(x, y) * 1e6)  # a patch that any of it touches is no ocean
    told = np.reshape(carrier.sure_clear(labels, CLEAR), (10, 10))
    assert not told[coverage(x - disparity_px, y).reshape(10, 10) > 0.02].any()
    assert not told[:, 7:].any(), "what is near lies beside the left frame"


def test_open_water_of_both_cameras_is_clear(carrier):
    sea = ["ocean"] * 100
    told = np.reshape(carrier.sure_clear(sea, CLEAR), (10, 10))
    assert told[:, :6].all() and not told[:, 7:].any()
    assert not any(carrier.sure_clear([None] * 100, CLEAR))
    told = np.reshape(carrier.sure_clear([*sea[:55], None, *sea[56:]], CLEAR), (10, 10))
    assert not told[5, 4] and not told[5, 5], "one patch nobody labelled"
    assert told[5, 0] and told[2, 5]
