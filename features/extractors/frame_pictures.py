"""The pictures that extractors look at, each prepared once a frame."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64, U8
from tokt.features.frames.grid import MAX_PICTURE, Grid
from tokt.features.kernels.checks import check_frame
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL, Quantization

from .cielab import lab_of


def _picture_size(frame: U8, grid: Grid) -> tuple[int, int]:
    height, width = grid.resized(*frame.shape[:2])
    if not 1 <= height * width <= MAX_PICTURE:
        raise ValueError(f"a frame of {frame.shape} becomes {width}x{height} pixels in grid {grid}")
    return height, width


def gray_picture(frame: U8, grid: Grid, threads: int = 1) -> U8:
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


def scaled_gray(frame: U8, size: tuple[int, int], threads: int = 1) -> F32:
    """The frame gray, then of that width and height, float32: grey levels and fractions of them.

    Averaged before rounding: frames in dark water hold only a few grey levels of signal.
    """
    width, height = size
    return KERNELS.area_means(frame, height, width, threads)


def _box_ends(size: int, covered: int, of: int, n: int) -> I64:
    """First pixel, and one past the last, of `n` boxes over `covered` / `of` of `size` pixels."""
    edges = np.arange(n + 1) * size * covered // (of * n)
    return np.stack([edges[:-1], np.maximum(edges[1:], edges[:-1] + 1)], axis=1)


class FramePictures:
    """One frame's pictures on one grid.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    grid : Grid
    threads : int
        How many threads share the work; what comes out does not depend on it.
    """

    def __init__(self, frame: U8, grid: Grid, threads: int = 1) -> None:
        self.grid = grid
        self.threads = threads
        self._frame = frame
        self._made: dict[Quantization | None, U8] = {}
        self._colours: dict[int, F64] = {}

    def picture(self, image: Quantization | None) -> U8:
        """The picture a spec's ``image`` describes, uint8; None is the plain one."""
        if image not in self._made:
            self._made[image] = (
                gray_picture(self._frame, self.grid, self.threads)
                if image is None
                else KERNELS.quantize(self.gray16, image, self.threads)
            )
        return self._made[image]

    @cached_property
    def has_colour(self) -> bool:
        """Whether any pixel's channels differ: what a gray camera gave as BGR has no colour."""
        if self._frame.ndim == 2:
            return False
        # A few pixels nearly always show it already.
        return any(
            bool((part[..., 1:] != part[..., :1]).any())
            for part in (self._frame[::16, ::16], self._frame)
        )

    def box_means(self, cells: int) -> I64:
        """Mean colour of each part of each patch, int64, in 1/256 level.

        A patch has cells x cells parts, each of one frame pixel at least: (grid.rows * cells,
        grid.cols * cells, channels).
        """
        grid, (height, width) = self.grid, _picture_size(self._frame, self.grid)
        patch_height, patch_width = grid.patch_size(height, width)
        tall, wide = self._frame.shape[:2]
        rows = _box_ends(tall, patch_height * grid.rows, height, grid.rows * cells)
        columns = _box_ends(wide, patch_width * grid.cols, width, grid.cols * cells)
        sums = KERNELS.box_sums(self._frame, rows, columns, self.threads)
        pixels = np.diff(rows)[:, None] * np.diff(columns)[None]
        return np.asarray((sums * STEPS_PER_LEVEL + pixels // 2) // pixels, np.int64)

    def colours(self, cells: int) -> F64:
        """`box_means` in CIELAB, (grid.rows * cells, grid.cols * cells, 3); gray has no colour."""
        if cells not in self._colours:
            means = self.box_means(cells)
            self._colours[cells] = lab_of(np.broadcast_to(means, (*means.shape[:2], 3)))
        return self._colours[cells]

    @cached_property
    def gray16(self) -> NDArray[np.uint16]:
        """The frame resized and gray in 1/256 grey level."""
        frame = check_frame(self._frame, self.threads)
        return KERNELS.resized_gray16(frame, *_picture_size(frame, self.grid), self.threads)
