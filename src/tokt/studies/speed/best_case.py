"""The bench case of the preset best: its time for a frame against a plain extractor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.extractors.frame_pictures import FramePictures
from tokt.features.extractors.spec import build_extractor
from tokt.features.kernels.dispatch import LIBRARY, load_kernels
from tokt.features.kernels.quantization import Quantization
from tokt.inference.policy.policy import judge_image
from tokt.models.bundle.bundle import Bundle
from tokt.studies.baselines.thesis_texture import GRID

from .cases import FRAME_WORK, Case
from .frames import Picture
from .paired_timing import FLOOR

MAX_TIMES = 2.5
"""How many times the plain extractor's time the preset may take."""


class BestFrame(Case[Picture]):
    """A decoded frame to its verdict, by a plain extractor's model and by the preset best's.

    Parameters
    ----------
    plain, best : Bundle
    """

    def __init__(self, plain: Bundle, best: Bundle) -> None:
        super().__init__("best.frame")
        self._plain, self._best = plain, best
        self._images = build_extractor(best.extractor.spec).images
        self._reference = load_kernels(LIBRARY)
        self._checked = self._wrong = 0

    def baseline(self, picture: Picture) -> object:
        """The plain extractor's model."""
        return judge_image(self._plain, picture.frame)

    def ours(self, picture: Picture) -> object:
        """The preset best's."""
        return judge_image(self._best, picture.frame)

    def floor(self, picture: Picture) -> object:
        """The pictures that the preset looks at, prepared and no more."""
        return self._prepared(picture)

    def timed(self) -> dict[str, Callable[[Picture], object]]:
        """Both, and the pictures alone."""
        return {**super().timed(), FLOOR: self.floor}

    def _prepared(self, picture: Picture) -> list[NDArray[np.uint8]]:
        prepared = FramePictures(picture.frame, GRID)
        return [prepared.picture(image) for image in self._images]

    def _expected(self, picture: Picture, image: Quantization | None) -> NDArray[np.uint8]:
        if image is None:
            return picture.gray
        size = GRID.resized(*picture.frame.shape[:2])
        return self._reference.quantize(self._reference.resized_gray16(picture.frame, *size), image)

    def check(self, picture: Picture) -> bool:
        """Every pixel of these pictures, against matrix products; their textures have own cases."""
        for image, found in zip(self._images, self._prepared(picture), strict=True):
            self._checked += 1
            self._wrong += not np.array_equal(found, self._expected(picture, image))
        return True

    @property
    def exact(self) -> bool:
        """Whether all pictures were the same."""
        return self._checked > 0 and self._wrong == 0

    def findings(self) -> dict[str, Any]:
        """What was timed against what, and the pictures that were compared."""
        return {
            "of": FRAME_WORK,
            "baseline_is": f"tokt itself with the plain model {self._plain.label}",
            "floor_is": "the pictures that the preset's extractor looks at, prepared and no more",
            "asked": f"the preset's time is at most {MAX_TIMES:g} times the plain one's",
            "features": self._best.extractor.dim,
            "pictures_checked": self._checked,
            "pictures_different": self._wrong,
        }
