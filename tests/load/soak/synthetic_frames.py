"""A soak's frames: small synthetic pictures, and a model that tells them apart.

The pictures are of 180x135 pixels and the grid is as wide, so that a frame is judged in one or two
milliseconds and days at sea go into an hour; every step that a large frame needs is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np

from tests.load.bundles import content_of, learnt
from tests.models.parts import SEES_ALL, golden_of
from tokt.features.common.arrays import F64, U8, Bools
from tokt.features.extractors.extractor import Lbp
from tokt.features.frames.grid import Grid
from tokt.models.bundle.bundle import Bundle, bundle_bytes, bundle_from_bytes
from tokt.models.distribution import MIN_TYPICAL, Distribution, bin_counts, quantile_edges
from tokt.models.operating_point import MofNRule, OperatingPoint

WIDTH, HEIGHT = 180, 135
GRID = Grid(width=WIDTH)
EXTRACTOR = Lbp(10, 5, "frame")
PICTURES = 32  # of each kind, to learn from

_LIGHT, _FALL, _CLOUDS = 60.0, 25.0, 4.0
_COLOUR = (1.2, 1.0, 0.5)
_GREY, _ROUGH = 90.0, 30.0
_SMOOTH, _NOISE = 6.0, 1.0
"""Pixels over which water is smooth, but for the noise of a sensor (grey levels); an obstacle is
rough from one pixel to the next."""
_ROWS, _COLS = 3, 5  # patches that an obstacle covers
_RULE_PATCHES = 3  # a single patch of water is taken for one now and then: the model is a plain one
_WINDOW, _FACTOR = 60, 16.0
"""Half of all patches may be another's before it is called drift: obstacles come and go here."""
_PLACES = 100


@cache
def _light() -> F64:
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    return np.asarray(_LIGHT - _FALL * (x**2 + y**2) / 2)


@cache
def _field(what: int, smooth: float) -> F64:
    """Noise over more than a picture, of unit spread."""
    noise = np.random.default_rng(what).normal(0, 1, (HEIGHT + _PLACES, WIDTH + _PLACES))
    noise = cv2.GaussianBlur(noise, (0, 0), smooth) if smooth else noise
    return np.asarray(noise / noise.std())


def _seen(what: int, seed: int, smooth: float = 0.0) -> F64:
    """A part of the field, by the seed: none comes again within 10,000, as a camera's do not."""
    y, x = divmod(seed * 3737 % _PLACES**2, _PLACES)
    return _field(what, smooth)[y : y + HEIGHT, x : x + WIDTH]


def water(seed: int) -> U8:
    """Open water: light that falls off towards the edges, clouds in it, and a sensor's noise."""
    light = _light() + _CLOUDS * _seen(0, seed, _SMOOTH) + _NOISE * _seen(4, seed)
    return np.asarray(np.clip(light[:, :, None] * _COLOUR, 0, 255), np.uint8)


def near(seed: int) -> U8:
    """The same, and something rough that can be hit."""
    picture, where = water(seed), obstacle_patches(seed)
    grey = np.clip(_GREY + _ROUGH * _seen(1, seed), 20, 240).astype(np.uint8)
    for y0, y1, x0, x1 in GRID.boxes(HEIGHT, WIDTH)[where]:
        picture[y0:y1, x0:x1] = grey[y0:y1, x0:x1, None]
    return picture


def obstacle_patches(seed: int) -> Bools:
    """Which patches of `near` it covers: bool, shape (n_patches,)."""
    rng = np.random.default_rng((seed, 2))
    row, col = rng.integers(GRID.rows - _ROWS + 1), rng.integers(GRID.cols - _COLS + 1)
    covered = np.zeros((GRID.rows, GRID.cols), bool)
    covered[row : row + _ROWS, col : col + _COLS] = True
    return covered.ravel()


def dark(seed: int) -> U8:
    grey = np.clip(2 + _seen(3, seed), 0, 7).astype(np.uint8)
    return np.dstack([grey] * 3)


def some(draw: Callable[[int], U8]) -> list[U8]:
    """`PICTURES` different ones of a kind."""
    return [draw(seed) for seed in range(PICTURES)]


@dataclass(frozen=True)
class Models:
    """Models of one run, all of the same weights."""

    good: tuple[Bundle, Bundle]
    unproven: Bundle  # its golden values are not what it computes
    turned: Bundle  # of a camera whose pictures are turned by 90 degrees


def models() -> Models:
    first, second, third, fourth = bundles(4)
    golden = third.content.golden
    wrong = replace(golden, decision_values=golden.decision_values + 1.0)
    shown = [np.ascontiguousarray(np.rot90(draw(0))) for draw in (water, near)]
    values = [first.model.decision_values(EXTRACTOR.describe(one, GRID)) for one in shown]
    turned = golden_of(shown, values, [first.model.obstacle_patches(one) for one in values])
    return Models(
        (first, second),
        unproven=_with(third, golden=wrong),
        turned=_with(fourth, golden=turned, frame_sizes=()),
    )


def _with(bundle: Bundle, **changes: Any) -> Bundle:
    """The same with another content, whose golden values nobody has looked at."""
    data = bundle_bytes(replace(bundle.content, **changes))
    return bundle_from_bytes(data, bundle.label, golden=False)


def bundles(versions: int) -> list[Bundle]:
    """So many versions of one model, all of the same weights, learnt from these pictures.

    It tells all of them apart: else nothing that it says of them could be checked.
    """
    shown = [*some(water), *some(near)]
    rows = np.vstack([EXTRACTOR.describe(picture, GRID) for picture in shown])
    clear = np.zeros((PICTURES, GRID.n_patches), bool)
    covered = np.concatenate([clear, [obstacle_patches(seed) for seed in range(PICTURES)]]).ravel()
    model = learnt(rows, covered.astype(np.int64))
    found = model.obstacle_patches(model.decision_values(rows))
    found = found.reshape(2, PICTURES, GRID.n_patches)
    assert not found[0].any() and found[1].any(axis=1).all(), "pictures that are not told apart"
    edges = np.array([quantile_edges(column) for column in rows.T])
    counts, typical = bin_counts(rows, edges), np.full(len(edges), MIN_TYPICAL)
    content = content_of(
        *("soak", EXTRACTOR, GRID, model, [shown[0], shown[-1]]),
        operating_point=OperatingPoint(MofNRule(min_patches=_RULE_PATCHES)),
        distribution=Distribution(edges, counts, typical, _FACTOR, _WINDOW, 90, 4),
    )
    content = replace(content, sight=SEES_ALL)  # dark frames are too dark to see in
    return [
        bundle_from_bytes(bundle_bytes(replace(content, version=str(number))), f"soak/{number}")
        for number in range(1, versions + 1)
    ]
