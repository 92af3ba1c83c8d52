"""Extractor ``context``: a patch's features beside a statistic of its neighbours' features."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid

from .base import SPEC_VERSION, Texture
from .frame_pictures import FramePictures

Floats = NDArray[np.float64]

_AROUND = [(down, right) for down in range(3) for right in range(3) if (down, right) != (1, 1)]


def _shifted(features: Floats, grid: Grid, beyond: float) -> list[Floats]:
    """The features of each patch's eight neighbours, `beyond` where there is none."""
    rows, cols = grid.rows, grid.cols
    padded = np.full((rows + 2, cols + 2, features.shape[1]), beyond)
    padded[1:-1, 1:-1] = features.reshape(rows, cols, -1)
    return [padded[down : down + rows, right : right + cols] for down, right in _AROUND]


def _mean(features: Floats, grid: Grid) -> Floats:
    # One after the other, so that the order of adding is the same everywhere.
    sums, *others = (part.copy() for part in _shifted(features, grid, 0.0))
    for other in others:
        sums += other
    ones = np.ones((grid.n_patches, 1))
    return np.asarray(sums / np.sum(_shifted(ones, grid, 0.0), axis=0))


def _max(features: Floats, grid: Grid) -> Floats:
    return np.asarray(np.max(_shifted(features, grid, -np.inf), axis=0))


def _min(features: Floats, grid: Grid) -> Floats:
    return np.asarray(np.min(_shifted(features, grid, np.inf), axis=0))


def _range(features: Floats, grid: Grid) -> Floats:
    return _max(features, grid) - _min(features, grid)


STATISTICS: dict[str, Callable[[Floats, Grid], Floats]] = {
    "mean": _mean,
    "max": _max,
    "min": _min,
    "range": _range,
}


def around(features: Floats, grid: Grid, statistic: str) -> Floats:
    """A statistic of each patch's neighbours, up to eight, inside the grid.

    Parameters
    ----------
    features : array of float64, shape (n_patches, dim)
    grid : Grid
        Of one patch: it is its own neighbour.
    statistic : str
        One of `STATISTICS`.

    Returns
    -------
    numpy.ndarray
        float64, shape (n_patches, dim).
    """
    if grid.n_patches == 1:
        # Not the features themselves: the range of one value is none.
        return features - features if statistic == "range" else features
    return STATISTICS[statistic](features, grid).reshape(features.shape)


class Context(Texture):
    """A part's features, followed by a statistic of the neighbours' ones.

    Parameters
    ----------
    part : Texture
    statistic : str
        One of `STATISTICS`.
    """

    def __init__(self, part: Texture, statistic: str) -> None:
        self.part = part
        self.images = part.images
        self.statistic = statistic
        self.dim = 2 * part.dim
        self.names = part.names + tuple(f"around_{statistic}.{name}" for name in part.names)

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {
            "name": "context",
            "version": SPEC_VERSION,
            "part": self.part.spec,
            "statistic": self.statistic,
        }

    def describe_pictures(self, pictures: FramePictures) -> Floats:
        """The part's features, then the neighbours'."""
        own = self.part.describe_pictures(pictures)
        return np.hstack([own, around(own, pictures.grid, self.statistic)])
