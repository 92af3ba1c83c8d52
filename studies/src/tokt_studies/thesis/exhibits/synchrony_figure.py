"""Figure 6.1: by how much one camera is later than the other, measured from the frames themselves.

A rectified pair has a thing in one row of both views, unless the right camera saw it earlier or
later and the vehicle heaved, pitched or rolled in between:

::

    row in the left view                 L(n), L(n-1), L(n+1): where a point is in the left view
       |            L(n+1)               of this frame, the one before and the one after
       |        R .                      R: where it is in the right view of frame n
       |   L(n) .                        offset d: R = L(n + d), L between frames by the parabola
       | .                               through its three places
       +----+--------+---- frame
        n-1 n       n+1

One offset is fitted to the points of many frames, with what a calibration leaves: rows that differ
by a constant, and by a share of the place in the view. No distance is needed, and a vehicle that
stands still tells nothing. The uncertainty is the delete-one jackknife over frames, since the
points of one frame err together.

References
----------
B. Efron, *The Jackknife, the Bootstrap and Other Resampling Plans*, SIAM 1982, chapter 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.stats import t as student_t

from tokt.features.common.arrays import F32, F64, U8
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.mission import LEFT, RIGHT, Mission
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.rectify import rectified, rectifying
from tokt.training.rig.calibrate import matching
from tokt.training.rig.calibrate.frame_selection import evenly_spaced

from .exhibit import Claim, ClaimAgreement, Exhibit, Plot, StudyContext, Table
from .frame_drawing import new_figure, png_of

FARTHEST_FRAMES = 1.5
"""Offsets up to this are looked for: the parabola holds between the three frames."""
MIN_FRAMES = 4
"""Fewest frames with points that give an offset with an uncertainty."""
_POINTS_A_FRAME = 80
"""At most so many points of a frame: more of them err together, and one frame must not decide."""
_MIN_POINTS = 8
_ROW_NOISE_PX = 0.5
"""Residuals well above this count for less (soft L1). Source: the median row difference of matched
points after rectification is 0.4 px at full resolution."""
_WINDOW_PX, _LEVELS, _RETURN_PX = 21, 4, 0.5
_CONFIDENCE = 0.95
_LEFT_ROWS, _PLACE = ["before", "here", "after"], ["x", "y"]


@dataclass(frozen=True)
class Offset:
    """By how many frames the right camera is later than the left one.

    The half width is of the 95 % confidence interval (Student's t), by the jackknife over frames.
    Of each frame's points `by_frame` has the medians of the rows a frame that they have ``moved``
    over the offset, and of the rows' ``difference`` between the views, less what the calibration
    leaves.
    """

    frames: float
    half_width: float
    n_points: int
    by_frame: pd.DataFrame


class LateRight:
    """The frames of a mission, the right ones those of `SHIFTED` frames later, on purpose."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission

    def read(self, frame: int, camera: str) -> U8:
        """A left frame, or the later right one."""
        return self._mission.read(frame if camera == LEFT else frame + SHIFTED, camera)


def rows_of(
    mission: Mission, calibration: StereoCalibration, frames: Sequence[int]
) -> pd.DataFrame:
    """Match and follow the points of some pairs: rows in pixels of the full resolution.

    ``before``, ``here`` and ``after`` are a point's rows in the left view of the frame before, the
    frame, and the frame after; ``right`` is its row in the right view of the frame. ``x`` and ``y``
    are its column and row in the left view less its middle, as parts of its width. A frame without
    points that both cameras and both neighbours see, or without neighbours, is left out.
    """
    parts = (_rows_of_frame(mission, calibration, number) for number in frames)
    none = pd.DataFrame(columns=["frame", *_LEFT_ROWS, "right", *_PLACE], dtype=float)
    return pd.concat([none, *(part for part in parts if part is not None)], ignore_index=True)


def _rows_of_frame(
    mission: Mission, calibration: StereoCalibration, number: int
) -> pd.DataFrame | None:
    matched = matching.match_frame(mission, number, calibration.frame_size)
    if matched is None:
        return None
    step = max(1, -(-len(matched) // _POINTS_A_FRAME))
    left, right = matched.left[::step], matched.right[::step]
    try:
        before, after = (_followed(mission, number, number + by, left) for by in (-1, 1))
    except FrameError:
        return None
    good = np.isfinite(before[:, 0]) & np.isfinite(after[:, 0])
    if good.sum() < _MIN_POINTS:
        return None
    c = calibration
    R1, R2, P1, P2 = rectifying(c)
    focal_ratio = c.K1[0, 0] / P1[0, 0]
    seen = [rectified(p[good], c.K1, c.D1, R1, P1) for p in (before, left, after)]
    theirs = rectified(right[good], c.K2, c.D2, R2, P2)
    width, height = c.frame_size
    place = (seen[1] - np.array([width, height]) / 2) / width
    rows = {name: points[:, 1] * focal_ratio for name, points in zip(_LEFT_ROWS, seen, strict=True)}
    return pd.DataFrame({"frame": number, **rows}).assign(
        right=theirs[:, 1] * focal_ratio, x=place[:, 0], y=place[:, 1]
    )


def _followed(mission: Mission, number: int, other: int, places: F64) -> F64:
    """Where points of a left frame are in another left frame; nan where they are lost."""
    (here, (width, _)), (there, _) = (matching.gray_view(mission, n, LEFT) for n in (number, other))
    scale = matching.view_scale(width)
    views = matching.even_contrast_gaussian(here), matching.even_contrast_gaussian(there)
    start = ((places + 0.5) * scale - 0.5).astype(np.float32)[:, None]
    found, seen = _flow(*views, start)
    back, again = _flow(*views[::-1], found)
    returned = np.linalg.norm((back - start)[:, 0], axis=1) / scale <= _RETURN_PX
    good = (seen.ravel() > 0) & (again.ravel() > 0) & returned
    exact = (found[:, 0].astype(np.float64) + 0.5) / scale - 0.5
    return np.where(good[:, None], exact, np.nan)


def _flow(here: U8, there: U8, start: F32) -> tuple[F32, U8]:
    """Where points go, and whether they are found there."""
    found, seen, _ = cv2.calcOpticalFlowPyrLK(
        here, there, start, start.copy(), winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=_LEVELS
    )
    return np.asarray(found, np.float32), np.asarray(seen, np.uint8)


def offset_of(rows: pd.DataFrame) -> Offset:
    """Fit the offset to points; raises ToktError if fewer than `MIN_FRAMES` frames have some."""
    n = rows.frame.nunique()
    if n < MIN_FRAMES:
        raise ToktError(
            f"{n} frames have points that both cameras see and that can be followed; "
            f"the moments of the cameras are compared over {MIN_FRAMES} and more"
        )
    whole = _fitted(rows, None)
    without = [_fitted(rows[rows.frame != number], whole)[0] for number in rows.frame.unique()]
    error = float(np.sqrt((n - 1) / n * np.square(without - np.mean(without)).sum()))
    difference = rows.right - rows.here - _left(rows, whole)
    of_points = rows.assign(moved=_moved_px(rows, whole[0]), difference=difference)
    by_frame = of_points.groupby("frame")[["moved", "difference"]].median()
    half_width = float(student_t.ppf((1 + _CONFIDENCE) / 2, n - 1) * error)
    return Offset(float(whole[0]), half_width, len(rows), by_frame)


def _fitted(rows: pd.DataFrame, start: F64 | None) -> F64:
    """Offset, constant, and the shares of column and row, of all points at once."""
    starts = [start] if start is not None else [np.array([d, 0.0, 0, 0]) for d in (-1.0, 0.0, 1.0)]
    limits = np.array([FARTHEST_FRAMES, np.inf, np.inf, np.inf])

    def residuals(fit: F64) -> F64:
        expected = rows.here + fit[0] * _moved_px(rows, fit[0])
        return np.asarray(rows.right - expected - _left(rows, fit))

    how: dict[str, Any] = {"loss": "soft_l1", "f_scale": _ROW_NOISE_PX}
    found = [least_squares(residuals, one, bounds=(-limits, limits), **how) for one in starts]
    best = min(found, key=lambda one: float(one.cost))
    return np.asarray(best.x, np.float64)


def _moved_px(rows: pd.DataFrame, frames: float) -> pd.Series:
    """Rows a frame by which each point moves over an offset, by its parabola."""
    before, after = rows.before, rows.after
    return (after - before) / 2 + frames * ((after + before) / 2 - rows.here)


def _left(rows: pd.DataFrame, fit: F64) -> pd.Series:
    """Rows by which the calibration leaves the views apart."""
    return fit[1] + rows[_PLACE] @ fit[2:]


FRAMES = 14
"""Pairs whose points are followed, spread over those with something in them."""
SHIFTED = 1
"""Frames by which the right camera is made late on purpose."""
SYNCHRONOUS_FRAMES = 0.1
"""Offsets below move a point by less than a block of the matching at the mission's motion: the
largest row motion there, 70 px a frame, comes to 7 px."""
AS_IT_IS, ON_PURPOSE = "as it is", f"right camera {SHIFTED} frame later, on purpose"
_COLORS = {AS_IT_IS: "#1f4e79", ON_PURPOSE: "#d1603d"}


def synchrony_figure(context: StudyContext) -> Exhibit:
    """The exhibit of figure 6.1; needs pairs of something that moves in the picture."""
    calibration = context.needed_calibration()
    frames = evenly_spaced(_with_neighbours(context), FRAMES)
    missions: dict[str, Any] = {AS_IT_IS: context.mission, ON_PURPOSE: LateRight(context.mission)}
    found = {
        words: offset_of(rows_of(mission, calibration, frames))
        for words, mission in missions.items()
    }
    return Exhibit(
        words=_words(context),
        claims=(claim_of(found),),
        tables=(_table(found),),
        plots=(_plot(found),),
    )


def _with_neighbours(context: StudyContext) -> list[int]:
    """Pairs with something in them that have both left neighbours, and the right one after."""
    left, right = (set(context.mission.frames(camera)) for camera in (LEFT, RIGHT))
    return [
        number
        for number in context.textured_pairs
        if {number - 1, number + 1} <= left and number + SHIFTED in right
    ]


def _said(offset: Offset) -> str:
    """An offset with its 95 % interval, and more than it says where it is at the end."""
    at_the_end = abs(offset.frames) > FARTHEST_FRAMES - 0.01
    words = f"{offset.frames:+.4f} +- {offset.half_width:.4f} frames"
    return f"{words} (or more: the end of what is looked for)" if at_the_end else words


def claim_of(found: dict[str, Offset]) -> Claim:
    """What the offsets `AS_IT_IS` and `ON_PURPOSE` come to."""
    own, shifted = found[AS_IT_IS], found[ON_PURPOSE]
    claim = Claim.about(
        "left and right frames of one number are of one moment",
        "both cameras photograph a clock; no result is printed (section 6.1.2, figure 6.1)",
    )
    said = (
        f"right camera later by {_said(own)}; made late by {SHIFTED} on purpose: {_said(shifted)}"
    )
    off_purpose = abs(shifted.frames - SHIFTED - own.frames)
    if max(off_purpose, own.half_width) > SYNCHRONOUS_FRAMES:
        why = "these frames do not tell: the vehicle hardly moves, or few points can be followed"
        return claim(said, why)
    return claim(
        said,
        f"to agree: {SYNCHRONOUS_FRAMES} frames or less with the interval, and one made on "
        "purpose is found",
        agreement=ClaimAgreement.of(abs(own.frames) + own.half_width <= SYNCHRONOUS_FRAMES, False),
    )


def _words(context: StudyContext) -> tuple[str, ...]:
    return (
        "Measured from the frames, without any clock. A point stands in one row of both rectified "
        "views, unless the right camera saw it at another moment and the vehicle moved. Points: "
        "SIFT between the cameras, Lucas and Kanade's method from frame to frame. Rectified with "
        f"{context.calibration_words}.",
        f"The interval is of 95 %, by the jackknife over at most {FRAMES} frames with something in "
        "them. What the calibration leaves is fitted beside the offset. It cannot hide one, as "
        "the motion changes from frame to frame.",
    )


def _table(found: dict[str, Offset]) -> Table:
    rows = pd.DataFrame(
        {
            "frames": words,
            "offset, frames": one.frames,
            "95 % interval, +-": one.half_width,
            "frames used": len(one.by_frame),
            "points": one.n_points,
            "largest row motion, px a frame": one.by_frame.moved.abs().max(),
        }
        for words, one in found.items()
    )
    return Table("offset", "Offset between the cameras; positive: the right one is later.", rows)


def _plot(found: dict[str, Offset]) -> Plot:
    figure, axes = new_figure(8.4, 4.8)
    for words, one in found.items():
        moved = one.by_frame.moved
        style = {"color": _COLORS[words], "label": f"{words}: {_said(one)}"}
        axes.plot(moved, one.by_frame.difference, "o", **style)
        ends = np.array([min(moved.min(), 0.0), max(moved.max(), 0.0)])
        axes.plot(ends, one.frames * ends, color=_COLORS[words], lw=1)
    axes.axhline(0, color="0.6", lw=0.8)
    axes.set(
        xlabel="rows a frame by which the points move in the left view over the offset, px",
        ylabel="right row less left row, px",
    )
    axes.grid(alpha=0.25)
    axes.legend(fontsize=8)
    return Plot(
        "synchrony",
        "A dot a frame, the median of its points; a line's slope is the offset in frames. "
        "Synchronous cameras lie on the horizontal line, however fast the picture moves.",
        png_of(figure),
    )
