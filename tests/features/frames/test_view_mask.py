"""Masks: read as users write them, kept beside a dive, and covered in a picture."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mask_file import mask_file
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import (
    CameraMasks,
    ViewMask,
    parse_masks,
    read_masks,
    write_masks,
)

CLOCK = ViewMask(((0.7, 0.0, 0.3, 0.1),))


@given(
    st.sets(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=30),
    st.sampled_from([(271, 360), (1024, 1360), (1080, 1920), (480, 640)]),
)
def test_cells_that_are_masked_are_the_patches_that_are_masked(cells, size):
    wanted = np.zeros((10, 10), bool)
    for row, col in cells:
        wanted[row, col] = not (2 <= row < 8 and 2 <= col < 8)
    mask = ViewMask.of_cells(wanted)
    high, wide = DEFAULT_GRID.resized(*size)
    np.testing.assert_array_equal(mask.patches(DEFAULT_GRID, high, wide), wanted)
    both = CameraMasks(mask if mask.boxes else None, CLOCK)
    assert CameraMasks.from_json(json.loads(json.dumps(both.to_json()))) == both


def test_a_box_is_of_parts_of_pixels_or_of_one_camera():
    assert parse_masks(["0.7,0,0.3,0.1"]) == CameraMasks(CLOCK, CLOCK)
    assert parse_masks(["left:0.7, 0, .3, 0.1"]) == CameraMasks(CLOCK, None)
    in_pixels = parse_masks(["right:952,0,408,102@1360x1020"])
    assert in_pixels.left is None and in_pixels.right == CLOCK
    both = parse_masks(["0.7,0,0.3,0.1", "left:0,0.9,0.2,0.1"])
    assert both.right == CLOCK and both.left is not None and len(both.left.boxes) == 2
    assert parse_masks(["none"]) == CameraMasks() and not parse_masks([])
    assert parse_masks(["model"], [CameraMasks(CLOCK)]) == CameraMasks(CLOCK)


def test_a_picture_masks_what_is_white_in_it(tmp_path):
    rim = np.full((270, 480), 255, np.uint8)
    cv2.circle(rim, (240, 135), 130, 0, -1)
    cv2.imwrite(str(tmp_path / "rim.png"), rim)
    mask = parse_masks([str(tmp_path / "rim.png")]).left
    assert mask is not None
    found = mask.pixels(270, 480)
    assert found[rim > 0].all(), "what is white is masked"
    assert found[rim == 0].mean() < 0.05, "and hardly more"
    assert len(json.dumps(CameraMasks(mask).to_json())) < 10_000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0,0,1,1", "At most 80 %"),
        ("0.25,0.25,0.5,0.5", "of its middle"),
        ("0,0,1,0.82", "of its middle"),
        ("0.5,0.5,0.6,0.1", "0 to 1"),
        ("0.2,0.2,0,0.1", "0 to 1"),
        ("952,0,408,102", "0 to 1"),
        ("1,1,2,2@0x5", "has pixels"),
        ("clock", "a mask is a picture"),
        ("missing.png", "missing.png"),
        ("missing.json", "missing.json"),
        ("model", "nothing was masked"),
    ],
)
def test_what_is_no_mask_is_refused_in_one_line(text, words):
    refuses(words, parse_masks, [text])


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "{}", '{"format": 2}', '{"format": 1, "up": []}'),
        '{"format": 1, "left": [[0, 0, 1]]}',
        '{"format": 1, "left": [["a", 0, 1, 1]]}',
        '{"format": 1, "left": [[NaN, 0, 0.1, 0.1]]}',
    ],
)
def test_a_file_that_is_no_mask_stops_the_dive_from_being_opened(own_tiny, text):
    mask_file(own_tiny.path).write_text(text)
    refuses("tokt-mask.json", open_mission, own_tiny.path)


def test_stripes_that_touch_each_patch_are_refused():
    stripes = [f"{at / 10 + 0.02},0,0.03,1" for at in range(10)]
    refuses("covers 100 % of the view", parse_masks, stripes)


def test_yesterdays_file_is_read(tmp_path):
    (tmp_path / "a_1.png").write_bytes(cv2.imencode(".png", np.zeros((9, 9), np.uint8))[1])
    text = '{"format": 1, "left": [[0.7, 0.0, 0.3, 0.1]], "right": [[0, 0.5, 0.25, 0.5]]}'
    (tmp_path / "tokt-mask.json").write_text(text)
    masks = open_mission(tmp_path).masks
    assert masks == CameraMasks(CLOCK, ViewMask(((0.0, 0.5, 0.25, 0.5),)))


def test_a_dive_keeps_its_mask_beside_its_frames(tmp_path):
    folder, video = tmp_path / "dive", tmp_path / "dive.mp4"
    folder.mkdir()
    video.write_bytes(b"")
    for place in (folder, video):
        assert not read_masks(place)
        write_masks(place, CameraMasks(CLOCK))
        assert read_masks(place) == CameraMasks(CLOCK)
        write_masks(place, CameraMasks())
        assert not mask_file(place).exists()
    refuses("cannot write", write_masks, video / "dive.mp4", CameraMasks(CLOCK))


@pytest.mark.parametrize("channels", [1, 3])
def test_what_is_masked_is_covered_and_nothing_else_is_touched(channels):
    rng = np.random.default_rng(1)
    fall = np.linspace(20, 90, 1360)[None] + np.linspace(0, 40, 1024)[:, None]
    picture = (fall + rng.normal(0, 2, fall.shape)).astype(np.uint8)
    if channels == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    clean = picture.copy()
    cv2.putText(picture, "12:07:31", (1000, 70), cv2.FONT_HERSHEY_SIMPLEX, 2, (255,) * 3, 5)
    before, covered = picture.copy(), CLOCK.cover(picture)
    hidden = CLOCK.pixels(1024, 1360)
    np.testing.assert_array_equal(picture, before)
    np.testing.assert_array_equal(covered[~hidden], before[~hidden])
    # The water that the clock hid, within its noise and a few levels.
    difference = np.abs(covered[hidden].astype(float) - clean[hidden])
    assert np.quantile(difference, 0.99) < 16 and difference.mean() < 6


def test_a_patch_of_which_an_edge_is_masked_is_view():
    grid = Grid(10, 10, 360)
    some = ViewMask(((0.7, 0.0, 0.3, 0.105),)).patches(grid, 271, 360)
    assert some.sum() == 3 and some[0, 7:].all()
    more = ViewMask(((0.695, 0.0, 0.305, 0.13),)).patches(grid, 271, 360)
    assert more[1, 7:].all() and not more[0, 6]
