"""The pictures that extractors look at, each prepared once a frame."""

from collections.abc import Callable, Collection, Hashable
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np

from tokt.features.common.arrays import F64, I64, U8, U16
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


def _box_ends(size: int, covered: int, of: int, n: int) -> I64:
    """First pixel, and one past the last, of `n` boxes over `covered` / `of` of `size` pixels."""
    edges = np.arange(n + 1) * size * covered // (of * n)
    return np.stack([edges[:-1], np.maximum(edges[1:], edges[:-1] + 1)], axis=1)


Made = dict[tuple[Hashable, ...], Any]
"""Pictures that were made, by their kind, their size and what else tells them apart."""
Value = TypeVar("Value")


class SharedPictures:
    """The pictures of one frame, for all who look at it: each is made once, when it is asked for.

    ==================  ==========  =====================================================
    picture             pixels wide  is looked at by
    ==================  ==========  =====================================================
    gray16, in colour   grid's       texture models but the plain ones
    gray16              360          sight, flow, sediment, named objects, marks (rounded)
    summed area         grid's, 360  whatever is quantized: texture models, named objects
    gray, as plain      grid's       plain texture models
    ==================  ==========  =====================================================
    """

    def __init__(self) -> None:
        self._made: dict[int, tuple[U8, Made]] = {}

    def of(self, frame: U8, grid: Grid, threads: int = 1) -> "FramePictures":
        """Pictures of one of the frame's arrays, as it is or covered by a mask, on a grid."""
        # With the array itself, so that no other one has its identity meanwhile.
        _, made = self._made.setdefault(id(frame), (frame, {}))
        return FramePictures(frame, grid, threads, made)


class FramePictures:
    """One frame's pictures on one grid.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    grid : Grid
    threads : int
        How many threads share the work; what comes out does not depend on it.
    made : dict, optional
        Pictures of this frame, also on other grids, that were made before; see `SharedPictures`.
    """

    def __init__(self, frame: U8, grid: Grid, threads: int = 1, made: Made | None = None) -> None:
        self.grid = grid
        self.threads = threads
        self._frame = frame
        self._made: Made = {} if made is None else made

    def _once(self, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        if key not in self._made:
            self._made[key] = make()
        return cast(Value, self._made[key])

    @cached_property
    def size(self) -> tuple[int, int]:
        """Height and width of the pictures in pixels."""
        return _picture_size(check_frame(self._frame, self.threads), self.grid)

    def picture(self, image: Quantization | None) -> U8:
        """The picture a spec's ``image`` describes, uint8; None is the plain one."""
        if image is None:
            return self._once(
                ("gray", self.size),
                lambda: KERNELS.resized_gray(self._frame, *self.size, self.threads),
            )
        return self._once((image, self.size), lambda: self._quantized(image))

    def prepare(self, images: Collection[Quantization | None]) -> None:
        """Make `gray16`, and in the same pass the plain picture if it is among these images."""
        plain, deep = ("gray", self.size), ("gray16", self.size)
        if None in images and plain not in self._made:
            both = KERNELS.resized_grays(self._frame, *self.size, self.threads)
            self._made[deep], self._made[plain] = both
        elif deep not in self._made:
            self.offer(KERNELS.resized_gray16(self._frame, *self.size, self.threads))

    def offer(self, gray16: U16) -> None:
        """Take a 16-bit gray picture of this size that was made elsewhere, if there is none yet."""
        self._made.setdefault(("gray16", self.size), gray16)

    def _quantized(self, image: Quantization) -> U8:
        gray16 = self.gray16
        sums = self._once(("sums", self.size), lambda: KERNELS.summed_area(gray16))
        return KERNELS.quantize(gray16, image, self.threads, sums)

    @property
    def gray16(self) -> U16:
        """The frame resized and gray in 1/256 grey level."""
        self.prepare(())
        return cast(U16, self._made["gray16", self.size])

    @property
    def rounded(self) -> U8:
        """`gray16` in whole grey levels, uint8."""
        half = STEPS_PER_LEVEL // 2
        return self._once(
            ("rounded", self.size),
            lambda: ((self.gray16 + half) // STEPS_PER_LEVEL).astype(np.uint8),
        )

    @property
    def has_colour(self) -> bool:
        """Whether any pixel's channels differ: what a gray camera gave as BGR has no colour."""
        return self._once(("colour",), lambda: _has_colour(self._frame))

    def box_means(self, cells: int) -> I64:
        """Mean colour of each part of each patch, int64, in 1/256 level.

        A patch has cells x cells parts, each of one frame pixel at least: (grid.rows * cells,
        grid.cols * cells, channels).
        """
        grid, (height, width) = self.grid, self.size
        patch_height, patch_width = grid.patch_size(height, width)
        tall, wide = self._frame.shape[:2]
        rows = _box_ends(tall, patch_height * grid.rows, height, grid.rows * cells)
        columns = _box_ends(wide, patch_width * grid.cols, width, grid.cols * cells)
        sums = KERNELS.box_sums(self._frame, rows, columns, self.threads)
        pixels = np.diff(rows)[:, None] * np.diff(columns)[None]
        return np.asarray((sums * STEPS_PER_LEVEL + pixels // 2) // pixels, np.int64)

    def colours(self, cells: int) -> F64:
        """`box_means` in CIELAB, (grid.rows * cells, grid.cols * cells, 3); gray has no colour."""
        return self._once(("colours", self.grid, cells), lambda: self._colours(cells))

    def _colours(self, cells: int) -> F64:
        means = self.box_means(cells)
        return lab_of(np.broadcast_to(means, (*means.shape[:2], 3)))


def _has_colour(frame: U8) -> bool:
    if frame.ndim == 2:
        return False
    # A few pixels nearly always show it already.
    parts = frame[::16, ::16], frame
    return any(bool((part[..., 1:] != part[..., :1]).any()) for part in parts)
