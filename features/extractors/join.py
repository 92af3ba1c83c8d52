"""Extractor ``join``: several extractors' features side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .base import SPEC_VERSION, Texture
from .frame_pictures import FramePictures


class Join(Texture):
    """Several extractors' features side by side; pictures they share are prepared once."""

    def __init__(self, parts: Sequence[Texture]) -> None:
        self.parts = tuple(parts)
        self.images = tuple(dict.fromkeys(image for part in parts for image in part.images))
        self.dim = sum(part.dim for part in self.parts)
        self.names = tuple(name for part in self.parts for name in part.names)

    @property
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""
        parts = [part.spec for part in self.parts]
        return {"name": "join", "version": SPEC_VERSION, "parts": parts}

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """The parts' features, in order."""
        return np.hstack([part.describe_pictures(pictures) for part in self.parts])
