"""One cloud of several frames: places that they agree on, averaged along the lines of sight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from tokt.features.common.arrays import F32, F64, I64, Bools
from tokt.inference.stereo.matching import (
    BLOCK_PX,
    MIN_SIGMA_GREY,
    SETTINGS_WIDTH,
    Matches,
    local_mean_and_sigma,
)
from tokt.inference.stereo.odometry import Motion
from tokt.inference.stereo.rectify import Rectifier

from .cloud import NEAREST_M

# Settings in pixels of a view `SETTINGS_WIDTH` wide. Source: a rendered mission with exact depth
# (seed 1), and every second frame of the mission of 2016.
MIN_WINDOW_PX = 7
"""What a pixel is matched anew with, at least. One pair needs a block of `BLOCK_PX`, which widens
what is thin and flattens what is rough. Of several pairs the noise is averaged out."""
_LESS_NOISE = 2.2
"""Even so there must be that much less of it than in one pair's matches."""
_MIN_LIKENESS = 0.5
"""Correlation of the two windows."""
_REACH_PX, _STEP_PX = 1.5, 0.5
AGREE_PX, SAME_PX = 1.5, 4.0
"""Disparities of one place in two frames: those that differ by less than the first are averaged,
those that differ by less than the second are of one surface, and no second one is made of it."""
AGREEING = 3
"""Frames that show a place, or it is noise."""
_SWEEPS = 6
_TILT_PX = 0.5
"""Error of a frame's disparities that calibration and pose leave: of the view's middle, and from
there to its edge in each direction. Frames are levelled against each other as far as that."""
_NOISE_PX = 0.3
_SAMPLE = 3000
"""Pixels of a frame that it is levelled by."""


def sharpened(left: F32, right: F32, matches: Matches, frames: int) -> F32:
    """The disparities matched anew within a small window; nan where that finds nothing alike.

    Parameters
    ----------
    left, right : array of float32, shape (height, width)
        The rectified views.
    frames : int
        That are joined.
    """
    of_block = max(_LESS_NOISE / math.sqrt(frames), MIN_WINDOW_PX / BLOCK_PX)
    wanted = of_block * BLOCK_PX * left.shape[1] / SETTINGS_WIDTH
    window = max(2 * round((wanted - 1) / 2) + 1, 5)
    start = np.where(matches.valid, matches.disparity_px, 0)
    row, column = (np.asarray(each, np.float32) for each in np.indices(left.shape))
    steps = np.arange(-_REACH_PX, _REACH_PX + _STEP_PX, _STEP_PX)
    mean, sigma = local_mean_and_sigma(left, window)
    likeness = np.empty((len(steps), *left.shape), np.float32)
    for place, step in enumerate(steps):
        there = np.asarray(column - start - step, np.float32)
        moved = np.asarray(cv2.remap(right, there, row, cv2.INTER_CUBIC), np.float32)
        other, spread = local_mean_and_sigma(moved, window)
        common = cv2.boxFilter(left * moved, cv2.CV_32F, (window, window)) - mean * other
        likeness[place] = common / np.maximum(sigma * spread, 1e-3)
    best = likeness.argmax(axis=0)
    inner = best.clip(1, len(steps) - 2)
    before, at, after = (
        np.take_along_axis(likeness, (inner + k)[None], axis=0)[0] for k in (-1, 0, 1)
    )
    bend = np.minimum(before - 2 * at + after, -1e-6)
    found = start + steps[inner] + 0.5 * (before - after) / bend * _STEP_PX
    good = matches.valid & (best == inner) & (at > _MIN_LIKENESS) & (sigma > MIN_SIGMA_GREY)
    return np.where(good, found, np.nan).astype(np.float32)


@dataclass
class PosedView:
    """One frame's disparities and where it was taken from."""

    frame: int
    disparity_px: F32  # nan where there is none
    pose: Motion  # from the fixed axes to the left camera's


class FusedPoints(NamedTuple):
    """What several frames agree on, by the frames whose pixels it was worked out for."""

    frame: int
    points_m: F64  # (n, 3) in the fixed axes
    pixels: I64  # (n, 2): x and y in the frame's left view
    away_m: F64  # (n,): from the frame's camera


class _Sight(NamedTuple):
    """Points as another view shows them."""

    frame: int
    row: I64  # (n,): the nearest pixel
    column: I64
    excess_px: F64  # disparity measured there over the point's own; nan where there is none
    surface_m: F64  # (n, 3): the place that is measured there, in the fixed axes
    weight: F64  # of that place: the variance of a depth grows with its fourth power


@dataclass
class Fusion:
    """Join the views of one rectifier; the nearest ones first, which measure best."""

    rectifier: Rectifier
    views: list[PosedView]

    def __post_init__(self) -> None:
        self.views = [view for view in self.views if np.isfinite(view.disparity_px).any()]
        self.views.sort(key=lambda view: -float(np.nanmedian(view.disparity_px)))
        self._px = self.rectifier.size[0] / SETTINGS_WIDTH

    def fused(self) -> Iterator[FusedPoints]:
        """What the frames agree on: no place is told twice."""
        if len(self.views) < AGREEING:
            return
        self._level()
        todo = {view.frame: np.isfinite(view.disparity_px) for view in self.views}
        for view in self.views:
            points, pixels = self._points(view, todo[view.frame])
            sights = list(self._sights(view, points))
            total, more, agreeing = _averaged(sights, AGREE_PX * self._px, len(points))
            weight = view.disparity_px[pixels[:, 1], pixels[:, 0]].astype(np.float64) ** 4
            mean = (total + weight[:, None] * points) / (more + weight)[:, None]
            behind = sum(sight.excess_px < -SAME_PX * self._px for sight in sights)
            kept = (agreeing + 1 >= AGREEING) & (agreeing + 1 > behind)
            for sight in sights:
                same = kept & (np.abs(sight.excess_px) < SAME_PX * self._px)
                todo[sight.frame][sight.row[same], sight.column[same]] = False
            away = np.linalg.norm(view.pose.of(mean[kept]), axis=1)
            yield FusedPoints(view.frame, mean[kept], pixels[kept], away)

    def _level(self) -> None:
        """Take away what tilts the frames' surfaces against each other.

        What calibration and poses leave makes a frame's disparities wrong by up to a pixel, much
        alike in neighbouring pixels: three numbers a frame tell most of it.
        """
        width, height = self.rectifier.size
        rows, columns = np.indices((height, width))
        shape = np.dstack(
            [np.ones((height, width)), 2 * columns / width - 1, 2 * rows / height - 1]
        )
        given = [view.disparity_px for view in self.views]
        tilts = np.zeros((len(given), 3))
        for _ in range(_SWEEPS):
            for place, view in enumerate(self.views):
                tilts[place] = self._tilt_of(view, shape, tilts[place])
                view.disparity_px = self._tilted(given[place], shape, tilts[place])
            # What all frames have alike they cannot tell: none of it is taken away.
            tilts -= tilts.mean(axis=0)
            for view, before, tilt in zip(self.views, given, tilts, strict=True):
                view.disparity_px = self._tilted(before, shape, tilt)

    def _tilted(self, disparity_px: F32, shape: F64, tilt: F64) -> F32:
        return (disparity_px + shape @ tilt * self._px).astype(np.float32)

    def _tilt_of(self, view: PosedView, shape: F64, tilt: F64) -> F64:
        """A view's tilt by what the others measure, where it is tilted so far already."""
        seen = np.flatnonzero(np.isfinite(view.disparity_px))
        some = np.zeros(view.disparity_px.size, bool)
        some[seen[:: max(1, len(seen) // _SAMPLE)]] = True
        points, pixels = self._points(view, some.reshape(view.disparity_px.shape))
        sights = self._sights(view, points)
        total, weight, agreeing = _averaged(sights, SAME_PX * self._px, len(points))
        known = agreeing > 0
        if not known.any():
            return tilt
        surface = total[known] / weight[known, None]
        wanted, own = (self._disparity(view, each) for each in (surface, points[known]))
        here = shape[pixels[known, 1], pixels[known, 0]]
        blocks = len(seen) * known.mean() / (BLOCK_PX * self._px) ** 2
        return _tilt(here, (wanted - own) / self._px + here @ tilt, blocks)

    def _points(self, view: PosedView, mask: Bools) -> tuple[F64, I64]:
        """The places of a view's pixels in the fixed axes, and these pixels, x and y."""
        points = self.rectifier.points_m(view.disparity_px, mask)
        row, column = np.nonzero(mask)
        placed = (points - view.pose.translation_m) @ view.pose.rotation
        return placed, np.column_stack([column, row])

    def _turned(self, view: PosedView, points_m: F64) -> F64:
        """Points in the axes of the rectified view."""
        return np.asarray(view.pose.of(points_m) @ self.rectifier.rotations[0].T)

    def _disparity(self, view: PosedView, points_m: F64) -> F64:
        """What the points have in the view."""
        return self.rectifier.focal_baseline_px_m / self._turned(view, points_m)[:, 2]

    def _sights(self, of: PosedView, points_m: F64) -> Iterator[_Sight]:
        """The points as each other view shows them."""
        known = self.rectifier
        height, width = known.left_inside.shape
        for view in self.views:
            if view is of:
                continue
            x, y, z = self._turned(view, points_m).T
            z = np.maximum(z, NEAREST_M)
            column = x / z * known.focal_px + known.principal[0]
            row = y / z * known.focal_px + known.principal[1]
            found = map_coordinates(
                view.disparity_px, [row, column], np.float64, order=1, cval=np.nan, prefilter=False
            )
            own = known.focal_baseline_px_m / z
            centre = -view.pose.translation_m @ view.pose.rotation
            surface = centre + (points_m - centre) * (own / found)[:, None]
            r, c = (
                np.rint(each).clip(0, end - 1).astype(np.int64)
                for each, end in ((row, height), (column, width))
            )
            yield _Sight(view.frame, r, c, found - own, surface, found**4)


def _averaged(sights: Iterable[_Sight], within_px: float, count: int) -> tuple[F64, F64, I64]:
    """Sum of the places that other views have for `count` points, its weight, and how many."""
    total, weight = np.zeros((count, 3)), np.zeros(count)
    agreeing = np.zeros(count, np.int64)
    for sight in sights:
        agree = np.abs(sight.excess_px) < within_px
        total[agree] += sight.weight[agree, None] * sight.surface_m[agree]
        weight[agree] += sight.weight[agree]
        agreeing += agree
    return total, weight, agreeing


def _tilt(shape: F64, wanted_px: F64, blocks: float) -> F64:
    """The tilt that fits best, robustly, and no larger than is likely; `blocks` are independent."""
    weight: F64 = np.ones(len(wanted_px))
    tilt: F64 = np.zeros(3)
    for _ in range(5):
        pull = shape.T * (weight * blocks / len(wanted_px) / _NOISE_PX**2)
        tilt = np.asarray(np.linalg.solve(pull @ shape + np.eye(3) / _TILT_PX**2, pull @ wanted_px))
        weight = 1 / (1 + np.square((wanted_px - shape @ tilt) / _NOISE_PX))
    return tilt
