"""What every extractor is: a frame and a grid in, one feature row a patch out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .frame_pictures import FramePictures
from .grid import Grid
from .levels import Levels

SPEC_VERSION = 1
PLAIN_IMAGE = {"resize": "area", "gray": "bt601"}


class Extractor(Protocol):
    """What turns a frame into features."""

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
    def images(self) -> tuple[Levels | None, ...]:
        """The distinct pictures it looks at; None is the plain one."""

    def describe_pictures(self, pictures: FramePictures) -> NDArray[np.float64]:
        """`describe` of a frame some pictures of which are there already."""

    def describe(self, frame: NDArray[np.uint8], grid: Grid) -> NDArray[np.float64]:
        """Features of every patch: float64, shape (grid.n_patches, dim), row by row.

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
            As the camera gave it, gray or BGR, any size.
        grid : Grid
        """


class Texture(ABC):
    """An extractor that sees a frame as pictures prepared of it."""

    dim: int
    names: tuple[str, ...]
    images: tuple[Levels | None, ...]
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
    """A texture of one picture's patches, each by itself.

    Parameters
    ----------
    image : Levels, optional
        How that picture is prepared; the plain one if not given.
    names : sequence of str
        Of the features; another image than the plain one goes before them.
    """

    def __init__(self, image: Levels | None, names: tuple[str, ...]) -> None:
        self.image = image
        self.images = (image,)
        self.names = names if image is None else tuple(f"{image.label}.{name}" for name in names)
        self.dim = len(names)

    @property
    def image_spec(self) -> dict[str, Any]:
        """The spec's ``image``."""
        return dict(PLAIN_IMAGE) if self.image is None else self.image.to_json()
