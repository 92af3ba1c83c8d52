"""Textures at half the width: the same features, of means of 2x2 pixels within each patch."""

import gc
import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.spec import build_extractor, extractor_summary
from tokt.features.extractors.textures import NEAREST, Half, Join, Lbp, Lines
from tokt.features.extractors.water import Colour, Gradients, PatchPlace, Relative
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

IMAGE = Quantization(8, 64, 3, 21)
PART = Join([Lbp(8, 2, "frame", IMAGE, NEAREST), Lines((2, 4), IMAGE), Gradients((1, 3))])


def some_frame(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)


def half(part):
    return {"name": "half", "version": 1, "part": part}


def test_features_are_those_of_the_picture_of_means():
    frame, grid = some_frame(300, 410), Grid(4, 5, 120)
    height, width = grid.patch_size(*grid.resized(*frame.shape[:2]))
    assert (height, width) == (21, 24)
    gray16 = KERNELS.resized_gray16(frame, *grid.resized(*frame.shape[:2]))
    patches = gray16[: 4 * height].reshape(4, height, 5, width)[:, :20]
    means = patches.reshape(4, 10, 2, 5, 12, 2).mean(axis=(2, 5))
    small = np.floor(means + 0.5).astype(np.uint16).reshape(40, 60)
    assert np.array_equal(FramePictures(frame, grid).halved.gray16, small)
    counts = KERNELS.lbp_nearest_counts(KERNELS.quantize(small, IMAGE), grid, 8, 2, "frame")
    sums = KERNELS.gradient_sums(small, grid, 1)
    found = Half(PART).describe(frame, grid)
    assert found.shape == (20, PART.dim)
    assert np.array_equal(found[:, :10], counts / 120.0)
    assert np.array_equal(np.argsort(found[:, -6]), np.argsort(sums[:, 0]))


@given(st.integers(7, 12), st.integers(7, 12), st.integers(0, 9))
def test_of_odd_patches_the_last_row_or_column_says_nothing(height, width, seed):
    grid = Grid(3, 4, 4 * width)
    frame = some_frame(3 * height, 4 * width, seed)
    other = frame.copy()
    for axis, side in ((0, height), (1, width)):
        if side % 2:
            last = np.moveaxis(other, axis, 0)[side - 1 :: side]
            last[:] = 255 - last
    one, two = (Half(PART).describe(each, grid) for each in (frame, other))
    assert np.array_equal(one, two)
    assert np.isfinite(one).all()


def test_a_part_is_built_from_its_spec_and_may_stand_in_others():
    whole = Relative([Half(PART)], 0.3)
    again = build_extractor(whole.spec)
    assert again.spec == whole.spec
    assert again.names == whole.names
    assert all(".half." in f".{name}" for name in whole.names)
    frame = some_frame(90, 120)
    assert np.array_equal(
        again.describe(frame, Grid(3, 4, 60)), whole.describe(frame, Grid(3, 4, 60))
    )
    assert extractor_summary(Half(PART).spec).endswith("at half the width")


def test_plain_pictures_are_the_means_in_whole_levels():
    frame, grid, plain = some_frame(280, 360), Grid(10, 10), Lbp(8, 1, "patch")
    gray16 = KERNELS.resized_gray16(frame, 280, 360)
    means = gray16.reshape(140, 2, 180, 2).mean(axis=(1, 3))
    levels = np.floor(np.floor(means + 0.5) / 256 + 0.5).astype(np.uint8)
    counts = KERNELS.lbp_counts(levels, grid, 8, 1, "patch")
    assert np.array_equal(Half(plain).describe(frame, grid), counts / (14.0 * 18))


@pytest.mark.parametrize("part", [Colour(6), PatchPlace()])
def test_colours_and_places_are_the_whole_frames(part):
    frame, grid = some_frame(305, 360), Grid(10, 10)
    assert np.array_equal(Half(part).describe(frame, grid), part.describe(frame, grid))
    assert Half(part).needs_colour == part.needs_colour


def test_halves_of_halves_are_refused():
    refuses("half", build_extractor, half(half(Gradients((1,)).spec)))


def test_pictures_go_with_the_frame_that_they_were_made_of():
    frame = some_frame(90, 120)
    gc.disable()
    try:
        known = weakref.ref(pictures := FramePictures(frame, Grid(3, 4, 60)).halved)
        del pictures
        assert known() is None
    finally:
        gc.enable()
