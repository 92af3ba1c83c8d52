"""Edges, lines and patterns at whole pixels: all kernels give the same whole numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.frames.grid import Grid

from .drawn import examples, pictures
from .each_kernel import REFERENCE, THREADS, fast

ONE = Grid(1, 1, None)
POWERS = (2, 4, 8, 16, 32, 64)


@fast
@examples(60)
@given(drawn=pictures(8_000), threads=THREADS)
def test_structure(kernels, drawn, threads):
    found = kernels.structure_sums(*drawn, threads)
    assert found.dtype == np.int64 and found.shape == (drawn[1].n_patches, 3)
    assert np.array_equal(found, REFERENCE.structure_sums(*drawn))


@fast
@examples(40)
@given(
    drawn=pictures(3_000),
    middle=st.sampled_from((0, 128, 255)) | st.integers(0, 255),
    samples=st.lists(st.sampled_from(POWERS), min_size=1, max_size=3, unique=True).map(sorted),
    threads=THREADS,
)
def test_lines(kernels, drawn, middle, samples, threads):
    found = kernels.line_sums(*drawn, middle, samples, threads)
    assert found.dtype == np.int64 and found.shape == (drawn[1].n_patches, len(samples), 9)
    assert np.array_equal(found, REFERENCE.line_sums(*drawn, middle, samples))


@fast
@pytest.mark.parametrize(("level", "middle"), [(255, 0), (0, 255)])
def test_the_largest_sums_fit(kernels, level, middle):
    """Even pictures of the outermost level, more rows than sums of squares fit 32 bits."""
    gray = np.full((70, 150), level, np.uint8)
    found = kernels.line_sums(gray, ONE, middle, (64,))
    assert np.array_equal(found, REFERENCE.line_sums(gray, ONE, middle, (64,)))
    assert found[0, 0, 1:].max() > 1 << 36


@fast
def test_more_rows_of_edges_than_fit_32_bits(kernels):
    gray = np.zeros((40_000, 4), np.uint8)  # 255 squared times as many is above 2**31
    gray[:, 2:] = 255
    found = kernels.structure_sums(gray, ONE)
    assert found.tolist() == [[40_000 * 2 * 255**2, 0, 0]]


@fast
@examples(60)
@given(
    drawn=pictures(4_000),
    points=st.integers(1, 64),
    radius=st.integers(1, 16) | st.floats(0.1, 9),
    border=st.sampled_from(("patch", "frame")),
    threads=THREADS,
)
def test_nearest_patterns(kernels, drawn, points, radius, border, threads):
    found = kernels.lbp_nearest_counts(*drawn, points, radius, border, threads)
    assert found.dtype == np.int64
    assert np.array_equal(found, REFERENCE.lbp_nearest_counts(*drawn, points, radius, border))


@fast
def test_points_on_whole_pixels_are_those_of_version_1(kernels):
    """Four points at a whole radius lie on pixels either way."""
    gray = np.random.default_rng(4).integers(0, 9, (70, 90), np.uint8)
    for border in ("patch", "frame"):
        options = gray, Grid(2, 3, None), 4, 3, border
        nearest, between = kernels.lbp_nearest_counts(*options), kernels.lbp_counts(*options)
        assert np.array_equal(nearest, between)


@fast
@pytest.mark.parametrize("samples", [(), (1,), (3,), (8, 4), (4, 4), (128,), (8.0,), "8"])
def test_samples_that_are_not_possible(kernels, samples):
    with pytest.raises((TypeError, ValueError)):
        kernels.line_sums(np.zeros((9, 9), np.uint8), ONE, 128, samples)


@fast
@pytest.mark.parametrize("middle", [-1, 256, 1.0, None])
def test_a_middle_that_is_no_level(kernels, middle):
    with pytest.raises(ValueError, match="middle"):
        kernels.line_sums(np.zeros((9, 9), np.uint8), ONE, middle, (2,))
