"""One cloud of several frames: the places that they agree on, averaged."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F32, F64, I64
from tokt.inference.stereo.matching import BLOCK_PX, SETTINGS_WIDTH
from tokt.inference.stereo.odometry import Pose
from tokt.inference.stereo.rectify import Rectifier

from .cloud import NEAREST_M

# Settings in pixels of a view `SETTINGS_WIDTH` wide. Source: rendered missions with exact depth,
# and the mission of 2016.
_MIN_BLOCK_PX = 9
AGREE_PX, SAME_PX = 1.5, 4.0
"""Disparities of one place in two frames: those that differ by less than the first are averaged,
those that differ by less than the second are of one surface, and no second one is made of it."""
AGREEING = 3
"""Frames that show a place, or it is noise."""


def fused_block_px(frames: int) -> float:
    """Block for matching so many frames: a large one flattens what is rough, and widens what is
    thin. Noise falls with it, and with the square root of the frames: it is to be half one pair's.
    """
    return max(_MIN_BLOCK_PX, 2 * BLOCK_PX / math.sqrt(max(frames, 1)))


class PosedView(NamedTuple):
    """One frame's disparities and where it was taken from."""

    frame: int
    disparity_px: F32  # nan where there is none
    pose: Pose


def fused(rectifier: Rectifier, views: Sequence[PosedView]) -> Iterator[tuple[PosedView, F64, I64]]:
    """What at least `AGREEING` views agree on, told by the nearest one, which measures best.

    Yields
    ------
    view : PosedView
    points_m : array of float64, shape (n, 3)
        In the axes of the view's left camera; no place is told twice.
    pixels : array of int64, shape (n, 2)
        Their x and y in the view.
    """
    px = rectifier.size[0] / SETTINGS_WIDTH
    todo = {view.frame: np.isfinite(view.disparity_px) for view in views}
    seeing = [view for view in views if todo[view.frame].any()]
    for view in sorted(seeing, key=lambda one: -np.nanmedian(one.disparity_px)):
        pixels = np.argwhere(todo[view.frame])[:, ::-1]
        points = rectifier.points_m(view.disparity_px, todo[view.frame])
        points = points @ view.pose.rotation.T + view.pose.position_m
        weight = view.disparity_px[todo[view.frame]].astype(np.float64) ** 4
        total, agreeing, same = weight[:, None] * points, np.ones(len(points), np.int64), []
        for other in seeing:
            if other is not view:
                point, place, off_px, surface, measured = _sight(rectifier, other, points)
                agree, alike = off_px < AGREE_PX * px, off_px < SAME_PX * px
                total[point[agree]] += measured[agree, None] * surface[agree]
                weight[point[agree]] += measured[agree]
                agreeing[point[agree]] += 1
                same.append((todo[other.frame].ravel(), place[alike], point[alike]))
        kept = agreeing >= AGREEING
        for left, place, point in same:
            left[place[kept[point]]] = False
        mean = total[kept] / weight[kept, None]
        yield view, (mean - view.pose.position_m) @ view.pose.rotation, pixels[kept]


def _sight(rectifier: Rectifier, view: PosedView, points_m: F64) -> tuple[I64, I64, F64, F64, F64]:
    """Points of the fixed axes as a view shows them: their indices, where it measures anything.

    Then the pixels' places; by how many px of disparity what is measured there is off; that
    surface's points in the fixed axes; and their weights.
    """
    width, height = rectifier.size
    own = (points_m - view.pose.position_m) @ view.pose.rotation
    x, y, z = (own @ rectifier.rotations[0].T).T
    z = np.maximum(z, NEAREST_M)
    column, row = (
        np.rint(each / z * rectifier.focal_px + middle).astype(np.int64)
        for each, middle in zip((x, y), rectifier.principal, strict=True)
    )
    inside = np.flatnonzero((column >= 0) & (row >= 0) & (column < width) & (row < height))
    place = row[inside] * width + column[inside]
    seen = np.isfinite(view.disparity_px.ravel()[place])
    point, place = inside[seen], place[seen]
    found = view.disparity_px.ravel()[place].astype(np.float64)
    due = rectifier.focal_baseline_px_m / z[point]
    surface = own[point] * (due / found)[:, None]
    surface = surface @ view.pose.rotation.T + view.pose.position_m
    return point, place, np.abs(found - due), surface, found**4
