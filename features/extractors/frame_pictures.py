"""The pictures that extractors look at, each prepared once a frame."""

from collections.abc import Callable, Collection, Hashable
from functools import cached_property, lru_cache
from threading import RLock
from typing import Any, TypeVar, cast

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, I64, U8, U16
from tokt.features.frames.grid import MAX_PICTURE, Grid
from tokt.features.kernels.checks import check_frame
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL, Quantization

from .cielab import lab_of


def _of_a_camera(height: int, width: int) -> bool:
    return 1 <= height * width <= MAX_PICTURE


def _picture_size(frame: U8, grid: Grid) -> tuple[int, int]:
    height, width = grid.resized(*frame.shape[:2])
    if not _of_a_camera(height, width):
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


Value = TypeVar("Value")


class _Made:
    """Pictures that were made, by their kind, their size and what else tells them apart."""

    def __init__(self) -> None:
        # Another thread that wants one waits for it, in place of making it as well.
        self._lock = RLock()
        self._of: dict[tuple[Hashable, ...], Any] = {}

    def once(self, key: tuple[Hashable, ...], make: Callable[[], Value]) -> Value:
        """Give the picture of that key, made now if it is not yet."""
        with self._lock:
            if key not in self._of:
                self._of[key] = make()
            return cast(Value, self._of[key])

    def offer(self, key: tuple[Hashable, ...], value: Value) -> Value:
        """Keep one that was made elsewhere, if there is none yet; give the one there is."""
        return self.once(key, lambda: value)

    def __contains__(self, key: tuple[Hashable, ...]) -> bool:
        return key in self._of


class SharedPictures:
    """The pictures of one frame, for all who look at it: each is made once, when it is asked for.

    =============  ===============  ========================================================
    picture        pixels wide      who looks at it
    =============  ===============  ========================================================
    `gray16`       360              pushbroom
    `near_gray16`  360              sight
    `rounded`      360              flow, sediment, the watch for marks that never move
    `picture`      the grid's, 360  texture models, by their specs' images; a named object
    `colours`      as it is         texture models that look at colours
    `halved`       half of those    texture models, by their specs' half
    summed area    the grid's, 360  whatever makes a `picture` but the plain one
    =============  ===============  ========================================================

    Frozen pictures are told by rows and tiles of the frame as it is, dense stereo has its own size,
    and the view's picture is made in its own thread.
    """

    def __init__(self) -> None:
        self._made: dict[int, tuple[U8, _Made]] = {}

    def __reduce__(self) -> tuple[type["SharedPictures"], tuple[()]]:
        # Another process, such as a shadow's, makes its own: they are larger than the frame.
        return SharedPictures, ()

    def of(self, frame: U8, grid: Grid, threads: int = 1) -> "FramePictures":
        """Pictures of one of the frame's arrays, as it is or covered by a mask, on a grid."""
        # With the array itself, so that no other one has its identity meanwhile.
        _, made = self._made.setdefault(id(frame), (frame, _Made()))
        return FramePictures(frame, grid, threads, made)


class FramePictures:
    """One frame's pictures on one grid.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
    grid : Grid
    threads : int
        How many threads share the work; what comes out does not depend on it.
    made : optional
        Pictures of this frame, also on other grids, that were made before; see `SharedPictures`.
    """

    def __init__(self, frame: U8, grid: Grid, threads: int = 1, made: _Made | None = None) -> None:
        self.grid = grid
        self.threads = threads
        self.frame = frame
        self._made = made or _Made()

    @cached_property
    def size(self) -> tuple[int, int]:
        """Height and width of the pictures in pixels."""
        return _picture_size(check_frame(self.frame, self.threads), self.grid)

    @property
    def of_a_camera(self) -> bool:
        """Whether the frame has a camera's shape: a strip would have no rows, or too many."""
        return _of_a_camera(*self.grid.resized(*self.frame.shape[:2]))

    def picture(self, image: Quantization | None) -> U8:
        """The picture a spec's ``image`` describes, uint8; None is the plain one."""
        if image is None:
            return self._made.once(
                ("gray", self.size),
                lambda: KERNELS.resized_gray(self.frame, *self.size, self.threads),
            )
        return self._made.once((image, self.size), lambda: self._quantized(image))

    def prepare(self, images: Collection[Quantization | None]) -> None:
        """Make the plain picture, if it is among these images, and `gray16` in the same pass."""
        plain, deep = ("gray", self.size), ("gray16", self.size)
        if None in images and deep not in self._made:
            gray16, gray = KERNELS.resized_grays(self.frame, *self.size, self.threads)
            self._made.offer(deep, gray16)
            self._made.offer(plain, gray)

    def offer(self, gray16: U16) -> None:
        """Take what stereo made on its way to be `near_gray16`, if there is none yet."""
        self._made.offer(("near gray16", self.size), gray16)

    @property
    def near_gray16(self) -> U16:
        """`gray16`, or one of the same size that was rounded more than once."""
        return self._made.once(("near gray16", self.size), lambda: self.gray16)

    def _quantized(self, image: Quantization) -> U8:
        gray16 = self.gray16
        sums = self._made.once(("sums", self.size), lambda: KERNELS.summed_area(gray16))
        return KERNELS.quantize(gray16, image, self.threads, sums)

    @property
    def gray16(self) -> U16:
        """The frame resized and gray in 1/256 grey level."""
        return self._made.once(
            ("gray16", self.size),
            lambda: KERNELS.resized_gray16(self.frame, *self.size, self.threads),
        )

    @property
    def halved(self) -> "HalvedPictures":
        """Those of half the width and height."""
        return self._made.once(("halved", self.grid, self.size), lambda: HalvedPictures(self))

    @property
    def rounded(self) -> U8:
        """`near_gray16` in whole grey levels, uint8."""
        half = STEPS_PER_LEVEL // 2
        return self._made.once(
            ("rounded", self.size),
            lambda: ((self.near_gray16 + half) // STEPS_PER_LEVEL).astype(np.uint8),
        )

    @property
    def has_colour(self) -> bool:
        """Whether any pixel's channels differ: what a gray camera gave as BGR has no colour."""
        return self._made.once(("colour",), lambda: _has_colour(self.frame))

    def box_means(self, cells: int) -> I64:
        """Mean colour of each part of each patch, int64, in 1/256 level.

        A patch has cells x cells parts, each of one frame pixel at least: (grid.rows * cells,
        grid.cols * cells, channels).
        """
        grid, (height, width) = self.grid, _picture_size(self.frame, self.grid)
        patch_height, patch_width = grid.patch_size(height, width)
        tall, wide = self.frame.shape[:2]
        rows = _box_ends(tall, patch_height * grid.rows, height, grid.rows * cells)
        columns = _box_ends(wide, patch_width * grid.cols, width, grid.cols * cells)
        sums = KERNELS.box_sums(self.frame, rows, columns, self.threads)
        pixels = np.diff(rows)[:, None] * np.diff(columns)[None]
        return np.asarray((sums * STEPS_PER_LEVEL + pixels // 2) // pixels, np.int64)

    def colours(self, cells: int) -> F64:
        """`box_means` in CIELAB, (grid.rows * cells, grid.cols * cells, 3); gray has no colour."""
        return self._made.once(("colours", self.grid, cells), lambda: self._colours(cells))

    def _colours(self, cells: int) -> F64:
        means = self.box_means(cells)
        return lab_of(np.broadcast_to(means, (*means.shape[:2], 3)))


def _halved(gray16: U16, grid: Grid) -> U16:
    """Means of 2x2 pixels within each patch, whose last row or column is left out where odd."""
    height, width = grid.patch_size(*gray16.shape)
    even = gray16[: grid.rows * height, : grid.cols * width]
    for axis, count, side in ((0, grid.rows, height), (1, grid.cols, width)):
        if side % 2:
            even = even.take(_without_last(count, side), axis)
    high, wide = even.shape
    return np.asarray(cv2.resize(even, (wide // 2, high // 2), interpolation=cv2.INTER_AREA))


@lru_cache(maxsize=8)
def _without_last(count: int, side: int) -> I64:
    """The places of `count` parts' pixels, `side` each, without each part's last one."""
    return np.add.outer(np.arange(count) * side, np.arange(side - 1)).ravel()


class HalvedPictures(FramePictures):
    """Pictures of half the width and height, whose patches are those of the whole ones.

    Colours are the whole frame's: they are means over parts of a patch as it is. It keeps no
    reference to the whole ones, which keep it.
    """

    def __init__(self, whole: FramePictures) -> None:
        super().__init__(whole.frame, whole.grid, whole.threads)
        self._gray16 = _halved(whole.gray16, whole.grid)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Height and width of the pictures in pixels."""
        height, width = self._gray16.shape
        return height, width

    def picture(self, image: Quantization | None) -> U8:
        """As of the whole ones; the plain one is `gray16` in whole grey levels."""
        return self.rounded if image is None else super().picture(image)

    @property
    def gray16(self) -> U16:
        """The means of 2x2 pixels of the whole picture, in 1/256 grey level."""
        return self._gray16


def _has_colour(frame: U8) -> bool:
    if frame.ndim == 2:
        return False
    # A few pixels nearly always show it already.
    parts = frame[::16, ::16], frame
    return any(bool((part[..., 1:] != part[..., :1]).any()) for part in parts)
