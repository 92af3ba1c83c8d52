"""Checks of what the kernels are given, with a clear error, and rows shared among threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from tokt.features.common.arrays import F32, I64, U8, U16, U32, U64

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor


MAX_PIXELS = 1 << 31
"""Pixels of a frame; of more, a sum could pass 2**53, up to which double precision is exact."""
MAX_SAMPLES = 64  # on a line; the sum of as many levels fits 16 bits
MAX_LAG = 64  # pixels
MAX_GAIN = (
    4096  # at most what a grey level becomes; 255 of them stay below 2**22, and can be rounded
)
MAX_BOX = 15  # pixels; the sum of a box fits 24 bits
MAX_POINTS = 64  # a pattern is one machine word
MAX_RADIUS = 1024.0  # pixels; wider than any patch, and sums of sizes stay small


def _check_array(array: Any, threads: int, dtype: type = np.uint8) -> None:
    if not isinstance(array, np.ndarray):
        raise TypeError(f"an array of {dtype.__name__} is needed, not {type(array).__name__}")
    if array.dtype != dtype:
        raise TypeError(f"grey levels are {dtype.__name__}, not {array.dtype}")
    if type(threads) is not int or threads < 1:
        raise ValueError(f"threads is a whole number from 1, not {threads!r}")


def check_gray(gray: Any, threads: int = 1) -> U8:
    """A gray picture in C order, copied only if it is not in C order yet.

    TypeError if it is not an array of uint8, ValueError if it does not have two dimensions.
    """
    _check_array(gray, threads)
    if gray.ndim != 2:
        raise ValueError(f"a gray picture is (height, width), not {gray.shape}")
    return np.ascontiguousarray(gray)


def check_frame(frame: Any, threads: int = 1) -> U8:
    """A gray or BGR frame in C order, copied only if it is not in C order yet.

    Raises TypeError if it is not an array of uint8; ValueError if it has another shape or no pixel,
    or `threads` is not a number of threads.
    """
    _check_array(frame, threads)
    if frame.ndim not in (2, 3) or (frame.ndim == 3 and frame.shape[2] != 3):
        raise ValueError(f"a frame is (height, width) or (height, width, 3), not {frame.shape}")
    if not frame.size:
        raise ValueError("a frame has at least one pixel")
    return np.ascontiguousarray(frame)


def check_gray16(gray16: Any, threads: int = 1) -> U16:
    """A 16-bit gray picture in C order, copied only if it is not in C order yet.

    TypeError if it is not an array of uint16, ValueError if it has another shape or no pixel.
    """
    _check_array(gray16, threads, np.uint16)
    if gray16.ndim != 2 or not gray16.size:
        raise ValueError(f"a 16-bit gray picture is (height, width), not {gray16.shape}")
    return np.ascontiguousarray(gray16)


def check_sums(sums: U32, shape: tuple[int, ...]) -> U32:
    """Check that an array can be the summed area of a picture of that shape; ValueError if not."""
    height, width = shape
    if sums.dtype != np.uint32 or sums.shape != (height + 1, width + 1):
        raise ValueError(f"sums are uint32 of {(height + 1, width + 1)}, not {sums.shape}")
    return np.ascontiguousarray(sums)


def check_view(view: Any, threads: int = 1) -> F32:
    """A picture of grey levels and fractions in C order, copied only if it is not in C order yet.

    TypeError if it is not an array of float32, ValueError if it has another shape or no pixel.
    """
    _check_array(view, threads, np.float32)
    if view.ndim != 2 or not view.size:
        raise ValueError(f"a view is (height, width), not {view.shape}")
    return np.ascontiguousarray(view)


def check_contrast(window: int, gain: float, least: float) -> None:
    """Check that a view can be made even so; ValueError if not."""
    if type(window) is not int or window < 1 or window % 2 == 0:
        raise ValueError(f"a window is an odd number of pixels, not {window!r}")
    if not 0 < gain <= MAX_GAIN * least:
        raise ValueError(f"a deviation of {least} or more cannot become {gain} grey levels")


def check_size(height: int, width: int) -> None:
    """Check that a picture of that size can be made; ValueError if not."""
    if min(height, width) < 1:
        raise ValueError(f"a picture has at least one pixel, not {width}x{height}")


def check_gray16_size(shape: tuple[int, ...], height: int, width: int) -> None:
    """Check that a 16-bit gray picture of that size can be made of a frame; ValueError if not."""
    check_size(height, width)
    if shape[0] * shape[1] >= MAX_PIXELS:
        raise ValueError(f"a frame of {shape[1]}x{shape[0]} pixels has too many")


def check_box(box: int) -> None:
    """Check that gradients are known of means over boxes with that side; ValueError if not."""
    if type(box) is not int or not 1 <= box <= MAX_BOX or box % 2 == 0:
        raise ValueError(f"a box is an odd number of pixels, 1 to {MAX_BOX}, not {box!r}")


def check_lags(lags: Sequence[int]) -> None:
    """Check that pixels can be compared over these distances; ValueError if not."""
    if not lags or any(type(lag) is not int or not 1 <= lag <= MAX_LAG for lag in lags):
        raise ValueError(f"lags are whole numbers of pixels, 1 to {MAX_LAG}, not {lags!r}")


def check_rows(rows: I64, cols: int, shape: tuple[int, ...], below: int) -> None:
    """Check that a frame has these rows and so many below each, and a pixel for each patch.

    ValueError if not.
    """
    known = rows.dtype == np.int64 and rows.ndim == 1 and rows.flags.c_contiguous and len(rows) > 0
    if not known or rows.min() < 0 or rows.max() + below >= shape[0]:
        raise ValueError(f"rows are int64, 0 to {shape[0] - 1 - below} in a frame of {shape}")
    if not 1 <= cols <= shape[1]:
        raise ValueError(f"{cols} patches do not fit side by side into {shape[1]} pixels")


def check_ranges(ranges: I64, length: int) -> I64:
    """Ranges of a frame's rows or columns in C order, copied only if they are not in C order yet.

    TypeError or ValueError if they are not int64, there are none, or one is empty or leaves the
    frame.
    """
    if not isinstance(ranges, np.ndarray) or ranges.dtype != np.int64:
        raise TypeError(f"ranges are an array of int64, not {getattr(ranges, 'dtype', ranges)!r}")
    if ranges.ndim != 2 or ranges.shape[1] != 2 or not len(ranges):
        raise ValueError(f"ranges are (n, 2), at least one, not {ranges.shape}")
    first, last = ranges.T
    if first.min() < 0 or (first >= last).any() or last.max() > length:
        raise ValueError(f"a range has its first pixel, then one past its last, up to {length}")
    return np.ascontiguousarray(ranges)


def check_weights(weights: U64, width: int) -> None:
    """Check that rows of that width have as many words of 8 pixels as there are weights.

    ValueError if not, or if there are none.
    """
    fits = weights.ndim == 2 and 0 < weights.size <= width // 8
    if weights.dtype != np.uint64 or not fits or not weights.flags.c_contiguous:
        raise ValueError(f"weights of words in {width} pixels, not {weights.shape}")


def check_signs(signs: U64, others: U64) -> None:
    """Check that pictures' signs are of one size; ValueError if not."""
    shapes = signs.ndim == 3 and len(signs) == 2 and others.shape[1:] == signs.shape
    in_order = signs.flags.c_contiguous and others.flags.c_contiguous
    if {signs.dtype, others.dtype} != {np.dtype(np.uint64)} or not shapes or not in_order:
        raise ValueError(f"signs are (2, rows, tiles), not {signs.shape} and {others.shape}")


def check_samples(samples: Sequence[int], middle: int) -> None:
    """Check that the kernels know these numbers of samples and this middle; ValueError if not."""
    powers = [n for n in (2, 4, 8, 16, 32, 64) if n in samples]
    if not powers or list(samples) != powers or any(type(n) is not int for n in samples):
        raise ValueError(f"samples are increasing powers of 2, 2 to {MAX_SAMPLES}, not {samples}")
    if type(middle) is not int or not 0 <= middle <= 255:
        raise ValueError(f"the middle is a level, not {middle!r}")


def check_lbp(points: int, radius: float, border: str) -> None:
    """Check that the kernels know these LBP options; TypeError or ValueError if not."""
    if type(points) is not int or type(radius) not in (int, float):
        raise TypeError(f"points and radius are numbers, not {points!r} and {radius!r}")
    if not 1 <= points <= MAX_POINTS:
        raise ValueError(f"{points} points: 1 to {MAX_POINTS} are possible")
    if not 0 < radius <= MAX_RADIUS:
        raise ValueError(f"radius {radius} px: more than 0 and at most {MAX_RADIUS:g}")
    if border not in ("patch", "frame"):
        raise ValueError(f"border is 'patch' or 'frame', not {border!r}")


Result = TypeVar("Result")


@lru_cache(maxsize=4)
def _pool(threads: int) -> ThreadPoolExecutor:
    # Imported only where threads are asked for: it is 4 ms of a start.
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(threads, thread_name_prefix="tokt-kernels")


if hasattr(os, "register_at_fork"):
    # A forked child has the pool but not its threads: it would wait for ever.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def over_rows(work: Callable[[int, int], None], rows: int, threads: int) -> None:
    """Call ``work(first, last)`` so that all rows are done, in equal parts, one a thread.

    It writes the results of rows first..last where they belong; whatever it raises is raised here.
    """
    parts = min(threads, rows)
    ends = [rows * part // parts for part in range(parts + 1)]
    # This thread does the first part itself: of those of the pool one may be at work beside it.
    others = [beside(partial(work, *ends[part : part + 2]), threads) for part in range(1, parts)]
    work(0, ends[1])
    for other in others:
        other()


def beside(work: Callable[[], Result], threads: int) -> Callable[[], Result]:
    """Begin with some work in another thread, where there are several.

    What is given back waits for the work and has its result, or raises what it raised. With one
    thread it does the work when it is called.
    """
    return work if threads == 1 else _pool(threads).submit(work).result
