"""Sums of differences and of second differences: what they say, number by number."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.frames.grid import Grid

from .each_kernel import THREADS, fast

LAGS = st.lists(st.integers(1, 20), min_size=1, max_size=4)


def random(seed: int, shape: tuple[int, ...], top: int, dtype: type) -> np.ndarray:
    """Noise, with runs of its lowest and its highest value."""
    rng = np.random.default_rng(seed)
    values = rng.integers(-top // 4, top + top // 4, shape)
    return values.clip(0, top).astype(dtype)


def differences(frame: np.ndarray, rows: list[int], cols: int, lags: list[int]) -> np.ndarray:
    levels = frame.reshape(*frame.shape[:2], -1).astype(np.int64)
    patch = levels.shape[1] // cols
    sums = np.zeros((len(rows), cols, 2 + 2 * len(lags)), np.int64)
    for row, col in np.ndindex(len(rows), cols):
        at, first, out = rows[row], col * patch, sums[row, col]
        here = levels[at, first : first + patch]
        out[:2] = here.sum(), (here >= 250).sum()
        for place, lag in enumerate(lags):
            ahead, below = levels[at, first + lag : first + lag + patch], levels[at + lag]
            out[2 + place] = np.abs(ahead - here[: len(ahead)]).sum()
            out[2 + len(lags) + place] = np.abs(below[first : first + patch] - here).sum()
    return sums


def curvatures(gray16: np.ndarray, grid: Grid, lags: list[int]) -> np.ndarray:
    levels, (height, width) = gray16.astype(np.int64), gray16.shape
    squares = np.zeros((len(lags), height, width), np.int64)
    for place, y, x in np.ndindex(squares.shape):
        lag = lags[place]
        for at, line in ((x, levels[y]), (y, levels[:, x])):
            if lag <= at < len(line) - lag:
                bend = line[at - lag] - 2 * line[at] + line[at + lag]
                squares[place, y, x] += min(abs(bend), 16 * 256) ** 2
    return np.array([[patch.sum() for patch in grid.cells(each)] for each in squares]).T


@fast
@given(
    seed=st.integers(0, 99),
    size=st.tuples(st.integers(21, 40), st.integers(1, 50)),
    channels=st.sampled_from([(), (3,)]),
    lags=LAGS,
    data=st.data(),
)
@settings(max_examples=scaled(60))
def test_differences(kernels, seed, size, channels, lags, data):
    frame = random(seed, (*size, *channels), 255, np.uint8)
    lowest = size[0] - 1 - max(lags)
    rows = data.draw(st.lists(st.integers(0, lowest), min_size=1, max_size=6))
    cols = data.draw(st.integers(1, size[1]))
    found = kernels.difference_sums(frame, np.array(rows, np.int64), cols, lags)
    assert found.dtype == np.int64
    assert np.array_equal(found, differences(frame, rows, cols, lags))


@fast
@given(
    seed=st.integers(0, 99),
    size=st.tuples(st.integers(9, 30), st.integers(9, 40)),
    lags=LAGS,
    threads=THREADS,
)
@settings(max_examples=scaled(40))
def test_second_differences(kernels, seed, size, lags, threads):
    gray16, grid = random(seed, size, 255 * 256, np.uint16), Grid(3, 2, None)
    found = kernels.curvature_sums(gray16, grid, lags, threads)
    assert found.dtype == np.int64
    assert np.array_equal(found, curvatures(gray16, grid, lags))


@fast
def test_even_light_has_no_second_difference_and_tall_patches_fit(kernels):
    ramp = np.arange(400, dtype=np.uint16)[:, None] * 100 + np.arange(90, dtype=np.uint16) * 50
    assert not kernels.curvature_sums(ramp, Grid(1, 1, None), (1, 4)).any()
    steps = np.where(np.arange(400)[:, None] % 2, 0, 65535).astype(np.uint16).repeat(90, axis=1)
    assert kernels.curvature_sums(steps, Grid(1, 1, None), (1,)) == 398 * 90 * (16 * 256) ** 2


@fast
def test_what_is_not_possible_is_refused(kernels):
    frame, gray16 = np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint16)
    rows = np.arange(3)
    for lags in ((), (0,), (65,), (1.0,)):
        with pytest.raises(ValueError, match="lags are whole numbers"):
            kernels.difference_sums(frame, rows, 3, lags)
        with pytest.raises(ValueError, match="lags are whole numbers"):
            kernels.curvature_sums(gray16, Grid(3, 3, None), lags)
    for odd in (rows + 7, rows - 1, rows[:0], rows.astype(np.int32), rows[:, None], rows[::2]):
        with pytest.raises(ValueError, match="rows are int64"):
            kernels.difference_sums(frame, odd, 3, (1,))
    with pytest.raises(ValueError, match="patches do not fit"):
        kernels.difference_sums(frame, rows, 10, (1,))
