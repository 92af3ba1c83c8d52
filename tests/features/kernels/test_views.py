"""Views of a pair: resized, and with even contrast, as OpenCV does it, bit for bit."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.kernels.numpy_pictures import SUMS_AS_X86

from .drawn import Image, examples, painted
from .each_kernel import COMPILED_KERNELS, NUMPY_KERNELS, THREADS, fast, needs_compiled

SIDES = st.integers(1, 40) | st.integers(1, 300)


def levels(frame: Image, seed: int) -> np.ndarray:
    """A view of a gray frame's levels with fractions; dark parts of it stay black."""
    fractions = np.random.default_rng(seed).random(frame.shape)
    return np.where(frame > 2, frame + fractions - 1, frame).astype(np.float32)


@st.composite
def drawn_views(draw: st.DrawFn) -> np.ndarray:
    return levels(draw(painted((draw(SIDES), draw(SIDES)))), draw(st.integers(0, 99)))


def opencv(picture: np.ndarray, height: int, width: int) -> np.ndarray:
    """Gray, as floats, then resized."""
    gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    size = width, height
    return cv2.resize(gray.astype(np.float32), size, interpolation=cv2.INTER_AREA)


@pytest.mark.skipif(not SUMS_AS_X86, reason="OpenCV adds up in another order here")
@fast
@examples(200)
@given(data=st.data(), threads=THREADS)
def test_any_size(kernels, data, threads):
    shape = data.draw(SIDES), data.draw(SIDES)
    height, width = (data.draw(st.integers(1, side) | SIDES) for side in shape)
    if data.draw(st.booleans()):
        shape = 2 * height, 2 * width
    frame = data.draw(painted((*shape, *data.draw(st.sampled_from(((), (3,)))))))
    pictures = [frame, levels(frame, 0)] if frame.ndim == 2 else [frame]
    for picture in pictures:
        before = picture.copy()
        found = kernels.area_means(picture, height, width, threads)
        assert found.dtype == np.float32
        assert np.array_equal(found, opencv(picture, height, width))
        assert np.array_equal(picture, before)


@needs_compiled
@examples(100)
@given(
    view=drawn_views(),
    window=st.sampled_from((1, 3, 5, 7, 9, 11, 21, 45)),
    gain=st.sampled_from((12.5, 50.0, 0.3)),
    least=st.sampled_from((1.0, 0.5, 30.0)),
)
def test_local_contrast_is_that_of_opencv_s_sums(view, window, gain, least):
    """Windows that are larger than the view among them, and black parts without any contrast."""
    found = COMPILED_KERNELS.local_contrast(view, window, gain, least)
    expected = NUMPY_KERNELS.local_contrast(view, window, gain, least)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


@needs_compiled
def test_each_instruction_set_gives_the_same_at_the_runtime_s_sizes():
    from tokt.features.kernels import _native

    frame = np.random.default_rng(0).integers(0, 256, (1024, 1360, 3), np.uint8)
    scaled = NUMPY_KERNELS.area_means(frame, 512, 680)
    small = NUMPY_KERNELS.area_means(scaled, 271, 360)
    contrast = NUMPY_KERNELS.local_contrast(scaled, 21, 12.5, 1.0)
    try:
        for name in _native.INSTRUCTIONS:
            _native.use_instructions(name)
            assert np.array_equal(COMPILED_KERNELS.area_means(frame, 512, 680), scaled)
            assert np.array_equal(COMPILED_KERNELS.area_means(scaled, 271, 360), small)
            found = COMPILED_KERNELS.local_contrast(scaled, 21, 12.5, 1.0)
            assert all(np.array_equal(*both) for both in zip(found, contrast, strict=True))
    finally:
        _native.use_instructions(_native.INSTRUCTIONS[-1])


@fast
@pytest.mark.parametrize("window", [5, 11])
def test_local_contrast_by_its_definition(kernels, window):
    rng = np.random.default_rng(window)
    view = (rng.random((30, 40)) * 255).astype(np.float32)
    view[:, 25:] = 80
    sigma, even = kernels.local_contrast(view, window, 12.5, 1.0)
    wide = np.pad(view.astype(np.float64), window // 2, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(wide, (window, window))
    assert np.abs(sigma - around.std(axis=(2, 3))).max() < 0.01
    deviation = np.maximum(around.std(axis=(2, 3)), 1.0)
    expected = 128 + 12.5 * (view - around.mean(axis=(2, 3))) / deviation
    assert np.abs(even - expected.clip(0, 255)).max() < 0.6


@fast
def test_what_is_no_view(kernels):
    view = np.zeros((20, 30), np.float32)
    for wrong in (view.astype(np.float64), view[0], view[:0], None):
        with pytest.raises((TypeError, ValueError)):
            kernels.local_contrast(wrong, 7, 12.5, 1.0)
        with pytest.raises((TypeError, ValueError)):
            kernels.area_means(wrong, 10, 10)
    for window, gain, least in ((8, 12.5, 1.0), (7.0, 12.5, 1.0), (7, 0.0, 1.0), (7, 9.0, 0.0)):
        with pytest.raises(ValueError, match=r"window|deviation"):
            kernels.local_contrast(view, window, gain, least)
    with pytest.raises(ValueError, match="threads"):
        kernels.area_means(view, 10, 10, 0)
