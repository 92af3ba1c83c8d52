"""Moving things: what swims or drifts by itself is told from what stands, by optical flow.

::

    frame ──> policy ──> verdict, mask ──> points that are too fast in it ──> unknown, or as it was
       └──> points followed from the frame before ──> own motion, from the rest of the view

- *Own motion.* Points where nothing was seen (snow, and the sea floor beyond) bound it: the motion
  that most of them share, or, in snow that has none, their median speed. Snow is nearer than what
  stands farther off, and is faster. With fewer than `WATER_POINTS` of them nothing is known.
- *Too fast* is a point beyond that bound by `FAST_PX` and half as much again. Points of a part of
  the mask that is one body (a near wall, another vehicle) are not, however fast.
- Things move with `FAST_POINTS` of them in the last `WINDOW_S`, in pairs of frames with
  `PAIR_POINTS` at least: a few are strays. One fish alone stays what it was.
- Where all that is too fast moves as one, nothing swims: it is the vehicle that moves, and what is
  taken for water stands still in the picture, as dirt on the glass does.

An obstacle of nothing but such things is *unknown* with the reason `moving`: there is nothing that
one must steer around, and what is behind it is not seen. Flow never makes a frame clear. With
``--moving near`` it stays an obstacle if it is `LARGE`, or nearer than `NEAR_M`. So it does if a
connected part of the mask is slow, or has no points: a structure among the fish keeps the whole.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import I64, U8, Bools, median
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.kernels.checks import beside
from tokt.inference.config import ALL, NEAR
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.verdict import OBSTACLE, UNKNOWN, Verdict, health_of, unknown_verdict

from .flow import MIN_SIDE_PX, FlowPicture, PointFlow, common_motion, follow
from .policy import Judgement, Policy
from .sediment import SedimentWatch

PATCHES = DEFAULT_GRID
"""In which points are counted and masks are looked at, whatever grid a model has."""
_LOOKED_AT = (Reason.DRIFT, Reason.NOVEL, Reason.FRAME_RULE)
"""Reasons for unknown of a picture without a fault."""
WATER_POINTS = 8
FAST_PX, FAST_TIMES = 3.0, 1.5
WINDOW_S, STEP_S, GAP_S = 2.0, 0.2, 1.0
"""How long what was seen counts; the least time over which points are followed, as in less slow
things do not move; and the longest from one frame to the next."""
REMEMBERED_S = WINDOW_S + 2 * STEP_S
"""Nothing that is older has a part in what moves."""
KNOWN_PAIRS = 3
"""Pairs of frames in the window whose own motion has to be known."""
PAIR_POINTS, FAST_POINTS = 10, 20
LARGE, NEAR_M = 0.35, 5.0
LATELY_S = 0.8
"""How long a part of the mask counts as moving without a point that is followed in it."""
SLOW = 0.35
"""Most of a part's points that may be slow."""


class _Key(NamedTuple):
    """The frame from which points are followed."""

    t_s: float
    picture: FlowPicture
    mask: U8
    shape: tuple[int, ...]  # the frame's


class _Pair(NamedTuple):
    """What a frame and the one before showed: points in each patch."""

    t_s: float
    known: bool  # whether the own motion is
    fast: I64
    slow: I64


class _Flow(NamedTuple):
    """A frame as points are followed in it, and those that were."""

    picture: FlowPicture
    tracks: PointFlow | None  # None where none were, as this frame begins anew


def _gray(frame: Frame) -> U8 | None:
    """The left picture in gray, `PATCHES` wide; None where it is too small, or is none."""
    if frame.left is None or min(frame.left.shape[:2]) < MIN_SIDE_PX:
        return None
    # What runs on in a masked part, such as a clock, is no thing.
    gray = frame.small_gray("left")
    return None if gray is None or len(gray) < MIN_SIDE_PX else gray


def _flow(gray: U8 | None, key: _Key | None) -> _Flow | None:
    if gray is None:
        return None
    picture = FlowPicture(gray)
    if key is None:
        return _Flow(picture, None)
    return _Flow(picture, follow(key.picture, picture, key.picture.points(key.mask)))


@dataclass(eq=False)
class MovingThings:
    """Another policy's verdicts, with what moves by itself in the view, and clouds of sediment."""

    policy: Policy
    avoid: str = NEAR  # `tokt.inference.config.MOVING`
    threads: int = 1  # with more, points are followed while the policy judges

    def __post_init__(self) -> None:
        self._sediment = SedimentWatch()
        self._pairs: deque[_Pair] = deque()
        self._key: _Key | None = None
        self._last_s = math.nan

    def judge(self, frame: Frame) -> Judgement:
        """The policy's answer, with what moves, and whether it is a cloud that hides the view."""
        flow = self._begin(frame)
        judgement = self.policy.judge(frame)
        gray = self._picture(judgement, frame)
        if gray is None:
            self._key = None
            self._pairs.clear()
            return judgement
        mask = np.zeros_like(gray)
        if judgement.mask is not None:
            size = gray.shape[1], gray.shape[0]
            resized = cv2.resize(judgement.mask, size, interpolation=cv2.INTER_NEAREST)
            mask = np.asarray(resized, np.uint8)
        self._follow(frame, mask, flow())
        judgement, doubt = self._with_moving(judgement, mask)
        verdict = judgement.verdict
        nothing_seen = verdict.status != OBSTACLE and not mask.any()
        cloud = self._sediment.take(gray, nothing_seen, frame.t if frame.timed else None)
        if verdict.reason != Reason.FRAME_RULE:  # else an obstacle may be about to be told
            doubt = doubt or cloud
        if not doubt:
            return judgement
        unknown = unknown_verdict(Fault(doubt.reason, health_of(doubt, verdict.health)))
        return replace(judgement, mask=None, verdict=replace(unknown, moving=verdict.moving))

    def _picture(self, judgement: Judgement, frame: Frame) -> U8 | None:
        """The left picture in gray, `PATCHES` wide; None where nothing was looked for in it."""
        verdict = judgement.verdict
        if verdict.status == UNKNOWN and verdict.reason not in _LOOKED_AT:
            return None
        return _gray(frame)

    def _begin(self, frame: Frame) -> Callable[[], _Flow | None]:
        """Follow points from the key frame, if all is known since, and it is time to."""
        key, last_s = self._key, self._last_s
        follows = frame.timed and frame.missed < MANY_MISSED and 0 < frame.t - last_s <= GAP_S
        if key is not None and frame.left is not None:
            follows = follows and key.shape == frame.left.shape
        # By the clock's slots: which frames are looked at does not hang on when the run began.
        if key is not None and follows and frame.t // STEP_S == key.t_s // STEP_S:
            return lambda: None
        return beside(lambda: _flow(_gray(frame), key if follows else None), self.threads)

    def _follow(self, frame: Frame, mask: U8, flow: _Flow | None) -> None:
        """Take in how points went since the key frame."""
        t_s = self._last_s = frame.t
        if flow is None or frame.left is None:
            return
        key, self._key = self._key, _Key(t_s, flow.picture, mask, frame.left.shape)
        if key is None or flow.tracks is None:
            self._pairs.clear()
            return
        self._pairs.append(_pair(t_s, flow.tracks, key.mask, mask))
        while t_s - self._pairs[0].t_s > WINDOW_S:
            self._pairs.popleft()

    def _with_moving(self, judgement: Judgement, mask: U8) -> tuple[Judgement, Fault]:
        """The judgement with the share of what moves; and why it is unknown by that, if it is."""
        known = [int(pair.fast.sum()) for pair in self._pairs if pair.known]
        if len(known) < KNOWN_PAIRS or not self._pairs[-1].known:
            return judgement, NO_FAULT
        masked = np.asarray(PATCHES.cells(mask).any(axis=(1, 2)), bool)
        moving = standing = np.zeros_like(masked)
        if sum(fast for fast in known if fast >= PAIR_POINTS) >= FAST_POINTS:
            moving, standing = self._parts(masked)
        verdict = replace(judgement.verdict, moving=round(float(moving.mean()), 3))
        judgement = replace(judgement, verdict=verdict)
        alone = verdict.status == OBSTACLE and moving.any() and not standing.any()
        if not alone or self._is_avoided(verdict, masked):
            return judgement, NO_FAULT
        words = f"only moving things are seen, in {100 * moving.mean():.0f} % of the view"
        return judgement, Fault(Reason.MOVING, words)

    def _parts(self, masked: Bools) -> tuple[Bools, Bools]:
        """The patches of moving things, and of the mask's connected parts that are none."""
        last = self._pairs[-1]
        moving = (last.fast > 0) & (last.fast >= last.slow)
        standing = np.zeros_like(masked)
        lately = [pair for pair in self._pairs if last.t_s - pair.t_s <= LATELY_S]
        fast, slow = np.sum([(pair.fast, pair.slow) for pair in lately], axis=0)
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
        near = verdict.distance_m is not None and verdict.distance_m < NEAR_M
        large = float(masked.mean()) > LARGE
        return self.avoid == ALL or (self.avoid == NEAR and (near or large))


def _pair(t_s: float, tracks: PointFlow, then: U8, now: U8) -> _Pair:
    """What two frames showed, whose masks were `then` and `now`."""
    nothing = np.zeros(PATCHES.n_patches, np.int64)
    (x0, y0), (x, y) = tracks.then.astype(np.int64).T, tracks.now.astype(np.int64).T
    water = (then[y0, x0] == 0) & (now[y, x] == 0)
    if np.count_nonzero(water) < WATER_POINTS:
        return _Pair(t_s, False, nothing, nothing)
    fast = _fast(tracks, water)
    fast &= ~_as_bodies(tracks, fast, now)
    high, wide = PATCHES.patch_size(*now.shape)
    row, col = np.minimum(y // high, PATCHES.rows - 1), np.minimum(x // wide, PATCHES.cols - 1)
    patch = row * PATCHES.cols + col
    counts = (np.bincount(patch[which], minlength=len(nothing)) for which in (fast, ~fast))
    return _Pair(t_s, True, *counts)


def _fast(tracks: PointFlow, water: Bools) -> Bools:
    """Which points go beyond what the own motion can be, by the points of the water."""
    common = common_motion(tracks, water)
    then = tracks.then if common is None else tracks.then @ common[:, :2].T + common[:, 2]
    flow = (tracks.now - then).astype(np.float64)
    speed = np.hypot(flow[:, 0], flow[:, 1])
    return np.asarray(speed > FAST_PX + FAST_TIMES * median(speed[water]))


def _as_bodies(tracks: PointFlow, fast: Bools, mask: U8) -> Bools:
    """The fast points in parts of the mask that are one body each: another vehicle, a near wall."""
    part = cv2.connectedComponents(mask)[1][tuple(tracks.now.astype(np.int64).T[::-1])]
    solid = np.zeros(len(fast), bool)
    for number in np.unique(part[fast & (part > 0)]):
        its = fast & (part == number)
        solid |= its & (common_motion(tracks, its) is not None)
    left = fast & ~solid
    return solid | (left & (common_motion(tracks, left) is not None))
