"""Optical flow: points followed from frame to frame, and the motion that most of them share."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, U8, Bools, median
from tokt.features.frames.grid import Grid

MIN_SIDE_PX = 64
"""A smaller picture has too few points to follow."""
_CELL_HIGH, _CELL_WIDE = 14, 18
"""One point at most is taken from each cell of so many pixels: the sharpest corner in it."""
_WITHIN, _OUTSIDE = 60, 40
"""Most points that are followed where something was seen, and elsewhere."""
_OVER_MEDIAN, _OVER_NOISE = 2.0, 4e-5
"""A corner counts from so many times the sharpness of the picture's median cell: the rest of open
water is the camera's noise, which stands still in the picture. In a picture full of texture it
counts from so many times the square of what is finest (its Laplacian, a quarter of the cells)."""
_LK: dict[str, Any] = {"winSize": (15, 15), "maxLevel": 3}
_BACK_PX = 0.5  # what is followed forwards and back ends this near to where it began


class FlowPicture:
    """A gray picture, uint8 (height, width), as points are followed in it.

    Its local contrast is made even: at sea it is a few grey levels, and falls to the edges.
    """

    def __init__(self, gray: U8) -> None:
        sharp = gray.astype(np.float32)
        sharp -= cv2.blur(sharp, (25, 25))
        spread = np.asarray(cv2.blur(sharp * sharp, (61, 61)), np.float32)
        # A running sum of a flat picture may end below 0.
        np.maximum(spread, 0, out=spread)
        np.sqrt(spread, out=spread)
        spread += 1
        sharp *= 30
        sharp /= spread
        sharp += 128
        self.even = np.clip(sharp, 0, 255, out=sharp).astype(np.uint8)
        self.size = gray.shape

    def points(self, seen: U8) -> F32:
        """The sharpest corners, float32 (n, 2) as x, y; most of them where `seen` is not 0."""
        grid = Grid(self.size[0] // _CELL_HIGH, self.size[1] // _CELL_WIDE, None)
        high, wide = grid.patch_size(*self.size)
        corners = _cells(cv2.cornerMinEigenVal(self.even, 5), grid)
        sharpest = corners.max(axis=1).max(axis=2).ravel()
        fine = _cells(cv2.Laplacian(self.even, cv2.CV_16S), grid)
        finest = np.abs(fine).sum(axis=1, dtype=np.int32).sum(axis=2).ravel() / (high * wide)
        noise = float(np.percentile(finest, 25))
        least = min(_OVER_MEDIAN * float(median(sharpest)), _OVER_NOISE * noise * noise)
        order = np.argsort(-sharpest, kind="stable")
        order = order[sharpest[order] > least]
        row, col = np.divmod(order, grid.cols)
        best = corners[row, :, col].reshape(len(order), high * wide).argmax(axis=1)
        y, x = np.zeros((2, grid.n_patches), np.int64)
        y[order], x[order] = row * high + best // wide, col * wide + best % wide
        within = seen[y[order], x[order]] != 0
        chosen = np.concatenate([order[within][:_WITHIN], order[~within][:_OUTSIDE]])
        return np.stack([x[chosen], y[chosen]], axis=1).astype(np.float32)


def _cells(picture: NDArray[Any], grid: Grid) -> NDArray[Any]:
    """A view of the pixels in cells: (rows, height, cols, width)."""
    high, wide = grid.patch_size(*picture.shape)
    inside = picture[: grid.rows * high, : grid.cols * wide]
    return inside.reshape(grid.rows, high, grid.cols, wide)


class PointFlow(NamedTuple):
    """Points that were followed from one frame to the next, float32 (n, 2) each as x, y."""

    then: F32
    now: F32


def follow(before: FlowPicture, after: FlowPicture, points: F32) -> PointFlow:
    """Those of the points that are found again, forwards and back (Lucas and Kanade, pyramids)."""
    if not len(points):
        return PointFlow(points, points)
    lucas_kanade: Any = cv2.calcOpticalFlowPyrLK  # its types do not know of no first guess
    there, found, _ = lucas_kanade(before.even, after.even, points, None, **_LK)
    height, width = after.size
    inside = ((there >= 0) & (there < [width, height])).all(axis=1) & (found.ravel() > 0)
    points, there = points[inside], np.asarray(there[inside], np.float32)
    if not len(points):
        return PointFlow(points, there)
    back, again, _ = lucas_kanade(after.even, before.even, there, None, **_LK)
    kept = (np.abs(back - points).max(axis=1) < _BACK_PX) & (again.ravel() > 0)
    return PointFlow(points[kept], there[kept])


_SHARED, _SHARED_POINTS = 0.7, 7
"""Part of the points that a common motion has to explain, and how many that are at least."""


def common_motion(tracks: PointFlow, which: Bools) -> NDArray[Any] | None:
    """The turn, shift and growth (2, 3) that most of `which` points share, or None."""
    if np.count_nonzero(which) < _SHARED_POINTS:
        return None
    then, now = tracks.then[which], tracks.now[which]
    made, agree = cv2.estimateAffine2D(
        then, now, method=cv2.RANSAC, ransacReprojThreshold=1.0, maxIters=100
    )
    return made if made is not None and agree.mean() >= _SHARED else None
