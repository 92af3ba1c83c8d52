r"""Pushbroom stereo: a rectified pair looked at for obstacles at a few distances only.

Not the distance of everything is measured, but whether something stands at 8, 6, 4, 3 or 2 m. As
the vehicle moves, these distances sweep through the water like the bristles of a broom, and what
each of them met is remembered. Before an obstacle that takes two fifths of the time of
`disparity.py`; over open water, where both follow faint things, five sixths. It sees less:

::

                         2   3   4       6         8 m
      left camera   *....|...|...|.......|.........|........
                         |   |   |       |         |            seen: A and C, which stand at one
      right camera  *....A...|.x.|...B...C.........|...D....    of the distances (within 5 %)

      x, B, D and whatever is nearer than 2 m: not seen in this pair. On the way towards B the
      6 m line met it, and it is remembered; x, when it has just swum in, was never met.

Clear means: nothing at these distances, nothing remembered, hardly anything with texture, nothing
faint that stays (`faint_matches`, at any distance), and light as open water's (`open_water_fault`).
With texture in view of which nothing is at these distances, the frame is unknown; so it is where
`pair_health` finds a camera frozen or covered. Whether two textured views belong together cannot
be told by a detector that looks at so few disparities, except by the former: a wrong pair has
texture that matches nowhere.

References
----------
A. J. Barry and R. Tedrake, "Pushbroom stereo for high-speed navigation in cluttered
environments", ICRA 2015.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.patch_detail import DETAIL_GRID, detail_grid
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS
from tokt.features.kernels.quantization import STEPS_PER_LEVEL
from tokt.inference.frame import Frame, pair_shape_fault
from tokt.inference.reason import Fault, Reason
from tokt.inference.sight import SightMeter, stereo_meter
from tokt.inference.verdict import PUSHBROOM, STATUS_MEAN_THRESHOLD, Detection

from .calibration import StereoCalibration
from .faint_matches import FaintMatches
from .matching import MIN_SIGMA_GREY, Matches
from .odometry import Motion, Odometry, Pose, motion_between
from .pair_health import PairFault, PairHealth, Unfit, of_both_sides, unfit_pictures
from .rectify import Rectifier

DISTANCES_M = (8.0, 6.0, 4.0, 3.0, 2.0)
"""Where obstacles are looked for along the view's axis, far to near. Beyond 8.4 m the mission's
tower is smaller than `MIN_CELLS`; the others are a few frames of the mission's approach apart."""

VIEW_WIDTH = DETAIL_GRID.width or 360
"""Pixels. The frame check's: one small gray picture of each frame serves both."""

# Settings in pixels of such views. Chosen on the sea trial's frames with odd numbers: no hit in
# 1..99, and none in 180 wrong pairs of 145..211 (the right frame of more than 6 frames before or
# after, upside down, or mirrored). Test, on the even ones: none in 2..98, none in 174 wrong pairs.
# Of 48 pairs of frames that are 2 to 6 apart 5 have some hits: a tower looks much like itself.
BAND = 0.05
"""A distance is a slice of this part of it to either side: between two frames the vehicle moves
by more than the thickness of one disparity. All whole disparities in the slice are tried."""
CELL_PX = 4
BLOCK_CELLS = 3
"""Costs and edges are means over cells, and over blocks of cells around each."""
CONTRAST_WINDOW_PX = 11
EVEN_STEPS = 50
"""Grey levels that one local standard deviation becomes before matching."""
EDGE_GREY = 0.6
"""Grey levels a pixel, mean over a block: the change across columns that makes a block worth
matching in both views. Open water: at most 3 cells of 6030 in the left view."""
MAX_COST = 0.35
"""Mean absolute difference of even contrast, in local standard deviations. The tower's median at
its own disparity 0.2 to 0.3, in wrong pairs at the best of all 0.4 to 0.5."""
INVARIANCE_PX = tuple(range(5, 23, 2))
"""How far beside a slice, to either side, its hits must not match as well: a horizontal edge, or
a pattern that repeats, matches at any distance."""
INVARIANCE_RATIO = 0.55
"""The cost there that a hit's may be at most this part of. The tower's median 0.2 to 0.6 of the
best of all other disparities, in wrong pairs 0.9."""
MIN_CELLS = 12
"""Of a patch of hits."""
TEXTURED_FRACTION = 0.002
"""Of the cells, as much as the smallest patch of hits: with more texture in the left view and no
obstacle the frame is unknown. Frames 1 to 131: at most 4 cells of 6030; the tower, first called an
obstacle at 147, has 14 at 144."""
NEAR_PERCENTILE = 5.0
"""Percentile of the depths that is reported as the distance."""
KEPT_FRAMES = 15
"""How long an obstacle is remembered without odometry: in the mission the tower takes 6 to 12
frames from one distance to the next."""
KEPT_FRAMES_WITH_ODOMETRY = 60


@dataclass(frozen=True)
class Slice:
    """One distance."""

    shifts_px: tuple[int, ...]  # disparities at which obstacles are looked for
    checks_px: tuple[int, ...]  # those beside them at which they must not match as well


@dataclass(frozen=True)
class NormalizedView:
    """A view made ready for matching."""

    pixels: U8  # even contrast, in `EVEN_STEPS` to a local standard deviation
    edges: F32  # of each cell, grey levels a pixel

    def rows(self, first: int, last: int) -> NormalizedView:
        """The part from one row of cells to before another."""
        return NormalizedView(self.pixels[first * CELL_PX : last * CELL_PX], self.edges[first:last])


@dataclass(eq=False)
class PushbroomDetector:
    """Judge stereo pairs in the order in which they were taken.

    With odometry an obstacle that was met is carried to where it is now, and remembered for
    `KEPT_FRAMES_WITH_ODOMETRY` frames while it is in view; a frame without a pose is taken to be
    where the last one was, until the next pose tells. Without it an obstacle stays, for
    `KEPT_FRAMES` frames, where it was seen and at the distance it had; the note says so.

    Raises ToktError if these cameras cannot tell one of the distances, or the calibration moves
    most of the left frame out of view.
    """

    calibration: StereoCalibration
    grid: Grid  # its width is the mask's
    odometry: Odometry | None = None
    sight: SightMeter = field(default_factory=stereo_meter)
    threads: int = 1  # with 2 the left and right views are made side by side
    method: ClassVar = PUSHBROOM

    def __post_init__(self) -> None:
        width = self.calibration.frame_size[0]
        self.rectifier = Rectifier(self.calibration, min(VIEW_WIDTH / width, 1))
        view_width, view_height = self.rectifier.size
        self._cells = (view_height // CELL_PX, view_width // CELL_PX)
        self._slices = _slices(self.rectifier)
        words = [f"{distance:g}" for distance in DISTANCES_M]
        self._where = " and ".join(filter(None, [", ".join(words[:-1]), words[-1]])) + " m"
        self._pose: Pose | None = None
        self._since_pose = 0
        self._health = PairHealth()
        kept = KEPT_FRAMES if self.odometry is None else KEPT_FRAMES_WITH_ODOMETRY
        self._memory = ObstacleMemory(self.rectifier, kept)
        self._mask_size = self.grid.resized(*self.calibration.frame_size[::-1])
        views = self.calibration, self.rectifier.scale, KERNELS
        self._faint = FaintMatches(*views, self._mask_size, PUSHBROOM)

    def detect(self, frame: Frame) -> Detection:
        """Judge one pair.

        Without one there is no verdict, and no other detector's *clear* stands against an
        obstacle that is remembered. In a pair with an unfit picture a hit still proves an
        obstacle, while no hit proves nothing.
        """
        self._advance(frame)
        self._faint.begin(frame.missed)
        fault = pair_shape_fault(frame, self.calibration.frame_size)
        if frame.left is None or frame.right is None or fault:
            return self._unjudged(fault)

        def view(side: str, picture: U8) -> tuple[F32, NormalizedView]:
            pictures = frame.pictures(side, detail_grid(picture.shape[1]))
            same = pictures.size == self.rectifier.size[::-1]
            gray16 = pictures.gray16 if same else self._gray16(picture)
            self.sight.of(frame, side)
            moved = self.rectifier.left_of if side == "left" else self.rectifier.right_of
            rectified = moved(_levels(gray16))
            return rectified, _normalized(rectified)

        (left, evened), (right, other) = of_both_sides(view, frame, self.threads)
        seen = self._depths(evened, other)
        hit = (seen > 0).astype(np.uint8)  # of cells; below, where the views show it
        hits = cv2.resize(hit, self.rectifier.size, interpolation=cv2.INTER_NEAREST).astype(bool)
        textured = bool((evened.edges > EDGE_GREY).mean() > TEXTURED_FRACTION)
        unfit = unfit_pictures(self.sight, frame)
        judged = self._judge((left, right), seen, hits, textured, unfit)
        return replace(judged, sight=self.sight.of(frame))

    def _judge(
        self, views: tuple[F32, F32], seen: F32, hits: Bools, textured: bool, unfit: Unfit
    ) -> Detection:
        """What a pair comes to."""
        doubt = self._doubt(*views, hits)
        if doubt is None or doubt.matches_stand:
            self._memory.add(seen)
            if seen.any() or not (unfit.fault or doubt):
                return self._judged(views, hits, textured)
            if doubt is None and not unfit.is_one_picture:
                # What is faint, or remembered, stays an obstacle in the part that is seen.
                found = self._judged(views, hits, textured)
                if found.mask is not None and found.mask.any():
                    return found
        if unfit.fault or doubt is None:
            return self._unjudged(unfit.fault, unfit.vetoes_clear)
        return self._unjudged(doubt.fault, doubt.vetoes_clear or textured)

    def look(self, left: U8, right: U8) -> F32:
        """What stands at the distances in one pair of frames of the calibration's size.

        Returns
        -------
        array of float32, shape (rows, columns) of cells
            Depth along the view's axis in metres, 0 where nothing was found. Cell (row, column)
            begins at pixel (`CELL_PX` * row, `CELL_PX` * column) of the rectifier's left view.
        """
        left_view = self.rectifier.left_of(_levels(self._gray16(left)))
        right_view = self.rectifier.right_of(_levels(self._gray16(right)))
        return self._depths(_normalized(left_view), _normalized(right_view))

    def _unjudged(self, fault: Fault, vetoes_clear: bool = False) -> Detection:
        remembered = bool(len(self._memory.ages))
        return Detection(None, PUSHBROOM, fault=fault, vetoes_clear=vetoes_clear or remembered)

    def _doubt(self, left: F32, right: F32, hits: Bools) -> PairFault | None:
        """Whether a camera is frozen or covered; texture without a match is usual here, no fault.

        The rows of what matches at so few disparities tell nothing.
        """
        nowhere = np.zeros(left.shape, bool)
        matches = Matches(np.zeros_like(left), hits, nowhere, nowhere)
        return self._health.judge(left, right, matches, None, None)

    def _advance(self, frame: Frame) -> None:
        """Let the memory's time pass; where this frame has a pose, move the camera there."""
        frames = 1 + frame.missed
        self._since_pose += frames
        pose = None if self.odometry is None else self.odometry.get(frame.number)
        before, motion = self._pose, None
        if pose is not None:
            motion = None if before is None else motion_between(before, pose)
            self._pose = pose
        self._memory.advance(frames, motion, self._since_pose)
        if pose is not None:
            self._since_pose = 0

    def _gray16(self, frame: U8) -> NDArray[np.uint16]:
        """The frame gray and scaled: averaged before rounding, as it holds few grey levels."""
        width, height = self.rectifier.size
        return KERNELS.resized_gray16(frame, height, width)

    def _depths(self, left: NormalizedView, right: NormalizedView) -> F32:
        """The depth in metres of each cell's obstacle, 0 where there is none; nearer ones win."""
        found = np.zeros(self._cells, np.float32)
        textured = left.edges > EDGE_GREY
        if np.count_nonzero(textured) < MIN_CELLS:
            return found
        rows = np.flatnonzero(textured.any(axis=1))
        first, last = max(rows[0] - BLOCK_CELLS // 2, 0), rows[-1] + 1 + BLOCK_CELLS // 2
        left, right, part = left.rows(first, last), right.rows(first, last), found[first:last]
        for looked in self._slices:
            shift = _hits(left, right, looked)
            part[shift > 0] = self.rectifier.focal_baseline_px_m / shift[shift > 0]
        return found

    def _judged(self, views: tuple[F32, F32], hits: Bools, textured: bool) -> Detection:
        """What a pair comes to of which something is believed."""
        judged = self._remembered(textured)
        if hits.any():
            self._faint.take(hits, self.rectifier)
            return judged
        faint = self._faint.judge(*views)
        clear = judged.mask is not None and not judged.mask.any()
        return replace(faint, note=faint.note or judged.note) if clear else judged

    def _remembered(self, textured: bool) -> Detection:
        """The verdict's mask, distance and note from what is remembered, the present included."""
        memory = self._memory
        note = f"pushbroom sees only at {self._where}"
        mask = np.zeros(self._mask_size, np.uint8)
        if len(memory.ages):
            mask = self.rectifier.to_left(memory.mask(), *self._mask_size)
        if cv2.mean(mask)[0] <= STATUS_MEAN_THRESHOLD:
            if textured:
                fault = f"something is in view, but at none of {self._where}; or a wrong pair"
                return self._unjudged(Fault(Reason.STEREO, fault), vetoes_clear=True)
            if len(memory.ages):
                fault = "too little of an obstacle met before is still in view"
                return self._unjudged(Fault(Reason.STEREO, fault))
            return Detection(mask, PUSHBROOM, note=note)
        since = int(memory.ages.min())
        if since > 0:
            note += f"; last met an obstacle {since} frame{'s' * (since > 1)} ago"
        if self._since_pose > 0 and memory.ages.max() > 0:
            note += "; distances as they were then: there is no odometry"
        distance = float(np.percentile(memory.depths_m, NEAR_PERCENTILE))
        return Detection(mask, PUSHBROOM, distance_m=distance, note=note)


def _levels(gray16: NDArray[np.uint16]) -> F32:
    """Grey levels and fractions of them."""
    return np.asarray(gray16 * np.float32(1 / STEPS_PER_LEVEL), np.float32)


def _slices(rectifier: Rectifier) -> list[Slice]:
    """The slices, far to near."""
    width, height = rectifier.size
    if height < BLOCK_CELLS * CELL_PX:
        raise ToktError(f"frames that become {width}x{height} pixels are too small for pushbroom")
    slices = []
    for distance in DISTANCES_M:
        middle = rectifier.focal_baseline_px_m / distance
        if not 2 * CELL_PX <= middle <= width / 2:
            nearest, farthest = rectifier.focal_baseline_px_m / np.array([width / 2, 2 * CELL_PX])
            only = f"with this calibration, only from {nearest:.2g} to {farthest:.2g} m"
            raise ToktError(f"pushbroom cannot look at {distance:g} m {only}")
        low, high = round(middle / (1 + BAND)), round(middle / (1 - BAND))
        shifts = tuple(range(low, high + 1))
        checks = [
            shift
            for offset in INVARIANCE_PX
            for shift in (low - offset, high + offset)
            if 0 <= shift <= width - BLOCK_CELLS * CELL_PX
        ]
        slices.append(Slice(shifts, tuple(checks)))
    return slices


def _normalized(view: F32) -> NormalizedView:
    """Local contrast normalisation, and where there are edges to match."""
    _, even = KERNELS.local_contrast(view, CONTRAST_WINDOW_PX, EVEN_STEPS, MIN_SIGMA_GREY)
    change = np.abs(cv2.Sobel(view, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8))
    return NormalizedView(even, _block_means(change))


def _block_means(pixels: NDArray[Any]) -> F32:
    """Mean over the block around each cell, shape (rows, columns) of cells."""
    rows, columns = pixels.shape[0] // CELL_PX, pixels.shape[1] // CELL_PX
    cells = pixels[: rows * CELL_PX, : columns * CELL_PX]
    for part in (CELL_PX // 2, 1):  # halving twice takes half the time of quartering
        size = (columns * part, rows * part)
        cells = np.asarray(cv2.resize(cells, size, interpolation=cv2.INTER_AREA))
    block = (BLOCK_CELLS, BLOCK_CELLS)
    return np.asarray(cv2.boxFilter(cells, cv2.CV_32F, block), np.float32)


def _cost(left: NormalizedView, right: NormalizedView, shift_px: int) -> F32:
    """Mean difference of the views at one disparity, by cells of the left view."""
    cost = np.full(left.edges.shape, np.inf, np.float32)
    first = math.ceil(shift_px / CELL_PX)  # left of it the right camera does not see
    start = first * CELL_PX
    here, there = left.pixels[:, start:], right.pixels[:, start - shift_px :]
    cost[:, first:] = _block_means(cv2.absdiff(here, there[:, : here.shape[1]]))
    return cost


def _worth_matching(left: NormalizedView, right: NormalizedView, shifts_px: Sequence[int]) -> Bools:
    """Cells whose blocks have edges in both views, and are seen by both cameras."""
    worth = np.zeros(left.edges.shape, bool)
    first = math.ceil(shifts_px[-1] / CELL_PX) + BLOCK_CELLS // 2
    moved = round(shifts_px[len(shifts_px) // 2] / CELL_PX)
    there = right.edges[:, first - moved : right.edges.shape[1] - moved]
    worth[:, first:] = (left.edges[:, first:] > EDGE_GREY) & (there > EDGE_GREY)
    return worth


def _hits(left: NormalizedView, right: NormalizedView, looked: Slice) -> F32:
    """The disparity in pixels of each cell that stands in a slice, 0 elsewhere."""
    hit = _worth_matching(left, right, looked.shifts_px)
    best = np.full(hit.shape, MAX_COST * EVEN_STEPS, np.float32)
    found = np.zeros(hit.shape, np.float32)
    if np.count_nonzero(hit) < MIN_CELLS:
        return found
    for shift in looked.shifts_px:
        cost = _cost(left, right, shift)
        found[cost < best] = shift
        np.minimum(best, cost, out=best)
    hit &= found > 0
    best /= INVARIANCE_RATIO
    for shift in looked.checks_px:
        if np.count_nonzero(hit) < MIN_CELLS:
            break
        hit &= best <= _cost(left, right, shift)
    # Only the connected regions that are large enough.
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(hit.view(np.uint8), connectivity=8)
    large = statistics[:, cv2.CC_STAT_AREA] >= MIN_CELLS
    large[0] = False  # the background
    return np.asarray(found * large[labels], np.float32)


_NEAREST_M = 0.1  # metres in front of the camera; what is nearer, or behind, is out of view
_GROWTH = 0.05
"""Part by which a thing may look larger than when it was seen before it is painted so."""


class ObstacleMemory:
    """Points of obstacles in the left camera's present axes, at most one for each cell of the view.

    `points_m` has x right, y down and z forward, `ages` the frames since each point was seen,
    `oldest` at most.
    """

    def __init__(self, rectifier: Rectifier, oldest: int) -> None:
        self._rectifier = rectifier
        width, height = rectifier.size
        self._shape = (height // CELL_PX, width // CELL_PX)
        self._oldest = oldest
        self._rotation = rectifier.rotations[0]
        # Where the middle of each cell looks, at depth 1 along the view's axis: (n_cells, 3).
        rows, columns = np.indices(self._shape).reshape(2, -1)
        middle = np.column_stack([columns, rows]) * CELL_PX + (CELL_PX - 1) / 2
        flat = (middle - rectifier.principal) / rectifier.focal_px
        self._rays: F64 = np.column_stack([flat, np.ones(len(flat))]) @ self._rotation
        self.points_m = np.empty((0, 3))
        self.ages = np.empty(0, np.int64)
        self._seen_at_m = np.empty(0)
        self._cells = np.empty(0, np.int64)

    def advance(self, frames: int, motion: Motion | None, moving: int = 1) -> None:
        """Let `frames` frames pass, and move the camera.

        Where its motion is not known the points stay in view where they are, at the distance they
        were seen at. The motion took `moving` frames: a point that is younger was seen on the way,
        and takes only the part of the motion that came after, as of an even one.
        """
        self.ages += frames
        self._keep(self.ages <= self._oldest)
        if motion is None or not len(self.ages):
            return
        after = self.ages.clip(max=moving)
        for age in np.unique(after):
            points = self.points_m[after == age]
            self.points_m[after == age] = motion.last(age / moving).of(points)
        self._keep(self.depths_m > _NEAREST_M)
        self._cells = self._cells_of(self.points_m)
        self._keep(self._cells >= 0)
        # Of the points in one cell only the nearest: the last one written stays.
        order = np.argsort(-self.depths_m, kind="stable")
        owner = np.zeros(self._rays.shape[0], np.int64)
        owner[self._cells[order]] = order
        self._keep(owner[self._cells] == np.arange(len(self._cells)))

    def add(self, depth_m: NDArray[np.floating]) -> None:
        """Remember what is seen now, in place of what was there before.

        `depth_m` is each cell's along the view's axis, in metres; 0 where nothing is seen.
        """
        seen = np.flatnonzero(depth_m)
        depth = depth_m.ravel()[seen].astype(np.float64)
        new = np.zeros(self._rays.shape[0], bool)
        new[seen] = True
        self._keep(~new[self._cells])
        self.points_m = np.concatenate([self.points_m, self._rays[seen] * depth[:, None]])
        self.ages = np.concatenate([self.ages, np.zeros(len(seen), np.int64)])
        self._seen_at_m = np.concatenate([self._seen_at_m, depth])
        self._cells = np.concatenate([self._cells, seen])

    @property
    def depths_m(self) -> F64:
        """Of each point along the view's axis, in metres, shape (n,)."""
        return np.asarray(self.points_m @ self._rotation[2], np.float64)

    def mask(self) -> U8:
        """The view with 255 where an obstacle is remembered, shape (height, width).

        A thing that has come nearer since it was seen is painted larger in proportion.
        """
        cells = np.zeros(self._shape, np.uint8)
        closer = self._seen_at_m / np.maximum(self.depths_m, _NEAREST_M)
        sizes = np.ceil(closer - _GROWTH).clip(1, max(self._shape)).astype(np.int64)
        for size in np.unique(sizes):
            own = np.zeros_like(cells)
            own.ravel()[self._cells[sizes == size]] = 255
            cells |= np.asarray(cv2.dilate(own, np.ones((size, size), np.uint8)), np.uint8)
        width, height = self._rectifier.size
        view = np.zeros((height, width), np.uint8)
        covered = cells.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)
        view[: covered.shape[0], : covered.shape[1]] = covered
        return view

    def _cells_of(self, points_m: F64) -> I64:
        """The cell in which each point stands, shape (n,); -1 where it is out of view."""
        seen = points_m @ self._rotation.T
        pixels = seen[:, :2] / seen[:, 2:] * self._rectifier.focal_px + self._rectifier.principal
        place = np.floor((pixels + 0.5) / CELL_PX)
        rows, columns = self._shape
        inside = (place >= 0).all(axis=1) & (place < (columns, rows)).all(axis=1)
        place[~inside] = 0
        column, row = place.astype(np.int64).T
        return np.where(inside, row * columns + column, -1)

    def _keep(self, which: Bools) -> None:
        self.points_m, self.ages = self.points_m[which], self.ages[which]
        self._seen_at_m, self._cells = self._seen_at_m[which], self._cells[which]
