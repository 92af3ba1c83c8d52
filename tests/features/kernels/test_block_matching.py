"""Block matching: every kernel gives the integers of OpenCV's StereoBM."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.kernels.block_matching import BlockMatching

from .each_kernel import COMPILED_KERNELS, fast, needs_compiled

matchings = st.builds(
    BlockMatching,
    min_disparity=st.integers(0, 20),
    n_disparities=st.integers(1, 4).map(lambda count: 16 * count),
    block=st.sampled_from([5, 7, 9, 15, 21]),
    cap=st.integers(1, 31),
    texture=st.integers(0, 400),
    uniqueness=st.integers(0, 20),
)


def views(height: int, width: int, seed: int, blur: float, levels: int) -> list[np.ndarray]:
    """A textured view, and itself moved by a few pixels with a little noise."""
    rng = np.random.default_rng(seed)
    left = cv2.GaussianBlur(rng.integers(0, 256, (height, width), np.uint8), (0, 0), blur)
    left = (left // levels * levels).astype(np.uint8)
    right = np.roll(left, -int(rng.integers(0, 25)), axis=1)
    noise = rng.integers(0, 1 + int(rng.integers(0, 3)), right.shape)
    return [left, (right + noise).clip(0, 255).astype(np.uint8)]


def opencv(left: np.ndarray, right: np.ndarray, matching: BlockMatching) -> np.ndarray:
    """OpenCV's own matcher, on views with room for the largest disparity."""
    margin = matching.min_disparity + matching.n_disparities
    matcher = cv2.StereoBM.create(matching.n_disparities, matching.block)
    matcher.setMinDisparity(matching.min_disparity)
    matcher.setPreFilterType(cv2.StereoBM_PREFILTER_XSOBEL)
    matcher.setPreFilterCap(matching.cap)
    matcher.setTextureThreshold(matching.texture)
    matcher.setUniquenessRatio(matching.uniqueness)
    wide = [np.pad(view, ((0, 0), (margin, 0)), constant_values=128) for view in (left, right)]
    return matcher.compute(*wide)[:, margin:]


@fast
@settings(max_examples=scaled(60))
@given(
    matching=matchings,
    height=st.integers(1, 70),
    width=st.integers(1, 90),
    seed=st.integers(0, 1000),
    blur=st.sampled_from([0.4, 1.5, 4.0]),
    levels=st.sampled_from([1, 1, 30]),
    share=st.sampled_from([0.01, 0.3, 1.0]),
)
def test_the_wanted_pixels_have_opencvs_disparities(
    kernels, matching, height, width, seed, blur, levels, share
):
    left, right = views(height, width, seed, blur, levels)
    wanted = (np.random.default_rng(seed).random(left.shape) < share).astype(np.uint8)
    found = kernels.block_disparity(left, right, matching, wanted)
    assert found.dtype == np.int16 and found.shape == left.shape
    unmatched = (matching.min_disparity - 1) * 16
    assert (found[wanted == 0] == unmatched).all()
    if min(height, width) > matching.block:
        assert np.array_equal(found[wanted > 0], opencv(left, right, matching)[wanted > 0])
    else:
        assert (found == unmatched).all()


@needs_compiled
def test_each_instruction_set_gives_the_same_at_the_runtimes_settings():
    from tokt.features.kernels import _native

    matching = BlockMatching(32, 176, 21, 31, 150, 12)
    left, _ = views(60, 330, 1, 1.5, 1)
    right = np.roll(left, -60, axis=1)
    wanted = np.ones_like(left)
    expected = opencv(left, right, matching)
    assert (expected > matching.unmatched).mean() > 0.2
    try:
        for name in _native.INSTRUCTIONS:
            _native.use_instructions(name)
            found = COMPILED_KERNELS.block_disparity(left, right, matching, wanted)
            assert np.array_equal(found, expected), name
    finally:
        _native.use_instructions(_native.INSTRUCTIONS[-1])


@pytest.mark.parametrize(
    "changes",
    [
        *({"min_disparity": -1}, {"min_disparity": 2000, "n_disparities": 48}),
        *({"n_disparities": 24}, {"n_disparities": 0}, {"block": 8}, {"block": 3}),
        *({"block": 23, "cap": 31}, {"cap": 32}, {"texture": -1}, {"uniqueness": -1}),
    ],
)
def test_numbers_out_of_range_are_refused(changes):
    usual = BlockMatching(2, 32, 21, 31, 10, 12)
    with pytest.raises(ValueError):
        replace(usual, **changes)


@fast
def test_other_arrays_are_refused(kernels):
    matching = BlockMatching(0, 16, 5, 31, 0, 0)
    view = np.zeros((20, 30), np.uint8)
    with pytest.raises(TypeError):
        kernels.block_disparity(view.astype(np.float32), view, matching, view)
    with pytest.raises(ValueError):
        kernels.block_disparity(view, view[:, 1:], matching, view)
    with pytest.raises(ValueError):
        kernels.block_disparity(view[0], view[0], matching, view[0])
