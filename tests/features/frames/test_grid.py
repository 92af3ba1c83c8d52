import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID, Grid

grids = st.builds(
    Grid, rows=st.integers(1, 14), cols=st.integers(1, 14), width=st.none() | st.integers(42, 500)
)
sides = st.integers(1, 400)


def _resized(grid: Grid, height: int, width: int) -> tuple[int, int]:
    height, width = grid.resized(height, width)
    assume(height // grid.rows >= 3 and width // grid.cols >= 3)
    return height, width


def test_thesis_frame():
    height, width = DEFAULT_GRID.resized(1024, 1360)
    assert (width, height) == (360, 271)
    assert DEFAULT_GRID.patch_size(height, width) == (27, 36)
    assert DEFAULT_GRID.remainder(height, width) == (1, 0)
    assert DEFAULT_GRID.n_patches == 100
    boxes = DEFAULT_GRID.boxes(height, width)[[0, 11, 99]]
    assert boxes.tolist() == [[0, 27, 0, 36], [27, 54, 36, 72], [243, 270, 324, 360]]


@given(grids, sides, sides)
@settings(max_examples=scaled(150))
def test_patches_are_equal_disjoint_and_inside(grid, height, width):
    height, width = _resized(grid, height, width)
    boxes = grid.boxes(height, width)
    assert boxes.shape == (grid.n_patches, 4)
    covered = np.zeros((height, width), int)
    for y0, y1, x0, x1 in boxes:
        assert (y1 - y0, x1 - x0) == grid.patch_size(height, width)
        assert 0 <= y0 < y1 <= height and 0 <= x0 < x1 <= width
        covered[y0:y1, x0:x1] += 1
    assert covered.max() == 1
    below, beside = grid.remainder(height, width)
    assert 0 <= below < grid.rows and 0 <= beside < grid.cols
    assert covered[: height - below, : width - beside].all()
    assert not covered[height - below :].any() and not covered[:, width - beside :].any()


@given(grids, sides, sides, st.integers(0, 2**32 - 1))
@settings(max_examples=scaled(100))
def test_boxes_cells_and_paint_agree(grid, height, width, seed):
    height, width = _resized(grid, height, width)
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (height, width), np.uint8)
    values = rng.integers(0, 2, grid.n_patches).astype(bool)
    mask = grid.paint(values, height, width)
    assert mask.shape == image.shape and mask.dtype == np.uint8
    painted, boxes = np.zeros_like(mask), grid.boxes(height, width)
    for (y0, y1, x0, x1), cell, value in zip(boxes, grid.cells(image), values, strict=True):
        assert np.array_equal(image[y0:y1, x0:x1], cell)
        painted[y0:y1, x0:x1] = 255 if value else 0
    assert np.array_equal(mask, painted)


@given(grids)
def test_text_and_json_round_trips(grid):
    assert Grid.parse(str(grid)) == grid
    assert Grid.from_json(grid.to_json()) == grid


def test_text_forms():
    assert Grid.parse(" 10x10 ") == Grid(10, 10, 360)
    assert Grid.parse("1x1@native") == Grid(1, 1, None)
    assert str(Grid(4, 6, 120)) == "4x6@120"
    assert Grid(1, 1, None).resized(17, 31) == (17, 31)


@pytest.mark.parametrize(
    "text",
    [
        *("", "10", "10x", "x10", "10x10@", "0x5", "5x0", "-1x5", "10x10@0", "10x10@29"),
        *("10x10@big", "10 x 10", "1.5x2", "10x10@99999", "9" * 5000 + "x1"),
    ],
)
def test_refused_text(text):
    refuses("", Grid.parse, text)


json_values = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)


@given(
    st.dictionaries(st.sampled_from(["rows", "cols", "width", "x"]), json_values)
    | st.lists(json_values, max_size=3)
    | json_values
)
@settings(max_examples=scaled(200))
def test_json_is_read_exactly_or_refused(value):
    try:
        grid = Grid.from_json(value)
    except ToktError:
        return
    assert repr(grid.to_json()) == repr({key: value[key] for key in ("rows", "cols", "width")})


@pytest.mark.parametrize(
    "value", [{"rows": 10, "cols": 10.5, "width": 360}, {"rows": 1}, None, [1]]
)
def test_json_of_another_kind_is_refused(value):
    refuses("", Grid.from_json, value)


@pytest.mark.parametrize(("height", "width"), [(29, 360), (2, 360), (0, 360)])
def test_too_small_a_frame(height, width):
    grid = Grid(10, 10, 360)
    refuses("least is 3x3", grid.patch_size, height, width)
    refuses("", grid.boxes, height, width)
    refuses("", grid.cells, np.zeros((height, width), np.uint8))
