"""The interface of all extractors: a frame and a grid in, one feature row a patch out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid
from tokt.features.kernels.quantization import Quantization

from .frame_pictures import FramePictures

SPEC_VERSION = 1
PLAIN_IMAGE = {"resize": "area", "gray": "bt601"}


class Extractor(Protocol):
    """Turns a frame into features, one row a patch."""

    @property
    def spec(self) -> dict[str, Any]:
        """The JSON spec that describes this extractor whole."""

    @property
    def names(self) -> tuple[str, ...]:
        """One name a feature."""

    @property
    def dim(self) -> int:
        """Number of features of one patch."""

    @property
    def images(self) -> tuple[Quantization | None, ...]:
        """The distinct pictures it looks at; None is the plain one."""

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """`describe`, of a frame whose prepared pictures are shared with others."""

    def describe(self, frame: NDArray[np.uint8], grid: Grid) -> NDArray[np.float64]:
        """Features of every patch: float64, shape (grid.n_patches, dim), row by row.

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
            As the camera gave it, gray or BGR, any size.
        grid : Grid
        """


class Texture(ABC):
    """An extractor that works on pictures prepared from the frame."""

    dim: int
    names: tuple[str, ...]
    images: tuple[Quantization | None, ...]
    """The distinct pictures it looks at; None is the plain one."""

    @property
    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """The spec this was built from."""

    def describe(self, frame: NDArray[np.uint8], grid: Grid) -> NDArray[np.float64]:
        """Features of every patch; see `Extractor.describe`."""
        return self.describe_pictures(FramePictures(frame, grid))

    @abstractmethod
    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """Features of every patch, float64, shape (n_patches, dim)."""


class OnePicture(Texture):
    """An extractor that works on one picture, each patch by itself.

    Parameters
    ----------
    image : Quantization, optional
        How that picture is prepared; the plain one if not given.
    names : sequence of str
        Of the features; another image than the plain one goes before them.
    """

    def __init__(self, image: Quantization | None, names: tuple[str, ...]) -> None:
        self.image = image
        self.images = (image,)
        self.names = names if image is None else tuple(f"{image.label}.{name}" for name in names)
        self.dim = len(names)

    @property
    def image_spec(self) -> dict[str, Any]:
        """The spec's ``image``."""
        return dict(PLAIN_IMAGE) if self.image is None else self.image.to_json()
