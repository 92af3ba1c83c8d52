"""Extractor ``lbp``: histograms of uniform local binary patterns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import Quantization

from .base import SPEC_VERSION, OnePicture
from .frame_pictures import FramePictures

BILINEAR, NEAREST = "bilinear", "nearest"


class Lbp(OnePicture):
    """Normalised histograms of uniform local binary patterns (thesis section 3.4).

    Parameters
    ----------
    points, radius : int
        P sampling points on a circle of R pixels.
    border : {"patch", "frame"}
        Whether a point beyond the patch is 0 or the neighbour's pixel.
    image : Quantization, optional
    sampling : {"bilinear", "nearest"}, optional
        Between pixels, or at the nearest one; not given, bilinear by a spec of version 1.
    """

    def __init__(
        self,
        points: int,
        radius: int,
        border: str,
        image: Quantization | None = None,
        sampling: str | None = None,
    ) -> None:
        bins = [*range(points + 1), "other"]
        kind = "lbp_nearest" if sampling == NEAREST else "lbp"
        super().__init__(
            image, tuple(f"{kind}_{points}_{radius}_{border}_{pattern}" for pattern in bins)
        )
        self.sampling = sampling
        self.points = points
        self.radius = radius
        self.border = border

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from; version 1 knows no sampling."""
        spec = {
            "name": "lbp",
            "version": SPEC_VERSION,
            "points": self.points,
            "radius": self.radius,
            "border": self.border,
            "image": self.image_spec,
        }
        return spec if self.sampling is None else {**spec, "version": 2, "sampling": self.sampling}

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """Fraction of a patch's pixels with each pattern; rows sum to 1."""
        picture, grid = pictures.picture(self.image), pictures.grid
        kernel = KERNELS.lbp_nearest_counts if self.sampling == NEAREST else KERNELS.lbp_counts
        counts = kernel(picture, grid, self.points, self.radius, self.border, pictures.threads)
        patch_height, patch_width = grid.patch_size(*picture.shape)
        return counts / float(patch_height * patch_width)
