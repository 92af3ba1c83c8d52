"""The fewest clicks and drags that paint some patches and leave others alone."""

from __future__ import annotations

from collections import deque

import cv2
import numpy as np
from numpy.typing import NDArray

_FOUR = 4
Mask = NDArray[np.bool_]


def clicks(need: Mask) -> list[tuple[int, ...]]:
    """One click a patch.

    Parameters
    ----------
    need : array of bool, shape (rows, cols)
    """
    return [(int(cell),) for cell in np.flatnonzero(need)]


def drags(need: Mask, may: Mask) -> list[tuple[int, ...]]:
    """Paths from patch to patch across edges that reach all of `need` inside `may`.

    One drag can walk all of a connected area and pass a patch twice, so an area costs one. No hand
    goes exactly through a corner, so patches that only share one are not connected.

    Parameters
    ----------
    need, may : arrays of bool, shape (rows, cols)
        Patches that must be painted, and those that may be.
    """
    areas, of = cv2.connectedComponents((need | may).astype(np.uint8), connectivity=_FOUR)
    paths = [_walk(need & (of == area), of == area) for area in range(1, areas)]
    return [path for path in paths if path]


def _walk(need: Mask, area: Mask) -> tuple[int, ...]:
    """A walk inside `area` over all of `need`, always on to the nearest patch left."""
    left = {int(cell) for cell in np.flatnonzero(need)}
    if not left:
        return ()
    path = [min(left)]
    left.discard(path[0])
    while left:
        path += _way_to_nearest(path[-1], left, area)
        left -= set(path)
    return tuple(path)


def _way_to_nearest(start: int, goals: set[int], area: Mask) -> list[int]:
    """The shortest way from a patch to one of `goals`, without the patch itself."""
    came_from = {start: start}
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell in goals:
            way = []
            while cell != start:
                way.append(cell)
                cell = came_from[cell]
            return way[::-1]
        for neighbour in _neighbours(cell, area):
            if neighbour not in came_from:
                came_from[neighbour] = cell
                queue.append(neighbour)
    raise ValueError("the area is not connected")


def _neighbours(cell: int, area: Mask) -> list[int]:
    rows, cols = area.shape
    row, col = divmod(cell, cols)
    around = ((row - 1, col), (row, col - 1), (row, col + 1), (row + 1, col))
    return [r * cols + c for r, c in around if 0 <= r < rows and 0 <= c < cols and area[r, c]]
