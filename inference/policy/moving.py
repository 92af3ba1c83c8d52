"""Moving things: what swims or drifts by itself is told from what stands, by optical flow.

::

    frame ──> policy ──> verdict, mask ──> fast points in it ──> do they move as one? ──> verdict
       └──> points followed from the frame before ──> own motion, from the rest of the view

- *Own motion.* Points where nothing was seen (snow, and the sea floor beyond) bound it: the motion
  that most of them share, or, in snow that has none, their median speed. Snow is nearer than what
  stands farther off, and is faster. With fewer than `WATER_POINTS` of them nothing is known.
- *Fast* is a point beyond that bound by `FAST_PX` and half as much again.
- *Not as one.* A standing structure, and another vehicle, may be fast: the own motion may be taken
  for less than it is. But one rigid motion explains all their points, at whatever depths. It does
  not explain a school's. Only where `STRAY` of the fast points of the last `WINDOW_S` are not
  explained, of `FAST_POINTS` at least, things move by themselves. One fish alone is not told from
  a standing thing by this, and stays an obstacle: so does whatever there is little evidence of.

What follows of that (`--moving near`): an obstacle of nothing but such things is none. All of this
has to hold, else the verdict stands as it is, mask, box and all:

- Each connected part of the mask has fast points lately, and hardly any that are slow: a structure
  in the school, or beside it, keeps the whole status.
- No patch was part of the mask for `HIDDEN_S` without a break: the water behind was seen meanwhile.
- The mask is not `LARGE`, and nothing measured in it is nearer than `NEAR_M`.

Such a frame is *clear*, with the reason `moving` and its words. Unknown would stop the vehicle for
every school, as an obstacle does. It is not silently clear either: the water was seen between and
behind the fish, and had it been doubted (drift, a late model, views that do not match) without
them, it is unknown with them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import I64, U8, Bools
from tokt.features.extractors.extractor import gray_picture
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.inference.config import AVOID, NEAR
from tokt.inference.frame import Frame
from tokt.inference.frame_checks import shape_fault
from tokt.inference.reason import Fault, Reason
from tokt.inference.verdict import (
    OBSTACLE,
    UNKNOWN,
    Verdict,
    health_of,
    unknown_verdict,
    verdict_from_mask,
)

from .flow import (
    MIN_SIDE_PX,
    RIGID_POINTS,
    FlowPicture,
    Tracks,
    common_motion,
    follow,
    moves_as_one,
)
from .policy import Judgement, Policy
from .sediment import SedimentWatch

PATCHES = DEFAULT_GRID
"""In which points are counted and masks are looked at, whatever grid a model has."""
WATER_POINTS = 8
FAST_PX, FAST_TIMES = 3.0, 1.5
WINDOW_S, STEP_S, GAP_S = 2.0, 0.2, 1.0
"""How long what was seen counts; the least time over which points are followed, as in less slow
things do not move; and the longest from one frame to the next."""
KNOWN_PAIRS = 3
"""Pairs of frames in the window whose own motion has to be known."""
FAST_POINTS, STRAY = 20, 0.1
LARGE, NEAR_M = 0.35, 2.0
HIDDEN_S = 4.0
LATELY_S = 0.8
"""How long a part of the mask counts as moving without a point that is followed in it."""
SLOW = 0.35
"""Most of a part's points that may be slow."""


Counts = I64


class _Key(NamedTuple):
    """The frame from which points are followed."""

    t_s: float
    picture: FlowPicture
    mask: U8


class _Pair(NamedTuple):
    """What a frame and the one before showed."""

    t_s: float
    known: bool  # whether the own motion is
    fast: Counts  # points in each patch, by which share of the own motion they go beyond
    slow: Counts
    judged: int = 0  # fast points that are enough to ask whether they move as one
    stray: int = 0  # those of them that one motion does not explain


@dataclass(eq=False)
class MovingThings:
    """Another policy's verdicts, with what moves by itself in the view, and clouds of sediment."""

    policy: Policy
    grid: Grid  # which says how wide masks are
    avoid: str = NEAR  # `tokt.inference.config.MOVING`

    def __post_init__(self) -> None:
        self._sediment = SedimentWatch(PATCHES)
        self._pairs: deque[_Pair] = deque()
        self._key: _Key | None = None
        self._last_s = math.nan
        self._masked_s = np.full(PATCHES.n_patches, math.inf)  # since when each patch is masked

    def judge(self, frame: Frame) -> Judgement:
        """The policy's answer, with what moves, and whether it is a cloud that hides the view."""
        judgement = self.policy.judge(frame)
        gray = _gray(judgement, frame, self.grid)
        if gray is None or min(gray.shape) < MIN_SIDE_PX:
            self._key = None
            self._pairs.clear()
            return judgement
        mask = judgement.mask
        if mask is None or mask.shape != gray.shape:
            mask = np.zeros_like(gray)
        masked = _masked(mask)
        self._follow(frame, gray, mask, masked)
        judgement = self._with_moving(judgement, masked)
        nothing_seen = judgement.verdict.status != OBSTACLE and not mask.any()
        cloud = self._sediment.take(gray, nothing_seen, frame.t if frame.timed else None)
        return _hidden(judgement, cloud) if cloud else judgement

    def _follow(self, frame: Frame, gray: U8, mask: U8, masked: Bools) -> None:
        """Take in how points went since the key frame, if all is known since, and it is time to."""
        key, t_s = self._key, frame.t
        follows = frame.timed and frame.missed == 0 and 0 < t_s - self._last_s <= GAP_S
        self._last_s = t_s
        if key is None or not follows or key.mask.shape != mask.shape:
            self._pairs.clear()
            self._masked_s[:] = -math.inf
            key = None
        self._masked_s = np.where(masked, np.minimum(self._masked_s, t_s), math.inf)
        if key is not None and t_s - key.t_s < STEP_S:
            return
        picture = FlowPicture(gray)
        self._key = _Key(t_s, picture, mask)
        if key is None:
            return
        tracks = follow(key.picture, picture, key.picture.points(key.mask))
        self._pairs.append(_pair(t_s, tracks, key.mask, mask))
        while t_s - self._pairs[0].t_s > WINDOW_S:
            self._pairs.popleft()

    def _with_moving(self, judgement: Judgement, masked: Bools) -> Judgement:
        verdict, known = judgement.verdict, self._known()
        if known is None:
            return judgement
        if not known:
            return replace(judgement, verdict=replace(verdict, moving=0.0))
        moving, standing = self._parts(masked)
        share = round(float(moving.mean()), 3)
        judgement = replace(judgement, verdict=replace(verdict, moving=share))
        alone = verdict.status == OBSTACLE and not standing.any()
        return _without(judgement) if alone and not self._is_avoided(verdict, masked) else judgement

    def _known(self) -> bool | None:
        """Whether things move by themselves; None where that is not known."""
        known = [pair for pair in self._pairs if pair.known]
        if len(known) < KNOWN_PAIRS or not self._pairs[-1].known:
            return None
        judged, stray = sum(pair.judged for pair in known), sum(pair.stray for pair in known)
        return judged >= FAST_POINTS and stray >= STRAY * judged

    def _parts(self, masked: Bools) -> tuple[Bools, Bools]:
        """The patches of moving things, and of the mask's connected parts that are none."""
        last = self._pairs[-1]
        moving = (last.fast > 0) & (last.fast >= last.slow)
        standing = np.zeros_like(masked)
        lately = [pair for pair in self._pairs if last.t_s - pair.t_s <= LATELY_S]
        fast, slow = sum(pair.fast for pair in lately), sum(pair.slow for pair in lately)
        shape = PATCHES.rows, PATCHES.cols
        count, part = cv2.connectedComponents(masked.reshape(shape).astype(np.uint8))
        for number in range(1, count):
            its = (part == number).ravel()
            quick, still = int(fast[its].sum()), int(slow[its].sum())
            swims = quick > 0 and still <= SLOW * (quick + still)
            (moving if swims else standing)[its] = True
        return moving & ~standing, standing

    def _is_avoided(self, verdict: Verdict, masked: Bools) -> bool:
        """Whether moving things are an obstacle all the same."""
        if self.avoid == AVOID:
            return True
        if (self._pairs[-1].t_s - self._masked_s[masked] > HIDDEN_S).any():
            return True
        near = verdict.distance_m is not None and verdict.distance_m < NEAR_M
        return self.avoid == NEAR and (near or float(masked.mean()) > LARGE)


def _masked(mask: U8) -> Bools:
    """The patches that a mask reaches; the last of a row or a column goes to the edge."""
    high, wide = PATCHES.patch_size(*mask.shape)
    down = np.maximum.reduceat(mask, high * np.arange(PATCHES.rows), axis=0)
    return np.maximum.reduceat(down, wide * np.arange(PATCHES.cols), axis=1).ravel() > 0


def _pair(t_s: float, tracks: Tracks, then: U8, now: U8) -> _Pair:
    """What two frames showed, whose masks were `then` and `now`."""
    nothing = np.zeros(PATCHES.n_patches, np.int64)
    (x0, y0), (x, y) = tracks.then.astype(np.int64).T, tracks.now.astype(np.int64).T
    water = (then[y0, x0] == 0) & (now[y, x] == 0)
    if np.count_nonzero(water) < WATER_POINTS:
        return _Pair(t_s, False, nothing, nothing)
    fast = _fast(tracks, water)
    solid = _as_bodies(tracks, fast, now)
    high, wide = PATCHES.patch_size(*now.shape)
    row, col = np.minimum(y // high, PATCHES.rows - 1), np.minimum(x // wide, PATCHES.cols - 1)
    patch = row * PATCHES.cols + col
    loose = fast & ~solid
    counts = (np.bincount(patch[which], minlength=len(nothing)) for which in (loose, ~loose))
    one = moves_as_one(Tracks(tracks.then[fast], tracks.now[fast]))
    judged = len(one) if len(one) >= RIGID_POINTS else 0
    return _Pair(t_s, True, *counts, judged, int(np.count_nonzero(~one)))


def _gray(judgement: Judgement, frame: Frame, grid: Grid) -> U8 | None:
    """The left picture as the grid has it; None where there is none that can be looked at."""
    if judgement.gray is not None or judgement.mask is None:
        return judgement.gray
    if frame.left is None or shape_fault(frame.left):
        return None
    try:
        return gray_picture(frame.left, grid)
    except ValueError:
        return None


def _fast(tracks: Tracks, water: Bools) -> Bools:
    """Which points go beyond what the own motion can be, by the points of the water."""
    flow = tracks.flow
    common = common_motion(Tracks(tracks.then[water], tracks.now[water]))
    if common is not None:
        flow = tracks.now - (tracks.then @ common[:, :2].T + common[:, 2])
    speed = np.hypot(flow[:, 0], flow[:, 1])
    return np.asarray(speed > FAST_PX + FAST_TIMES * np.median(speed[water]))


def _as_bodies(tracks: Tracks, fast: Bools, mask: U8) -> Bools:
    """The fast points in parts of the mask that are one body each: another vehicle, a near wall."""
    part = cv2.connectedComponents(mask)[1][tuple(tracks.now.astype(np.int64).T[::-1])]
    solid = np.zeros(len(fast), bool)
    for number in np.unique(part[fast & (part > 0)]):
        its = fast & (part == number)
        solid |= its & (common_motion(Tracks(tracks.then[its], tracks.now[its])) is not None)
    return solid


def _without(judgement: Judgement) -> Judgement:
    """The same frame, had the moving things not been there."""
    verdict, mask = judgement.verdict, judgement.mask
    moving = verdict.moving or 0.0
    words = f"moving: nothing but small moving things is seen, in {100 * moving:.0f} % of the view"
    health = health_of(verdict.health, words)
    if judgement.doubt or mask is None:
        doubt = judgement.doubt or Fault(verdict.reason, health)
        unknown = unknown_verdict(Fault(doubt.reason, health_of(doubt, health)))
        return replace(judgement, mask=None, verdict=replace(unknown, moving=moving))
    nothing = np.zeros_like(mask)
    clear = verdict_from_mask(nothing, verdict.method, verdict.model, health=health)
    clear = replace(clear, reason=Reason.MOVING, moving=moving)
    return replace(judgement, mask=nothing, verdict=clear)


def _hidden(judgement: Judgement, cloud: Fault) -> Judgement:
    """Unknown, where nothing was seen in a cloud, or the looks of it are why nothing was judged."""
    verdict = judgement.verdict
    if verdict.status == UNKNOWN and verdict.reason not in (Reason.DRIFT, Reason.NOVEL):
        return judgement
    fault = Fault(cloud.reason, health_of(cloud, verdict.health))
    return replace(
        judgement, mask=None, verdict=replace(unknown_verdict(fault), moving=verdict.moving)
    )
