r"""Epipolar drift: how far apart a pair has the rows of its views, and a slow correction of it.

A thing stands in one row of both rectified views. A camera that was knocked since the calibration
moves its view up or down, by 2.2 px at full resolution between two dives of one week: matching
bears it, but loses matches (a third of them at 4 px, half and more at 6 px).

::

      left view            right view             offset: the right view stands r px too high,
      |        |           |   ___  | -- r        and is moved down by +r.
      |   ___  | -- row -- |        |             turn: the offset grows from left to right,
      |        |           |        |             r = r0 + tan(turn) * (x - x0)

Measured on the 246 pairs of the sea trial, pixels of the full resolution; thresholds stand above
the extremes of the odd frames and hold on the even ones (odd / even; `TURN_SIGNIFICANCE` was raised
once for an even one). A true pair's offset is at most 0.38 / 0.48, its spread 1.05 / 0.91. With the
right frames moved by 1, 2.2, 4 and 6 px either way, one pair measures 0.89 to 0.97 of it (median
over 11 pairs each; 0.3 to 1.4 in the worst, a faint thing and one at 1.8 m), and the correction is
within 0.5 px after 5 to 16 pairs in which the tower is seen. Matching needs
no help for that: at 6 px it still matches 0.41 of the texture and more. Farther than 7 px off this
measures too little, and too few pairs are accepted.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64, Bools

if TYPE_CHECKING:
    from .matching import Matches

# What is measured from one pair, in pixels of the views (half resolution).
POINTS = 48
"""Matches that are looked at: with 300 the offset differs by 0.1 px, in several times the time."""
POOL = 384
"""Matches, evenly spread over all, of which the `POINTS` with the clearest rows are taken."""
STRATA = 4
"""Columns' quarters that give the same number of points, so that a turn is seen."""
GRID_STEP = 4
"""Only every fourth row and column of the matches is looked at: neighbours tell the same."""
PATCH_RADIUS = 5
SEARCH_ROWS = 4
MIN_CORRELATION = 0.8
"""Correlation that a point's patch must reach in its best row. Median of true pairs: 0.95 to
0.99, of chance matches 0.73 to 0.92."""
MIN_POINTS = 20
"""Fewest points that reach it."""
_MIN_ERROR_PX = 0.1
"""Least standard error of a row offset at either side of the points: neighbours err together."""

# What the correction accepts and how it follows, in pixels of the full resolution.
LIMIT_PX = 6.0
"""Largest correction. Source: 2.2 px is the largest offset met, and a camera that has moved by more
than this has turned as well, and needs a calibration."""
MAX_SPREAD_PX = 1.2
"""Spread of a pair that may move the correction. True pairs: at most 1.05 / 0.91."""
MIN_AGREEING = 0.7
"""Part of the points with `MIN_CORRELATION` in a pair that may move the correction. True pairs:
0.79 / 0.72 and more."""
MAX_TURN_DEG = 0.4
TURN_SIGNIFICANCE = 6.0
"""Times its own error that a turn must be. True pairs that seem turned by `MAX_TURN_DEG` and more:
at most 2.7 / 3.1."""
REMEMBERED_PAIRS = 15
SETTLED_PAIRS = 5
"""Fewest accepted pairs before the correction moves."""
MAX_VARIATION_PX = 0.5
"""Median deviation among the remembered pairs' offsets with which it moves. A right camera
that is out of step gives another offset at every pair: 1 px and more."""
STEP_PX = 1.0
"""Most that one pair moves the correction."""
STILL_PX = 0.5
"""Smaller corrections are left: they gain no match, and true pairs seem off by as much."""


@dataclass(frozen=True)
class EpipolarOffset:
    """The vertical offset of one pair's views, which rectification should have removed."""

    px: float  # pixels of the full resolution by which the right view stands too high; median
    spread_px: float  # median deviation from it
    turn_deg: float  # by which the right view is turned against the left one, clockwise
    turn_error_deg: float  # its standard error
    agreeing: float  # part of the points whose patch is found again within the rows searched

    @property
    def turned(self) -> bool:
        """Whether the views are turned against each other beyond doubt."""
        turn = abs(self.turn_deg)
        return turn > MAX_TURN_DEG and turn > TURN_SIGNIFICANCE * self.turn_error_deg


def epipolar_offset(
    left_view: F32, right_view: F32, matches: Matches, scale: float
) -> EpipolarOffset | None:
    """Measure how the rows of a pair lie to each other, from its block matches.

    None with fewer than `MIN_POINTS` clear points. `scale` is the width of the views over the
    frames'.
    """
    points = _clear_points(left_view, matches)
    if points is None:
        return None
    rows, columns, disparity = points
    lower, correlation, inside = _row_shifts(left_view, right_view, rows, columns, disparity)
    good = inside & (correlation >= MIN_CORRELATION)
    count = int(np.count_nonzero(good))
    if count < MIN_POINTS:
        return None
    higher = -lower[good] / scale
    middle = _median(higher)
    spread = _median(np.abs(higher - middle))
    turn, error = _turn(columns[good] / scale, higher)
    return EpipolarOffset(middle, spread, turn, error, count / len(good))


def _clear_points(view: F32, matches: Matches) -> tuple[I64, I64, F32] | None:
    """Rows, columns and disparities of the matches whose patches tell rows apart."""
    height, width = view.shape
    margin = PATCH_RADIUS + SEARCH_ROWS
    first = -(-margin // GRID_STEP) * GRID_STEP  # a row that every coarser matching has, too
    coarse = matches.valid[first : height - margin : GRID_STEP, ::GRID_STEP]
    found = np.flatnonzero(coarse)
    if len(found) > POOL:
        found = found[np.linspace(0, len(found) - 1, POOL).astype(np.int64)]
    rows, columns = np.divmod(found, max(coarse.shape[1], 1))
    rows, columns = rows * GRID_STEP + first, columns * GRID_STEP
    disparity = matches.disparity_px[rows, columns]
    there = columns - disparity
    inside = (columns >= PATCH_RADIUS) & (columns < width - PATCH_RADIUS)
    inside &= (there >= PATCH_RADIUS) & (there < width - PATCH_RADIUS - 1)
    rows, columns, disparity = rows[inside], columns[inside], disparity[inside]
    if len(rows) < MIN_POINTS:
        return None
    evenness = -np.abs(view[rows + 2, columns] - view[rows - 2, columns])
    by_column = np.argsort(columns, kind="stable")
    strata = np.array_split(by_column, STRATA)
    clearest = [part[np.argsort(evenness[part])[: POINTS // STRATA]] for part in strata]
    chosen = np.concatenate(clearest)
    return rows[chosen], columns[chosen], disparity[chosen]


def _row_shifts(
    left_view: F32, right_view: F32, rows: I64, columns: I64, disparity: F32
) -> tuple[F64, F64, Bools]:
    """For each point how many rows lower it stands in the right view, and how well it is found.

    Returns the shift in rows of the view, the normalised correlation there, and whether the best
    row is not the outermost one.
    """
    side = 2 * PATCH_RADIUS + 1
    top, start = rows - PATCH_RADIUS, columns - PATCH_RADIUS
    patches = sliding_window_view(left_view, (side, side))[top, start]
    there = start - disparity
    whole = np.floor(there).astype(np.int64)
    part = (there - whole).astype(np.float32)[:, None, None]
    high, wide = side + 2 * SEARCH_ROWS, side + 1
    strips = sliding_window_view(right_view, (high, wide))[top - SEARCH_ROWS, whole]
    strips = strips[:, :, :-1] * (1 - part) + strips[:, :, 1:] * part
    correlation = _correlation(patches, strips)

    best = correlation.argmax(axis=1)
    inside = (best > 0) & (best < 2 * SEARCH_ROWS)
    middle, point = best.clip(1, 2 * SEARCH_ROWS - 1), np.arange(len(best))
    above, at, below = (correlation[point, middle + step] for step in (-1, 0, 1))
    bend = np.minimum(above - 2 * at + below, -1e-6)  # a parabola through the best three
    shift = middle - SEARCH_ROWS + 0.5 * (above - below) / bend
    return shift, correlation[point, best], inside


def _correlation(patches: F32, strips: F32) -> F64:
    """Normalised correlation of each patch with each place down its strip, shape (n, places)."""
    side = patches.shape[1]
    patches = patches - patches.mean(axis=(1, 2), keepdims=True)
    windows = sliding_window_view(strips, side, axis=1)
    product = np.einsum("prc,pscr->ps", patches, windows)
    # Sums over a window are sums over its rows' sums.
    ones = np.ones(side)
    sums = sliding_window_view(strips.sum(axis=2), side, axis=1) @ ones
    squares = sliding_window_view(np.einsum("prc,prc->pr", strips, strips), side, axis=1) @ ones
    energy = squares - sums * sums / side**2
    own = np.einsum("prc,prc->p", patches, patches)[:, None]
    return np.asarray(product / np.sqrt(np.maximum(energy * own, 1e-6)), np.float64)


def _median(values: NDArray[Any]) -> float:
    """The upper median; numpy's own takes four times as long for so few numbers."""
    return float(np.sort(values)[len(values) // 2])


def _turn(x_px: NDArray[Any], higher_px: NDArray[Any]) -> tuple[float, float]:
    """Degrees by which rows rise or fall along x, robustly, and the standard error of that."""
    x = x_px - x_px.mean()
    weights = np.ones(len(x))
    for _ in range(4):  # least absolute deviations by re-weighted least squares
        total = weights.sum()
        aside, height = x - weights @ x / total, higher_px - weights @ higher_px / total
        weighted = weights * aside
        slope = float(weighted @ height) / max(float(weighted @ aside), 1.0)
        residual = np.abs(height - slope * aside)
        weights = 1 / np.maximum(residual, 0.3)
    # 1.48: from a median deviation to a standard one; 1.25: of a median instead of a mean.
    sigma = 1.25 * 1.48 * _median(residual) / math.sqrt(len(x))
    error = max(sigma, _MIN_ERROR_PX) / max(float(x.std()), 1.0)
    # A view turned clockwise has its right side too low.
    return -math.degrees(math.atan(slope)), math.degrees(math.atan(error))


class EpipolarDriftCorrection:
    """Follow the row offset of a pair of cameras over a dive, slowly and within a limit.

    A pair moves it only where its matches agree (`MAX_SPREAD_PX`, `MIN_AGREEING`, not turned) and
    the last accepted pairs agree among themselves: a wrong right frame, or a camera out of step,
    leaves it where it is. Memory is `REMEMBERED_PAIRS` numbers.

    It follows whatever is constant. While a camera is out of step *and* the vehicle rises or sinks
    evenly, the offset that this makes is constant too, and is corrected as long as it lasts. When
    the motion changes the offsets no longer agree: `tokt.inference.stereo.pair_health` tells it.
    """

    def __init__(self) -> None:
        self.px = 0.0
        """The correction: pixels of the full resolution by which to move the right view down."""
        self.deviation_px: float | None = None
        """How far the last pair's offset is from that of those before it; None where it could not
        be measured, or those before do not agree on one."""
        self._recent: deque[float] = deque(maxlen=REMEMBERED_PAIRS)

    @property
    def variation_px(self) -> float | None:
        """Median deviation of the remembered pairs' offsets; None with fewer than a few pairs."""
        if len(self._recent) < SETTLED_PAIRS:
            return None
        return _median(np.abs(np.array(self._recent) - self._middle()))

    @property
    def settled(self) -> bool:
        """Whether enough pairs agree on one offset, so that another one means something."""
        variation = self.variation_px
        return variation is not None and variation <= MAX_VARIATION_PX

    def add(self, left: F32, right: F32, matches: Matches, scale: float) -> EpipolarOffset | None:
        """Measure a pair whose right view has the present correction, and follow it.

        Gives what is left of the offset beside that correction; None where it cannot be measured.
        """
        offset = epipolar_offset(left, right, matches, scale)
        self.deviation_px = None
        if offset is None:
            return None
        whole = self.px + offset.px
        if self.settled:
            self.deviation_px = abs(whole - self._middle())
        fits = offset.spread_px <= MAX_SPREAD_PX and offset.agreeing >= MIN_AGREEING
        if fits and not offset.turned:
            self._recent.append(whole)
            if self.settled:
                self._follow()
        return offset

    def _middle(self) -> float:
        return _median(np.array(self._recent))

    def _follow(self) -> None:
        goal = float(np.clip(self._middle(), -LIMIT_PX, LIMIT_PX))
        if abs(goal - self.px) > STILL_PX:
            self.px += float(np.clip(goal - self.px, -STEP_PX, STEP_PX))
