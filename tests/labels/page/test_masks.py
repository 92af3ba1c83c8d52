"""The mask that is drawn: exactly the patches that were meant, on any grid and size of frame."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import ViewMask
from tokt.labels.page.masks import drawn_mask

SIZES = (360, 272), (1360, 1024), (360, 279), (1920, 1080), (751, 499), (352, 288)


@st.composite
def _cases(draw):
    grid = Grid(draw(st.integers(3, 40)), draw(st.integers(3, 60)))
    n = grid.n_patches
    wanted = draw(st.lists(st.sets(st.integers(0, n - 1), max_size=n // 3), min_size=1, max_size=3))
    return grid, draw(st.sampled_from(SIZES)), wanted


@settings(max_examples=scaled(60), deadline=None)
@given(_cases())
def test_what_is_masked_is_what_was_drawn_one_mask_after_the_other(case):
    grid, size, drawn = case
    middle = grid.rows // 4, grid.cols // 4
    finer = ViewMask(((0.013, 0.021, 0.2, 0.013), (0.0, 0.0, 0.004, 1.0)))
    mask = finer
    for cells in drawn:
        patches = np.zeros((grid.rows, grid.cols), bool)
        patches.flat[list(cells)] = True
        patches[middle[0] : -middle[0] or None, middle[1] : -middle[1] or None] = False
        mask = drawn_mask(mask, grid, patches, size)
        found = (
            mask.patches(grid, *grid.resized(*reversed(size))) if mask else np.zeros_like(patches)
        )
        assert np.array_equal(found, patches)


def test_nothing_is_masked_where_all_is_freed():
    grid = Grid()
    patches = np.zeros((10, 10), bool)
    assert drawn_mask(None, grid, patches, (360, 272)) is None
    patches[0, 7:] = True
    mask = drawn_mask(None, grid, patches, (360, 272))
    assert len(mask.boxes) == 1
    assert drawn_mask(mask, grid, patches, (360, 272)) == mask
    assert drawn_mask(mask, grid, np.zeros((10, 10), bool), (360, 272)) is None


def test_a_patch_at_the_edge_takes_the_strip_beside_it_along():
    patches = np.zeros((10, 10), bool)
    patches[9, 9] = True
    mask = drawn_mask(None, Grid(), patches, (360, 279))
    assert mask.pixels(279, 360)[243:, 324:].all()
