"""The pixels of many small boxes at once: numpy's cost for each call would be most of a frame's."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]

_AT_ONCE = 200_000
"""Pixels, unless one box has more: their arrays stay in the cache."""


def pixels_of_boxes(low: Index, high: Index) -> Iterator[tuple[Index, Index, Index]]:
    """Every pixel of every box, box by box and row by row, some boxes at a time.

    Parameters
    ----------
    low, high : (n, 2) arrays
        First column and row of each box, and those after its last; empty where not larger.

    Yields
    ------
    which, column, row : (pixels,) arrays
        The number of the box that each pixel is of, and where it is.
    """
    size = np.maximum(high - low, 0)
    count = size[:, 0] * size[:, 1]
    ends = np.cumsum(count)
    first = 0
    while first < len(count):
        before = ends[first] - count[first]
        last = max(int(np.searchsorted(ends, before + _AT_ONCE, "right")), first + 1)
        which = np.repeat(np.arange(first, last), count[first:last])
        place = np.arange(before, ends[last - 1]) - (ends - count)[which]
        row, column = np.divmod(place, np.maximum(size[which, 0], 1))
        yield which, column + low[which, 0], row + low[which, 1]
        first = last
