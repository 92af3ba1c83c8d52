"""Nearly black frames with their contrast raised, for eyes only."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..pictures import enhanced

RAISED_IS = "lightness (CIELAB) by local contrast, CLAHE with clip limit 6 on 6x6 tiles"


def raised(frame: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """A frame resized, with its contrast raised as `RAISED_IS` says.

    Parameters
    ----------
    frame : array of uint8, shape (h, w) or (h, w, 3)
        Gray or BGR, as decoded.
    width, height : int
        Of the result, in pixels.

    Returns
    -------
    array of uint8, shape (height, width, 3)
        RGB.
    """
    small = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
    if small.ndim == 2:
        return np.asarray(
            cv2.cvtColor(enhanced(np.asarray(small, np.uint8)), cv2.COLOR_GRAY2RGB), np.uint8
        )
    lab = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2LAB), np.uint8)
    lab[..., 0] = enhanced(np.ascontiguousarray(lab[..., 0]))
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), np.uint8)
