"""Whether a picture can be judged at all: not black, blank, saturated, damaged or covered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..features.extractor import gray_picture
from ..features.grid import DEFAULT_GRID, Grid

DARK_GREY = 8.0
"""Grey levels. A frame whose 99.9th percentile stays below is too dark: a covered lens or a
lamp that is out. Measured on the 492 frames of the sea trial of 20 April 2016: 35 and more."""

BLANK_GREY = 1.0
"""Grey levels, standard deviation. A frame below shows nothing: the same measurement gives 7.5
and more, from the fall of the light towards the edges alone."""

SATURATED_GREY = 250
SATURATED_FRACTION = 0.5
"""A frame with this fraction of its pixels at `SATURATED_GREY` or above is saturated. The most
in the same measurement, close to the tower, is 0.02."""

BLANK_PATCHES = 0.03
"""A frame with this fraction of its patches blank is damaged or covered. A patch is blank when all
its pixels have one grey level: a camera's picture has noise, while the missing end of a JPEG and
zeroed data decode to one level. In the same measurement no patch of the 492 frames is blank; the
least standard deviation of one is 0.31 grey levels. A patch that is one level of `SATURATED_GREY`
or more does not count: a close, bright thing gives that."""

PATCH_GRID = DEFAULT_GRID
"""The patches of `BLANK_PATCHES`: those it was measured on, whatever grid a model has, as in
much smaller ones (40x40 at width 360) a real frame does have some blank."""

_LEAST_PATCH_PX = 8
"""Height and width in pixels below which one grey level in a patch proves nothing."""

_STEP_PX = 4
"""Every fourth pixel in each direction is looked at: enough for whole-frame figures."""


def frame_fault(frame: NDArray[np.uint8]) -> str:
    """Why a frame is outside what can be judged, or an empty string.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, 3)
        As the camera gave it.
    """
    picture = frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == 3)
    if frame.dtype != np.uint8 or not picture or 0 in frame.shape:
        return f"the frame is {frame.dtype} of shape {frame.shape}, not an 8-bit picture"
    sample = frame[::_STEP_PX, ::_STEP_PX].astype(np.float32)
    gray = sample if sample.ndim == 2 else sample.mean(axis=2)
    if np.percentile(gray, 99.9) < DARK_GREY:
        return "the frame is too dark to judge"
    if gray.std() < BLANK_GREY:
        return "the frame is blank"
    if np.mean(gray >= SATURATED_GREY) >= SATURATED_FRACTION:
        return "the frame is saturated"
    return _blank_patches_fault(frame)


def _blank_patches_fault(frame: NDArray[np.uint8]) -> str:
    """Why a frame is damaged or covered, or an empty string; small pictures are not looked at."""
    height, width = frame.shape[:2]
    narrow = PATCH_GRID.width is not None and width < PATCH_GRID.width
    # A narrower frame is not enlarged: interpolation makes no new noise.
    grid = Grid(PATCH_GRID.rows, PATCH_GRID.cols, None) if narrow else PATCH_GRID
    resized_height, resized_width = grid.resized(height, width)
    if min(resized_height // grid.rows, resized_width // grid.cols) < _LEAST_PATCH_PX:
        return ""
    cells = grid.cells(gray_picture(frame, grid))
    darkest, brightest = cells.min(axis=(1, 2)), cells.max(axis=(1, 2))
    blank = int(np.sum((darkest == brightest) & (brightest < SATURATED_GREY)))
    if blank < BLANK_PATCHES * grid.n_patches:
        return ""
    return f"{blank} of {grid.n_patches} patches are blank: the picture is damaged or covered"
