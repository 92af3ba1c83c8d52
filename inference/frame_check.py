"""Whether a picture is one that can be judged at all: not black, not blank, not saturated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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

_STEP_PX = 4
"""Every fourth pixel in each direction is looked at: enough for whole-frame figures."""


def frame_fault(frame: NDArray[np.uint8]) -> str:
    """Why a frame is outside what can be judged, or an empty string.

    Parameters
    ----------
    frame : array of uint8, shape (height, width) or (height, width, channels)
        As the camera gave it.
    """
    if frame.dtype != np.uint8 or frame.ndim not in (2, 3) or 0 in frame.shape:
        return f"the frame is {frame.dtype} of shape {frame.shape}, not an 8-bit picture"
    sample = frame[::_STEP_PX, ::_STEP_PX].astype(np.float32)
    gray = sample if sample.ndim == 2 else sample[..., :3].mean(axis=2)
    if np.percentile(gray, 99.9) < DARK_GREY:
        return "the frame is too dark to judge"
    if gray.std() < BLANK_GREY:
        return "the frame is blank"
    if np.mean(gray >= SATURATED_GREY) >= SATURATED_FRACTION:
        return "the frame is saturated"
    return ""
