"""Area resize and gray conversion by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .checks import check_frame, check_size


def resized_gray(
    frame: NDArray[np.uint8], height: int, width: int, threads: int = 1
) -> NDArray[np.uint8]:
    """A frame resized by area, then gray, each step rounded to whole grey levels.

    Parameters
    ----------
    frame : array of uint8, shape (rows, columns) or (rows, columns, 3)
        Gray or BGR.
    height, width : int
        Of the picture, in pixels.
    threads : int
        Taken so that all kernels are called alike; OpenCV has threads of its own.

    Returns
    -------
    numpy.ndarray
        uint8, shape (height, width); the frame itself when it is gray and of that size.

    Raises
    ------
    TypeError, ValueError
        If the frame is not (rows, columns) or (rows, columns, 3) of uint8, or a size not positive.

    References
    ----------
    OpenCV ``resize`` with ``INTER_AREA``; ITU-R BT.601.
    """
    picture = check_frame(frame, threads)
    check_size(height, width)
    if (height, width) != picture.shape[:2]:
        picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
    if picture.ndim == 3:
        picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    return picture.astype(np.uint8, copy=False)
