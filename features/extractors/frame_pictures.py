"""The pictures that extractors look at, each prepared once a frame."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from .checks import check_frame
from .grid import Grid
from .kernels import KERNELS
from .levels import DEPTH, Levels

_LARGEST_PICTURE = 100_000_000  # pixels; a thinner strip than any camera's would become more


def _picture_size(frame: NDArray[np.uint8], grid: Grid) -> tuple[int, int]:
    height, width = grid.resized(*frame.shape[:2])
    if not 1 <= height * width <= _LARGEST_PICTURE:
        raise ValueError(f"a frame of {frame.shape} becomes {width}x{height} pixels in grid {grid}")
    return height, width


def gray_picture(frame: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.uint8]:
    """The frame as the plain extractors see it: resized to the grid's width, then gray.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it, gray or BGR, any size.
    grid : Grid
        Says the width.
    threads : int
        How many threads share the work.

    Raises
    ------
    TypeError, ValueError
        If the frame is not uint8, or has another shape.
    """
    frame = check_frame(frame, threads)
    return KERNELS.resized_gray(frame, *_picture_size(frame, grid), threads)


def deep_picture(frame: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.uint16]:
    """The frame resized and gray in 1/256 grey level; takes and raises what `gray_picture` does."""
    frame = check_frame(frame, threads)
    return KERNELS.deep_gray(frame, *_picture_size(frame, grid), threads)


class FramePictures:
    """One frame's pictures on one grid.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    grid : Grid
    threads : int
        How many threads share the work; what comes out does not depend on it.
    """

    def __init__(self, frame: NDArray[np.uint8], grid: Grid, threads: int = 1) -> None:
        self.grid = grid
        self.threads = threads
        self._frame = frame
        self._deep: NDArray[np.uint16] | None = None
        self._made: dict[Levels | None, NDArray[np.uint8]] = {}

    def picture(self, image: Levels | None) -> NDArray[np.uint8]:
        """The picture a spec's ``image`` describes, uint8; None is the plain one."""
        made = self._made.get(image)
        if made is None:
            made = self._made[image] = self._prepared(image)
        return made

    def gray(self, images: Collection[Levels | None]) -> NDArray[np.uint8]:
        """A gray picture for checks, of what extractors that look at `images` need anyway.

        The plain one, or where no image is plain the deep one rounded to whole grey levels: at
        most a level apart, and not the cost of another resize.

        Raises
        ------
        TypeError, ValueError
            As `gray_picture`.
        """
        if None in images or None in self._made or not images:
            return self.picture(None)
        rounded = self._deep_picture() + np.uint16(DEPTH // 2)
        rounded >>= np.uint16(DEPTH.bit_length() - 1)
        return rounded.astype(np.uint8)

    def _deep_picture(self) -> NDArray[np.uint16]:
        if self._deep is None:
            self._deep = deep_picture(self._frame, self.grid, self.threads)
        return self._deep

    def _prepared(self, image: Levels | None) -> NDArray[np.uint8]:
        if image is None:
            return gray_picture(self._frame, self.grid, self.threads)
        return KERNELS.to_levels(self._deep_picture(), image, self.threads)
