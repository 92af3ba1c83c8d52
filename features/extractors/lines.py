"""Extractor ``lines``: strength of long, faint lines through a patch.

The legs of a tower are long lines before they are anything else, while what drifts in the water
are dots: a mean along a line keeps the one and loses the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .base import SPEC_VERSION, OnePicture
from .frame_pictures import FramePictures

_NOTHING = 0.25
"""Levels that count as no line at all: the logarithm of less says nothing."""


class Lines(OnePicture):
    """For each number of samples: ridge contrast, energy of the strongest line, and its lead.

    Parameters
    ----------
    samples : sequence of int
        Samples a line has; increasing powers of 2, 2 to 64.
    image : Quantization, optional
    """

    def __init__(self, samples: Sequence[int], image: Quantization | None = None) -> None:
        kinds = ("ridge", "strongest", "one_way")
        super().__init__(image, tuple(f"lines_{n}_{kind}" for n in samples for kind in kinds))
        self.samples = tuple(samples)

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {
            "name": "lines",
            "version": SPEC_VERSION,
            "samples": list(self.samples),
            "image": self.image_spec,
        }

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """One row a patch."""
        picture, grid = pictures.picture(self.image), pictures.grid
        middle = (256 if self.image is None else self.image.levels) // 2
        sums = KERNELS.line_sums(picture, grid, middle, self.samples, pictures.threads)
        patch_height, patch_width = grid.patch_size(*picture.shape)
        pixels, n = float(patch_height * patch_width), np.array(self.samples, np.float64)
        ridge = sums[:, :, 0] / (8 * n * pixels)
        energy = sums[:, :, 1:] / (n * n * pixels)[:, None]
        strongest = np.log(energy.max(axis=2) + _NOTHING**2)
        one_way = strongest - np.log(energy.mean(axis=2) + _NOTHING**2)
        features = np.stack([np.log(ridge + _NOTHING), strongest, one_way], axis=2)
        return features.reshape(grid.n_patches, self.dim)
