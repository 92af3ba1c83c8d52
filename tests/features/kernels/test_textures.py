"""Edges, gradients, boxes, lines, patterns at whole pixels: all kernels give the same numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid

from .drawn import examples, painted, pictures
from .each_kernel import REFERENCE, THREADS, fast

ONE = Grid(1, 1, None)
DEEPEST = 255 * 256  # steps of a 16-bit gray picture
POWERS = (2, 4, 8, 16, 32, 64)


@fast
@examples(60)
@given(drawn=pictures(8_000), threads=THREADS)
def test_structure(kernels, drawn, threads):
    found = kernels.structure_sums(*drawn, threads)
    assert found.dtype == np.int64 and found.shape == (drawn[1].n_patches, 3)
    assert np.array_equal(found, REFERENCE.structure_sums(*drawn))


@fast
@examples(80)
@given(
    drawn=pictures(8_000),
    box=st.integers(0, 7).map(lambda half: 2 * half + 1),
    below=st.sampled_from((0, 3, 255)),
    seed=st.integers(0, 99),
    threads=THREADS,
)
def test_gradients(kernels, drawn, box, below, seed, threads):
    """Whole levels, with noise of some of the 256 steps between them or with none."""
    noise = np.random.default_rng(seed).integers(0, below, drawn[0].shape, endpoint=True)
    gray16 = np.minimum(256 * drawn[0].astype(np.int64) + noise, DEEPEST).astype(np.uint16)
    found = kernels.gradient_sums(gray16, drawn[1], box, threads)
    assert found.dtype == np.int64 and found.shape == (drawn[1].n_patches, 3)
    assert np.array_equal(found, REFERENCE.gradient_sums(gray16, drawn[1], box))


def gradients_by_definition(gray16, grid, box):
    """Pixel by pixel: each mean from a list, each bucket from its octave and eighth."""
    height, width = gray16.shape
    reach, area = box // 2, box * box

    def mean(y, x):
        rows = [min(max(y + move, 0), height - 1) for move in range(-reach, reach + 1)]
        columns = [min(max(x + move, 0), width - 1) for move in range(-reach, reach + 1)]
        return (int(gray16[np.ix_(rows, columns)].astype(int).sum()) + area // 2) // area

    for top, bottom, left, right in grid.boxes(height, width).tolist():
        across, down, buckets = 0, 0, []
        for y in range(top, bottom):
            for x in range(left, right):
                gx = mean(y, x + 1) - mean(y, x - 1) if 0 < x < width - 1 else 0
                gy = mean(y + 1, x) - mean(y - 1, x) if 0 < y < height - 1 else 0
                across, down = across + gx * gx, down + gy * gy
                octave = 1
                while 2 * octave <= gx * gx + gy * gy:
                    octave *= 2
                eighths = 8 * (gx * gx + gy * gy) // octave
                buckets.append(eighths * octave // 8)
        enough = (
            edge
            for edge in sorted(set(buckets))
            if 20 * sum(other <= edge for other in buckets) >= 19 * len(buckets)
        )
        yield [across, down, next(enough)]


@fast
@pytest.mark.parametrize("box", [1, 3, 7, 15])
@pytest.mark.parametrize("steps", [1, 2, 6, 300, DEEPEST])
def test_gradients_by_their_definition(kernels, box, steps):
    """From pictures of steps 0 and 1 to those of all levels; two rows and a column are left."""
    gray16 = np.random.default_rng(box).integers(0, steps, (14, 19), np.uint16, endpoint=True)
    grid = Grid(3, 2, None)
    expected = list(gradients_by_definition(gray16, grid, box))
    assert kernels.gradient_sums(gray16, grid, box).tolist() == expected


@fast
def test_the_largest_gradients_fit(kernels):
    """Both ways at each pixel but the outermost, also beyond what `resized_gray16` gives."""
    bright = np.array([0, 0, 1, 1] * 10) == 1
    for level in (DEEPEST, 65_535):
        gray16 = np.where(bright[:, None] ^ bright, level, 0).astype(np.uint16)
        found = kernels.gradient_sums(gray16, ONE, 1)
        assert found.tolist() == [[38 * 40 * level**2] * 2 + [(1 << 32) * 15 // 8]]
        assert not kernels.gradient_sums(np.full_like(gray16, level), ONE, 15).any()


@fast
def test_more_rows_of_gradients_than_fit_53_bits(kernels):
    gray16 = np.zeros((2_200_001, 3), np.uint16)
    gray16[:, 2] = 65_535
    found = kernels.gradient_sums(gray16, ONE, 1)
    assert found.tolist() == [[2_200_001 * 65_535**2, 0, (1 << 31) * 15 // 8]]


@st.composite
def ranges(draw, length):
    """Ranges that may overlap and stand in any order, or equal parts, as callers have them."""
    if draw(st.booleans()):
        ends = np.linspace(0, length, min(draw(st.integers(1, 9)), length) + 1).astype(np.int64)
        return np.stack([ends[:-1], ends[1:]], axis=1)
    pairs = st.tuples(st.integers(0, length - 1), st.integers(1, length))
    drawn = draw(st.lists(pairs, min_size=1, max_size=9))
    return np.array([(min(pair), max(pair[1], pair[0] + 1)) for pair in drawn], np.int64)


@fast
@examples(80)
@given(data=st.data(), threads=THREADS)
def test_boxes(kernels, data, threads):
    height, width = (data.draw(st.integers(1, 40) | st.integers(1, 300)) for _ in range(2))
    frame = data.draw(painted((height, width, *data.draw(st.sampled_from(((), (3,)))))))
    rows, columns = data.draw(ranges(height)), data.draw(ranges(width))
    found = kernels.box_sums(frame, rows, columns, threads)
    assert found.dtype == np.int64
    assert found.shape == (len(rows), len(columns), 3 if frame.ndim == 3 else 1)
    assert np.array_equal(found, REFERENCE.box_sums(frame, rows, columns))


@fast
@pytest.mark.parametrize("shape", [(4_000, 3_000, 3), (100_000, 2), (2, 100_000)])
def test_one_box_over_a_large_white_frame(kernels, shape):
    """Its sums need more than 31 bits, or more rows than sums fit 16 bits."""
    whole = [np.array([[0, side]]) for side in shape[:2]]
    found = kernels.box_sums(np.full(shape, 255, np.uint8), *whole)
    assert found.tolist() == [[[255 * shape[0] * shape[1]] * (3 if len(shape) == 3 else 1)]]


@fast
def test_boxes_in_any_layout(kernels):
    """Rows and columns cut out of another array, and a frame of colours in another order."""
    frame = random(3, (20, 30, 3), np.uint8)[:, :, ::-1]
    both = np.array([[0, 4, 5, 20], [3, 17, 0, 30]])
    found = kernels.box_sums(frame, both[:, :2], both[:, 2:])
    assert np.array_equal(found, REFERENCE.box_sums(frame, both[:, :2], both[:, 2:]))


@fast
@pytest.mark.parametrize(
    "odd",
    [
        *(None, [[0, 1]], np.zeros((0, 2), np.int64), np.array([0, 1]), np.array([[0, 1, 2]])),
        *(np.array([[0, 1]], dtype) for dtype in (np.int32, np.uint64, np.float64)),
        *(
            np.array([[0, 5], pair])
            for pair in ((-1, 3), (3, 3), (4, 3), (0, 10), (2**62, 2**63 - 1))
        ),
    ],
)
def test_ranges_that_are_not_possible(kernels, odd):
    frame, right = np.zeros((9, 9), np.uint8), np.array([[0, 9]])
    kernels.box_sums(frame, right, right)
    for rows, columns in ((odd, right), (right, odd)):
        with pytest.raises((TypeError, ValueError), match="range"):
            kernels.box_sums(frame, rows, columns)


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


PLAIN, DEEP = np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint16)


@fast
def test_pictures_and_options_that_are_not_possible(kernels):
    for shape in ((9, 9, 3), (0, 9), (9, 0), (2, 9)):
        with pytest.raises((TypeError, ValueError, ToktError)):
            kernels.gradient_sums(np.zeros(shape, np.uint16), ONE, 3)
    for picture in (PLAIN, np.zeros((9, 9)), None):
        with pytest.raises((TypeError, ValueError)):
            kernels.gradient_sums(picture, ONE, 3)
    for box in (0, 2, -1, 17, 3.0, True, None, "3"):
        with pytest.raises(ValueError, match="a box is an odd number"):
            kernels.gradient_sums(DEEP, ONE, box)
    for samples in ((), (1,), (3,), (8, 4), (4, 4), (128,), (8.0,), "8"):
        with pytest.raises((TypeError, ValueError)):
            kernels.line_sums(PLAIN, ONE, 128, samples)
    for middle in (-1, 256, 1.0, None):
        with pytest.raises(ValueError, match="middle"):
            kernels.line_sums(PLAIN, ONE, middle, (2,))


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
