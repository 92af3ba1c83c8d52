"""A short mark of a picture's pixels, by which a log tells later whether they are still the same.

It has to cost less than a tenth of a millisecond a picture in the loop, so it looks at every 32nd
row only: a picture that was stored anew, resized or exchanged has another mark, one in which a
few pixels were painted over may not.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

ROW_STEP = 32
"""0.07 ms for 1360x1024 in colour, 0.03 ms gray."""


def pixel_mark(picture: NDArray[np.uint8]) -> str:
    """The mark: CRC-32 over the shape and every 32nd row, from the 16th on.

    Parameters
    ----------
    picture : array of uint8, shape (height, width) or (height, width, 3)

    Returns
    -------
    str
        Eight hexadecimal digits.
    """
    rows = np.ascontiguousarray(picture[min(ROW_STEP // 2, len(picture) // 2) :: ROW_STEP])
    return f"{zlib.crc32(rows.data, zlib.crc32(repr(picture.shape).encode())):08x}"
