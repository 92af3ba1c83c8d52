"""The two images that the thesis trains on: one of open ocean, one of anything else."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_HEIGHT, _WIDTH = 1024, 1360
_CELL_PIXELS = (256, 128, 64, 32, 16, 8)
_ROUGHNESS = 0.6


def rendered_other_image(seed: int = 1) -> NDArray[np.uint8]:
    """A textured gray image that stands in for the thesis's film still, which is not at hand.

    A sum of smooth noise at six scales, stretched to grey levels 20 to 220: bright, contrasty
    and structured at every size, as a well-lit scene is and open water is not.

    Returns
    -------
    numpy.ndarray
        uint8, shape (1024, 1360).
    """
    generator = np.random.default_rng(seed)
    total = np.zeros((_HEIGHT, _WIDTH))
    for cell in _CELL_PIXELS:
        coarse = generator.normal(size=(_HEIGHT // cell + 2, _WIDTH // cell + 2))
        smooth = cv2.resize(
            coarse.astype(np.float32), (_WIDTH, _HEIGHT), interpolation=cv2.INTER_CUBIC
        )
        total += smooth * (cell / _CELL_PIXELS[0]) ** _ROUGHNESS
    stretched = (total - total.min()) / np.ptp(total)
    return np.asarray(stretched * 200 + 20, np.uint8)
