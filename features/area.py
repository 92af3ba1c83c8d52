"""Area resize and gray conversion by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def opencv_gray(frame: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """A frame resized with INTER_AREA, then gray (ITU-R BT.601).

    Parameters
    ----------
    frame : array of uint8, shape (rows, columns) or (rows, columns, 3)
        Gray or BGR.
    height, width : int
        Of the picture, in pixels.

    Returns
    -------
    numpy.ndarray
        uint8, shape (height, width); the frame itself when it is gray and of that size.
    """
    picture = frame
    if (height, width) != frame.shape[:2]:
        picture = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA))
    if picture.ndim == 3:
        picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
    return picture.astype(np.uint8, copy=False)
