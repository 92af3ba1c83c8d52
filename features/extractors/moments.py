"""Extractor ``moments``: moments and percentiles of a patch's histogram."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .base import SPEC_VERSION, OnePicture
from .frame_pictures import FramePictures

PERCENTS = (2, 10, 50, 90, 98)


class Moments(OnePicture):
    """Mean, standard deviation, extremes and percentiles of a patch's levels."""

    def __init__(self, image: Quantization | None = None) -> None:
        names = ("mean", "std", "min", "max", *(f"percentile_{part}" for part in PERCENTS))
        super().__init__(image, tuple(f"moments_{name}" for name in names))

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {"name": "moments", "version": SPEC_VERSION, "image": self.image_spec}

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """One row a patch, in levels."""
        picture = pictures.picture(self.image)
        return moments_of(KERNELS.level_counts(picture, pictures.grid, pictures.threads))


def moments_of(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """The features of histograms of 256 levels, shape (n, 256), as (n, 9).

    A percentile p is the lowest level that p % of the pixels do not exceed. All sums are of whole
    numbers, the variance's around one next to the mean.
    """
    level = np.arange(counts.shape[1])
    up_to = counts.cumsum(axis=1)
    n = up_to[:, -1]
    total = counts @ level
    middle = (total + n // 2) // n
    shift = (total - middle * n) / n
    spread = (counts * (level - middle[:, None]) ** 2).sum(axis=1)
    variance = np.maximum(spread / n - shift * shift, 0)
    seen = counts > 0
    extremes = seen.argmax(axis=1), counts.shape[1] - 1 - seen[:, ::-1].argmax(axis=1)
    percentiles = [(100 * up_to >= part * n[:, None]).argmax(axis=1) for part in PERCENTS]
    return np.stack([total / n, np.sqrt(variance), *extremes, *percentiles], axis=1)
