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


def random(seed, shape, dtype=np.uint64):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


@fast
@examples(60)
@given(
    size=st.tuples(st.integers(1, 9), st.integers(8, 300)),
    pieces=st.integers(1, 4),
    lag=st.integers(1, 20),
    largest=st.integers(1, 255),
    spread=st.sampled_from((2, 20, 255)),
    seed=st.integers(0, 99),
)
def test_marks_of_rows(kernels, size, pieces, lag, largest, spread, seed):
    gray = random(seed, size, np.uint8) % spread
    weights = random(seed, (min(pieces, size[1] // 8), max(size[1] // 8 // pieces, 1)))
    hashes, signs = kernels.row_marks(gray, weights, lag, largest)
    expected = REFERENCE.row_marks(gray, weights, lag, largest)
    assert hashes.dtype == signs.dtype == np.uint64
    assert signs.shape == (2, len(gray), max(size[1] - lag, 0) // 64)
    assert np.array_equal(hashes, expected[0]) and np.array_equal(signs, expected[1])
    assert not (signs[0] & signs[1]).any()


@fast
@examples(40)
@given(
    shape=st.tuples(st.integers(0, 5), st.integers(1, 5), st.integers(0, 4)),
    seed=st.integers(0, 99),
)
def test_counts_of_signs(kernels, shape, seed):
    others = random(seed, (shape[0], 2, *shape[1:]))
    signs = random(seed + 1, (2, *shape[1:]))
    found = kernels.sign_counts(signs, others)
    assert found.dtype == np.int64 and found.shape == (shape[0], 2)
    assert np.array_equal(found, REFERENCE.sign_counts(signs, others).reshape(-1, 2))


@fast
def test_marks_that_do_not_fit_the_picture(kernels):
    gray, weights = np.zeros((3, 30), np.uint8), random(1, (1, 3))
    kernels.row_marks(gray, weights, 2, 8)
    for odd in (weights[0], weights[:, :0], random(1, (2, 2)), weights.view(np.int64)):
        with pytest.raises(ValueError, match="weights of words"):
            kernels.row_marks(gray, odd, 2, 8)
    with pytest.raises(ValueError, match="weights of words"):
        kernels.row_marks(gray, random(1, (3, 2))[:, :1], 2, 8)  # not in C order
    signs = random(2, (2, 3, 4))
    for odd in (signs, signs[None, :1], random(2, (1, 2, 3, 5)), signs[None].view(np.int64)):
        with pytest.raises(ValueError, match="signs are"):
            kernels.sign_counts(signs, odd)
