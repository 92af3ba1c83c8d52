"""16-bit gray pictures and their quantization by the compiled extension, as in `numpy_pictures`."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid

from . import _native, numpy_pictures
from .checks import check_frame, check_gray, check_gray16
from .compiled_scratch import SCRATCH
from .numpy_pictures import check_gray16_size, gray16_step, overlaps
from .quantization import FRAME, MIN_AROUND, RATIO, RATIO_OF, STEPS_PER_LEVEL, Quantization
from .threads import over_rows

_MAX_SUM = (1 << 31) - 1


@lru_cache(maxsize=16)
def _gray16_tables(source: int, target: int) -> Any:
    first, weight = overlaps(source, target)
    counts = np.count_nonzero(weight, axis=0)
    return _native.Gray16Tables(
        np.concatenate([[0], counts.cumsum()]).astype(np.int32),
        first.astype(np.int32),
        weight.T[weight.T > 0].astype(np.int32),
    )


def resized_gray16(
    frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
) -> NDArray[np.uint16]:
    """A frame resized by area and gray, in 1/256 grey level, in one pass over it.

    Takes and gives what `numpy_pictures.resized_gray16` does, to the last bit.

    Raises
    ------
    TypeError, ValueError
        If the frame is not (rows, columns) or (rows, columns, 3) of uint8, or a size not positive.
    """
    frame = check_frame(frame, threads)
    check_gray16_size(frame.shape, height, width)
    if 255 * frame.shape[0] * frame.shape[1] > _MAX_SUM:
        return numpy_pictures.resized_gray16(frame, height, width)
    rows, columns = _gray16_tables(frame.shape[0], height), _gray16_tables(frame.shape[1], width)
    step = gray16_step(frame.shape)
    pixels = frame.reshape(*frame.shape[:2], -1)
    gray16 = np.empty((height, width), np.uint16)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("gray16", _native.gray16_scratch_size(pixels, width), np.int32)
        _native.resized_gray16(pixels, rows, columns, first, last, step, scratch, gray16)

    over_rows(work, height, threads)
    return gray16


@lru_cache(maxsize=16)
def _quantizer(quantization: Quantization) -> Any:
    return _native.Quantizer(
        quantization.smooth,
        quantization.window,
        quantization.by == RATIO,
        RATIO_OF * STEPS_PER_LEVEL,
        MIN_AROUND * STEPS_PER_LEVEL,
        quantization.offset,
        quantization.levels - 1,
    )


def quantize(
    gray16: NDArray[np.uint16], quantization: Quantization, threads: int = 1
) -> NDArray[np.uint8]:
    """A 16-bit gray picture quantized.

    Takes and gives what `numpy_pictures.quantize` does, to the last bit.

    Raises
    ------
    TypeError, ValueError
        If `gray16` is not a two-dimensional array of uint16.
    """
    gray16 = check_gray16(gray16, threads)
    kernel = _quantizer(quantization)
    size = kernel.scratch_size(gray16.shape[1])
    total = _native.gray16_total(gray16) if quantization.by == FRAME else 0
    scale = quantization.scale(total, gray16.size)
    picture = np.empty(gray16.shape, np.uint8)

    def work(first: int, last: int) -> None:
        scratch = SCRATCH.array("quantize", size, np.float64)
        kernel.rows(gray16, scale, first, last, scratch, picture)

    over_rows(work, len(gray16), threads)
    return picture


def level_counts(gray: NDArray[np.uint8], grid: Grid, threads: int = 1) -> NDArray[np.int64]:
    """Histograms of 256 levels, one a patch, int64, shape (n_patches, 256).

    Raises
    ------
    TypeError, ValueError
        If `gray` is not a two-dimensional array of uint8.
    """
    gray = check_gray(gray, threads)
    patch_height, patch_width = grid.patch_size(*gray.shape)
    counts = np.empty((grid.n_patches, 256), np.int64)

    def work(first: int, last: int) -> None:
        _native.level_counts(gray, grid.cols, patch_height, patch_width, first, last, counts)

    over_rows(work, grid.rows, threads)
    return counts
