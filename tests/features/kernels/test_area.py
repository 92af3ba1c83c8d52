"""Resized gray pictures against OpenCV's, bit for bit."""

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tokt.features.kernels.dispatch import Kernels
from tokt.features.kernels.numpy_pictures import SUMS_AS_X86, is_area_sum, summed_as_x86

from .drawn import Image, examples, paint, painted
from .each_kernel import COMPILED_KERNELS, fast, needs_compiled

# Reductions p/q with even p: weights are multiples of 1/p, so that many sums of whole grey levels
# lie in the middle between two. 34/9 is the mission's, from 1360 to 360 pixels.
TIES = ((4, 3), (8, 3), (8, 5), (10, 3), (16, 5), (34, 9), (7, 2), (3, 2))
SIDES = st.integers(3, 60) | st.integers(3, 1500)


def opencv(frame: Image, height: int, width: int) -> Image:
    """Resized by area, as on x86, unless it has that size, then gray."""
    if not SUMS_AS_X86 and is_area_sum(frame.shape, height, width):
        frame = np.rint(summed_as_x86(frame, height, width)).astype(np.uint8)
    elif frame.shape[:2] != (height, width):
        frame = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY))


def check(kernels: Kernels, frame: Image, height: int, width: int, threads: int = 1) -> None:
    before = frame.copy()
    found = kernels.resized_gray(frame, height, width, threads)
    assert found.dtype == np.uint8 and found.shape == (height, width)
    assert np.array_equal(found, opencv(frame, height, width))
    deep, plain = kernels.resized_grays(frame, height, width, threads)
    assert np.array_equal(plain, found)
    assert np.array_equal(deep, kernels.resized_gray16(frame, height, width))
    assert np.array_equal(frame, before)


@st.composite
def targets(draw: st.DrawFn, side: int) -> int:
    """Pixels to resize a side to: fewer, a whole fraction, the same, or more."""
    return draw(
        st.integers(1, side)
        | st.integers(-(-side // 8), side)
        | st.sampled_from((side, max(1, side // 2), max(1, side // 3), max(1, side // 4)))
        | st.integers(side, 2 * side)
    )


@pytest.mark.skipif(not SUMS_AS_X86, reason="OpenCV adds up in another order here")
@examples(200)
@given(data=st.data())
def test_what_other_processors_add_up_is_what_opencv_gives_on_x86(data):
    high, wide = data.draw(SIDES), data.draw(SIDES)
    height, width = data.draw(st.integers(1, high)), data.draw(st.integers(1, wide))
    assume(is_area_sum((high, wide), height, width))
    frame = data.draw(painted((high, wide, *data.draw(st.sampled_from(((), (3,)))))))
    sums = summed_as_x86(frame, height, width)
    for picture, expected in ((frame, np.rint(sums)), (frame.astype(np.float32), sums)):
        resized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        assert np.array_equal(expected, resized)


@fast
@examples(200)
@given(data=st.data())
def test_any_size(kernels, data):
    high, wide = data.draw(SIDES), data.draw(SIDES)
    if data.draw(st.booleans()):  # whole scales, 2x and 4x among them
        factor = data.draw(st.integers(1, 5)), data.draw(st.integers(1, 5))
        height, width = max(1, high // factor[0]), max(1, wide // factor[1])
        high, wide = height * factor[0], width * factor[1]
    else:
        height, width = data.draw(targets(high)), data.draw(targets(wide))
    frame = data.draw(painted((high, wide, *data.draw(st.sampled_from(((), (3,)))))))
    check(kernels, frame, height, width, data.draw(st.integers(1, 3)))


@fast
@pytest.mark.parametrize("depth", [(), (3,)])
@pytest.mark.parametrize("down", TIES)
@pytest.mark.parametrize("across", TIES)
def test_sums_halfway_between_two_grey_levels(kernels, down, across, depth):
    """Stripes and noise of two neighbouring levels, and noise of all levels."""
    shape = down[0] * 7, across[0] * 11, *depth
    height, width = down[1] * 7, across[1] * 11
    rng = np.random.default_rng(down[0] * across[0])
    for level in (0, 1, 127, 254):
        noise = level + (rng.random(shape) < 0.5)
        rows = np.broadcast_to(level + (rng.random((shape[0], 1, *depth)) < 0.5), shape)
        columns = np.broadcast_to(level + (rng.random((1, shape[1], *depth)) < 0.5), shape)
        for frame in (noise, rows, columns, rng.integers(0, 256, shape)):
            check(kernels, frame.astype(np.uint8), height, width)


@fast
@pytest.mark.parametrize("size", [(1500, 2000), (2000, 700), (700, 3000)])
@pytest.mark.parametrize("target", [(3, 4), (1, 1), (11, 60)])
def test_reductions_by_hundreds(kernels, size, target):
    """Rounding adds up over so many pixels, and differently in each order of adding."""
    rng = np.random.default_rng(5)
    for level in (128, 254):
        check(kernels, (level + (rng.random(size) < 0.5)).astype(np.uint8), *target)
    for grey in (255, 254):
        check(kernels, np.full(size, grey, np.uint8), *target)


@fast
@pytest.mark.parametrize("first", range(0, 1 << 24, 1 << 20))
def test_every_colour(kernels, first):
    """Each colour as three rows that become two: a reduction, in which it stays what it is."""
    packed = np.arange(first, first + (1 << 20), dtype="<u4").view(np.uint8).reshape(1024, 1024, 4)
    colours = np.ascontiguousarray(packed[:, :, :3])
    found = kernels.resized_gray(colours.repeat(3, axis=0), 2048, 1024)
    expected = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    assert np.array_equal(found, expected.repeat(2, axis=0))


@fast
@pytest.mark.parametrize("depth", [(), (3,)])
def test_any_layout(kernels, depth):
    whole = paint("noise", (85, 97, *depth), 8, 0, 0)
    read_only = whole.copy()
    read_only.flags.writeable = False
    views: list[Any] = [
        *(np.asfortranarray(whole), whole.swapaxes(0, 1), read_only),
        *(whole[::-1], whole[:, ::-1], whole[::2, ::2], whole[3:80, 5:90]),
        np.broadcast_to(whole[4], (60, 97, *depth)),
    ]
    if depth:
        views += [whole[:, :, ::-1], np.moveaxis(np.moveaxis(whole, 2, 0).copy(), 0, 2)]
    for view in views:
        found = kernels.resized_gray(view, 19, 23)
        assert np.array_equal(found, opencv(np.array(view, order="C"), 19, 23))


@needs_compiled
@pytest.mark.mission
@pytest.mark.parametrize("camera", ["Left", "Right"])
def test_mission_frames(camera, mission):
    paths = sorted((mission / camera).iterdir())[::20]  # `tokt bench --mission` compares them all
    assert paths
    for path in paths:
        for flag in (cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE):
            frame = cv2.imread(str(path), flag)
            assert frame is not None, path.name
            frame = np.asarray(frame, np.uint8)
            height, width = frame.shape[:2]
            check(COMPILED_KERNELS, frame, height * 360 // width, 360)
