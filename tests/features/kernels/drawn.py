"""Pictures for the kernels' tests: random sizes and contents, the extremes among them."""

import os

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.tiers import scaled
from tokt.features.frames.grid import Grid

Image = NDArray[np.uint8]

# The compiled kernels work on blocks of 32 rows and 64 columns.
_AT_BORDERS = (3, 4, 5, 8, 31, 32, 33, 63, 64, 65)
_LEVELS = st.sampled_from((0, 1, 2, 127, 128, 254, 255)) | st.integers(0, 255)
CONTENTS = ("noise", "two levels", "constant", "few levels", "gradient", "pixel", "checkerboard")


def examples(usual: int) -> settings:
    """That many examples, or as many times as the variable TOKT_EXAMPLES says."""
    times = int(os.environ.get("TOKT_EXAMPLES", "1"))
    return settings(max_examples=scaled(usual * times))


def paint(content: str, shape: tuple[int, ...], seed: int, low: int, high: int) -> Image:
    """A picture with that kind of content, mostly between two grey levels."""
    rng = np.random.default_rng(seed)
    if content == "noise":
        picture = rng.integers(0, 256, shape)
    elif content == "two levels":
        picture = np.where(rng.random(shape) < rng.random(), low, high)
    elif content == "few levels":
        picture = low + rng.integers(0, 2 + seed % 7, shape)
    elif content == "gradient":
        steps = np.add.outer(np.arange(shape[0]) * (seed % 5), np.arange(shape[1]) * (seed % 3))
        picture = (low + steps // (1 + seed % 4)).reshape(steps.shape + (1,) * (len(shape) - 2))
        picture = np.broadcast_to(picture, shape)
    elif content == "pixel":
        picture = np.full(shape, low)
        picture[rng.integers(shape[0]), rng.integers(shape[1])] = high
    elif content == "checkerboard":
        odd = np.indices(shape[:2]).sum(axis=0) % 2 == 1
        picture = np.where(odd.reshape(odd.shape + (1,) * (len(shape) - 2)), high, low)
        picture = np.broadcast_to(picture, shape)
    else:
        picture = np.full(shape, low)
    return np.ascontiguousarray(np.clip(picture, 0, 255), np.uint8)


@st.composite
def painted(draw: st.DrawFn, shape: tuple[int, ...]) -> Image:
    """A picture of that shape with any content."""
    content = draw(st.sampled_from(CONTENTS))
    return paint(content, shape, draw(st.integers(0, 2**32)), draw(_LEVELS), draw(_LEVELS))


@st.composite
def pictures(draw: st.DrawFn, most_pixels: int = 30_000) -> tuple[Image, Grid]:
    """A gray picture and a grid: 1 to 4 patches each way, from 3x3 to 80x150 pixels.

    Some patches may be all zero, or of another content than the rest.
    """
    high = draw(st.sampled_from(_AT_BORDERS) | st.integers(3, 80))
    wide = draw(st.sampled_from((*_AT_BORDERS, 127, 128, 129)) | st.integers(3, 150))
    rows, cols = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    while rows * cols > 1 and rows * cols * high * wide > most_pixels:
        rows, cols = (rows - 1, cols) if rows > cols else (rows, cols - 1)
    remainder = draw(st.integers(0, rows - 1)), draw(st.integers(0, cols - 1))
    picture = draw(painted((rows * high + remainder[0], cols * wide + remainder[1])))
    for _ in range(draw(st.integers(0, 2))):
        row, col = draw(st.integers(0, rows - 1)), draw(st.integers(0, cols - 1))
        other = draw(painted((high, wide)) | st.just(0))
        picture[row * high : (row + 1) * high, col * wide : (col + 1) * wide] = other
    return picture, Grid(rows, cols, None)
