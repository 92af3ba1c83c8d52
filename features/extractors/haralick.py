"""Extractor ``haralick``: features of grey-level co-occurrence matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .base import SPEC_VERSION, OnePicture
from .frame_pictures import FramePictures

HARALICK_NAMES = (
    "angular_second_moment",
    "contrast",
    "correlation",
    "sum_of_squares",
    "inverse_difference_moment",
    "sum_average",
    "sum_variance",
    "sum_entropy",
    "entropy",
    "difference_variance",
    "difference_entropy",
    "information_correlation_1",
    "information_correlation_2",
)
LINEAR, LOG = "linear", "log"
_LOG_NAMES = dict.fromkeys(
    ("contrast", "correlation", "sum_of_squares", "sum_variance", "difference_variance"), "_log"
)
_LEAST = 0.1
"""Squared levels, small beside those of a picture with any texture."""


class Haralick(OnePicture):
    """Haralick's first 13 features, mean over 4 directions (thesis section 3.5)."""

    def __init__(
        self, ignore_zeros: bool, image: Quantization | None = None, scale: str | None = None
    ) -> None:
        shown = _LOG_NAMES if scale == LOG else {}
        names = (f"haralick_{name}{shown.get(name, '')}" for name in HARALICK_NAMES)
        super().__init__(image, tuple(names))
        self.ignore_zeros = ignore_zeros
        self.scale = scale

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from; version 1 knows no scale."""
        spec = {
            "name": "haralick",
            "version": SPEC_VERSION,
            "ignore_zeros": self.ignore_zeros,
            "image": self.image_spec,
        }
        return spec if self.scale is None else {**spec, "version": 2, "scale": self.scale}

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """The 13 features of each patch's grey-level co-occurrence matrices (GLCM)."""
        picture = pictures.picture(self.image)
        features = KERNELS.haralick_features(
            picture, pictures.grid, self.ignore_zeros, pictures.threads
        )
        return on_log_scale(features) if self.scale == LOG else features


def on_log_scale(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """Features of shape (n, 13) with those that grow with contrast as logarithms.

    A linear model then sees what is faint and what is close on one scale; the correlation, which
    crowds below 1, is spread by the inverse hyperbolic tangent.
    """
    out = features.copy()
    for place, name in enumerate(HARALICK_NAMES):
        if name == "correlation":
            out[:, place] = np.arctanh(out[:, place].clip(-0.99, 0.9999))
        elif name in _LOG_NAMES:
            out[:, place] = np.log(out[:, place] + _LEAST)
    return out
