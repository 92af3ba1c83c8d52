"""Extractor ``structure``: strength and coherence of a patch's edges (structure tensor)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .base import SPEC_VERSION, OnePicture
from .frame_pictures import FramePictures

_NOTHING = 0.25
"""Squared levels that count as no edge at all: the logarithm of less says nothing."""


class Structure(OnePicture):
    """The structure tensor of each patch: its eigenvalues' logarithms, and its coherence.

    References
    ----------
    Bigun, Granlund (1987), "Optimal orientation detection of linear symmetry", ICCV.
    """

    def __init__(self, image: Quantization | None = None) -> None:
        super().__init__(image, ("structure_strong", "structure_weak", "structure_coherence"))

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        return {"name": "structure", "version": SPEC_VERSION, "image": self.image_spec}

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """One row a patch."""
        picture, grid = pictures.picture(self.image), pictures.grid
        sums = KERNELS.structure_sums(picture, grid, pictures.threads)
        patch_height, patch_width = grid.patch_size(*picture.shape)
        # Neighbours are two pixels apart: a difference is twice the slope.
        across, down, both = (sums / (4.0 * patch_height * patch_width)).T
        trace = across + down
        apart = np.sqrt((across - down) ** 2 + 4 * both**2)
        strong, weak = (trace + apart) / 2, np.maximum(trace - apart, 0) / 2
        return np.stack(
            [np.log(strong + _NOTHING), np.log(weak + _NOTHING), apart / (trace + _NOTHING)], axis=1
        )
