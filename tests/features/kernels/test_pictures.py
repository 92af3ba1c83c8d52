"""16-bit gray pictures, their levels and how often they occur: all kernels give the same bits."""

from fractions import Fraction
from math import ceil, floor

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.kernels.quantization import DIFFERENCE, FRAME, RATIO, Quantization

from .drawn import Image, examples, paint, painted, pictures
from .each_kernel import REFERENCE, THREADS, fast

SIDES = st.integers(1, 40) | st.integers(1, 300)


@st.composite
def recipes(draw: st.DrawFn) -> Quantization:
    return Quantization(
        draw(st.sampled_from((1, 8, 0.3, 1024.0)) | st.floats(1e-3, 64)),
        draw(st.integers(8, 256)),
        draw(st.sampled_from((1, 1, 3, 5, 255))),
        draw(st.just(0) | st.integers(1, 127).map(lambda half: 2 * half + 1)),
        draw(st.sampled_from((DIFFERENCE, RATIO, FRAME))),
    )


@fast
@examples(100)
@given(data=st.data(), threads=THREADS)
def test_any_size(kernels, data, threads):
    """Smaller and larger pictures of gray and colour frames."""
    shape = (data.draw(SIDES), data.draw(SIDES), *data.draw(st.sampled_from(((), (3,)))))
    height, width = data.draw(SIDES), data.draw(SIDES)
    frame = data.draw(painted(shape))
    found = kernels.resized_gray16(frame, height, width, threads)
    assert found.dtype == np.uint16 and found.shape == (height, width)
    assert np.array_equal(found, REFERENCE.resized_gray16(frame, height, width))


def exact_pixel(frame: Image, height: int, width: int, row: int, column: int) -> int:
    """A 16-bit gray picture's pixel by its definition, in fractions."""
    gray = (frame.astype(int) @ (1868, 9617, 4899)).tolist()
    down, across = Fraction(len(frame), height), Fraction(frame.shape[1], width)
    total = Fraction(0)
    for y in range(floor(row * down), ceil((row + 1) * down)):
        high = min(y + 1, (row + 1) * down) - max(y, row * down)
        for x in range(floor(column * across), ceil((column + 1) * across)):
            wide = min(x + 1, (column + 1) * across) - max(x, column * across)
            total += gray[y][x] * high * wide
    return int(total / (down * across) * 256 / 16384 + Fraction(1, 2))


@fast
@pytest.mark.parametrize(("height", "width"), [(5, 7), (11, 3), (20, 23), (1, 1)])
def test_the_definition(kernels, height, width):
    frame = paint("noise", (13, 17, 3), 3, 0, 0)
    found = kernels.resized_gray16(frame, height, width)
    for row, column in np.ndindex(height, width):
        assert found[row, column] == exact_pixel(frame, height, width, row, column)


@fast
@pytest.mark.parametrize("size", [(1024, 1360), (480, 640), (300, 361)])
def test_near_opencv_on_floats(kernels, size):
    """OpenCV's own rounding of weights to single precision is all that is added."""
    frame = paint("noise", (*size, 3), 5, 0, 0)
    height, width = size[0] * 271 // 1024, 360
    small = cv2.resize(frame.astype(np.float64), (width, height), interpolation=cv2.INTER_AREA)
    gray = small @ np.array((1868, 9617, 4899)) / 16384
    assert np.abs(kernels.resized_gray16(frame, height, width) / 256 - gray).max() <= 1 / 256


@fast
def test_frames_too_large_for_32_bits(kernels):
    frame = np.full((2900, 2910), 255, np.uint8)
    frame[::2] = 254
    found = kernels.resized_gray16(frame, 29, 10)
    assert (found == 254.5 * 256).all()


@fast
@examples(100)
@given(data=st.data(), levels=recipes(), threads=THREADS)
def test_levels(kernels, data, levels, threads):
    """Boxes larger than the picture among them."""
    height, width = data.draw(SIDES), data.draw(SIDES)
    frame = data.draw(painted((height, width, 3)))
    gray16 = REFERENCE.resized_gray16(frame, height, max(1, width // 2))
    sums = kernels.summed_area(gray16)
    assert sums.dtype == np.uint32 and np.array_equal(sums, REFERENCE.summed_area(gray16))
    found = kernels.quantize(gray16, levels, threads, sums)
    assert np.array_equal(found, kernels.quantize(gray16, levels))
    assert found.dtype == np.uint8 and found.max() < levels.levels
    assert np.array_equal(found, REFERENCE.quantize(gray16, levels))


@fast
@pytest.mark.parametrize("side", [181, 183, 255])
def test_the_largest_boxes_of_a_saturated_picture(kernels, side):
    gray16 = np.full((260, 260), 255 * 256, np.uint16)
    assert (kernels.quantize(gray16, Quantization(1, 256, side)) == 255).all()
    assert (kernels.quantize(gray16, Quantization(8, 256, 1, side)) == 128).all()


@fast
@pytest.mark.parametrize("by", [DIFFERENCE, RATIO, FRAME])
def test_levels_by_their_definition(kernels, by):
    gray16 = 256 * paint("gradient", (12, 15), 14, 3, 0).astype(np.uint16)
    gray16 += np.random.default_rng(2).integers(0, 256, gray16.shape, np.uint16)

    def mean(y: int, x: int, side: int) -> float:
        half = side // 2
        box = gray16[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        return float(box.mean()) / 256

    for y, x in np.ndindex(gray16.shape):
        around = mean(y, x, 7)
        apart = mean(y, x, 3) - around
        if by == RATIO:
            apart *= 32 / max(around, 4)
        if by == FRAME:
            apart *= 20 / (gray16.mean() / 256)
        exact = apart * 5 * 64 / 256 + 32 + 0.5
        level = int(kernels.quantize(gray16, Quantization(5, 64, 3, 7, by))[y, x])
        assert level == min(max(np.floor(exact), 0), 63) or abs(exact - round(exact)) < 1e-9


@fast
def test_no_gray16_picture(kernels):
    wrong = [np.zeros((3, 4), kind) for kind in (np.uint8, np.float64)]
    wrong += [np.zeros(shape, np.uint16) for shape in ((3, 4, 3), (0, 4))]
    for gray16 in (*wrong, None):
        with pytest.raises((TypeError, ValueError)):
            kernels.quantize(gray16, Quantization(1))


@fast
@examples(60)
@given(drawn=pictures(), threads=THREADS)
def test_level_counts(kernels, drawn, threads):
    gray, grid = drawn
    found = kernels.level_counts(gray, grid, threads)
    assert np.array_equal(found, REFERENCE.level_counts(gray, grid))
    assert found.dtype == np.int64
