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

from .plain_rig import HEIGHT, PLAIN, WIDTH, even_sea

SQUARE_PX = 320
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


def pair(x, y, disparity_px, seed=3):
    """Both views of an even sea with one textured square."""
    small = np.random.default_rng(seed).uniform(20, 120, (80, 80))
    texture = cv2.resize(small, (SQUARE_PX, SQUARE_PX))
    left, right = even_sea(), even_sea()
    there = x - disparity_px
    left[y : y + SQUARE_PX, x : x + SQUARE_PX] = texture
    right[y : y + SQUARE_PX, max(there, 0) : there + SQUARE_PX] = texture[:, max(-there, 0) :]
    return left.round().astype(np.uint8), right.round().astype(np.uint8)


def labels_of(shares):
    return ["reef" if share >= 0.1 else "ocean" for share in shares]


@settings(max_examples=scaled(40), deadline=None)
@given(x=st.integers(450, 1000), y=st.integers(40, 600), disparity_px=st.integers(70, 390))
def test_a_square_is_carried_to_where_it_stands(carrier, x, y, disparity_px):
    frames = pair(x, y, disparity_px)
    carried = carrier.carry(*frames, labels_of(coverage(x, y)), CLEAR)
    there = coverage(x - disparity_px, y)
    for label, share in zip(carried, there, strict=True):
        assert share < 0.1 or label != "ocean"
        assert share < 0.9 or label == "reef"
    near = coverage(x - disparity_px, y).reshape(10, 10) > 0
    reach = cv2.dilate(near.astype(np.uint8), np.ones((3, 3), np.uint8)).ravel()
    assert all(reach[cell] for cell, label in enumerate(carried) if label == "reef")
    assert carried.count("ocean") >= 5


def test_nothing_is_said_of_where_what_is_not_found_may_be(carrier):
    x, y = 700, 350
    left, right = pair(x, y, 200)
    labels = labels_of(coverage(x, y))
    rows = {cell // 10 for cell, label in enumerate(labels) if label == "reef"}
    sea = even_sea().round().astype(np.uint8)
    for other, said in ((sea, labels), (right, [None] * 100), (np.zeros_like(left), labels)):
        carried = carrier.carry(left, other, said, CLEAR)
        assert "reef" not in carried
        for row in rows:
            stretch = carried[row * 10 + 2 : row * 10 + 8]  # 700 px and up to 400 px left of it
            assert set(stretch) == {None}
    nothing = carrier.carry(left, right, [None] * 100, CLEAR)
    assert set(nothing) == {None}


def test_what_the_left_camera_does_not_see_is_not_clear(carrier):
    sea = even_sea().round().astype(np.uint8)
    carried = np.array(carrier.carry(sea, sea, ["ocean"] * 100, CLEAR), object).reshape(10, 10)
    assert (carried[:, :6] == "ocean").all()
    assert (carried[:, 7:] == None).all()  # noqa: E711


def test_any_label_is_carried(carrier):
    frames = pair(700, 380, 200)
    labels = [{"reef": "unsure"}.get(label, label) for label in labels_of(coverage(700, 380))]
    carried = carrier.carry(*frames, labels, CLEAR)
    full = np.flatnonzero(coverage(500, 380) >= 0.9)
    assert {carried[cell] for cell in full} == {"unsure"}


def test_frames_of_another_size_are_refused(carrier):
    frame = np.zeros((512, 680), np.uint8)
    refuses("is for 1360x1024, not 680x512", carrier.carry, frame, frame, ["ocean"] * 100, CLEAR)
