"""Local contrast normalisation: what is dim in a view counts as much as what is bright."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

MIN_SIGMA_GREY = 1.0
"""Grey levels. A local deviation below counts as this much, or noise alone would fill the view."""
_MIDDLE = 128.0


def local_mean_and_sigma(
    view: NDArray[np.float32], window_px: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and standard deviation around each pixel.

    Parameters
    ----------
    view : array of float32, shape (height, width)
        Grey levels.
    window_px : int
        Height and width in pixels of what counts as around.

    Returns
    -------
    (mean, sigma) : arrays of float32, shape (height, width)
        Grey levels.
    """
    window = (window_px, window_px)
    mean = cv2.boxFilter(view, cv2.CV_32F, window)
    variance = cv2.sqrBoxFilter(view, cv2.CV_32F, window)
    cv2.subtract(variance, cv2.multiply(mean, mean), dst=variance)
    np.maximum(variance, 0, out=variance)
    sigma = cv2.sqrt(variance)
    return np.asarray(mean, np.float32), np.asarray(sigma, np.float32)


def even_contrast(
    view: NDArray[np.float32],
    mean: NDArray[np.float32],
    sigma: NDArray[np.float32],
    gain: float,
) -> NDArray[np.uint8]:
    """The view with the same local contrast everywhere, 128 being the local mean.

    Parameters
    ----------
    view, mean, sigma : arrays of float32, shape (height, width)
        A view, and what `local_mean_and_sigma` says of it.
    gain : float
        Grey levels that one local standard deviation becomes.
    """
    even = cv2.subtract(view, mean)
    cv2.divide(even, np.maximum(sigma, MIN_SIGMA_GREY), dst=even, scale=gain)
    raised = cv2.addWeighted(even, 1.0, even, 0.0, _MIDDLE, dtype=cv2.CV_8U)
    return np.asarray(raised, np.uint8)
