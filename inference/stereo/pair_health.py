"""Health checks of a stereo pair: do its two views fit together, and belong together?

What is found, each with its reason in words: a covered or dark camera, a frozen one, views of
which hardly any texture matches (swapped cameras, one mounted upside down, a wrong calibration,
another moment), texture that the right view alone shows, and rows that do not agree (out of step,
a camera that has turned). Where nothing is found, both views have to be open water's
(`open_water_fault`): their light is not level, and alike in both, and specks are seen in them. What
has matched nothing and shows not even those has seen nothing.

What cannot be found:

- Open water of another moment looks the same.
- Both pictures turned by 180 degrees in open water, whose light is alike then, too.
- A camera out of step while the scene hardly moves, or before `SETTLED_PAIRS` pairs with something
  to match. With the right frames one late (one early), 62 (64) of 66 (69) pairs with something to
  match have a fault; the others are the first, and give distances within 2 % of the true ones. Two
  to five frames off, 7 to 13 such pairs have none and give 0.5 to 1.3 of the true distance: a
  small, faint thing, which stays an obstacle.
- A right camera turned about its vertical axis moves every disparity alike: 1 degree is 19 px of a
  view, while rows stay within 1.5 px. The distances are wrong; only `tokt calibrate` sees it, from
  tracks over several frames. Turned about its own axis by 1 degree, 50 of 75 pairs have a fault.
- A veil over a part of a view, with noise on it as the camera's. Of clear tank water, which has no
  specks, a pair in which nothing is found is unknown.
- A cover as bright as the water. A dark one over the left or right half of a lens, in open water
  (the left camera's shows by its edge); something textured behind it is a misfit.
- What is textured in less than `TEXTURED_FRACTION` of the view, with a wrong right frame.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8
from tokt.features.kernels.checks import over_rows
from tokt.features.kernels.dispatch import KERNELS
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.sight import SightMeter

from .epipolar_drift import EpipolarDriftCorrection, EpipolarOffset
from .matching import GAIN, LOCAL_SIGMA_GREY, MIN_SIGMA_GREY, Matches

# Thresholds stand above the extremes of the sea trial's odd frames and hold on the even ones (odd /
# even, true pairs). None of its 246 true pairs has a fault.

TEXTURED_FRACTION = 0.01
MATCHED_OF_TEXTURED = 0.10
"""With this much of the view textured, this part of it must be matched. True pairs: 0.41 / 0.41
and more; pairs swapped, upside down, or with an open-water frame: at most 0.01. Open water: at most
0.0021 / 0.0018 of the view is textured."""

CAUSE_UNDONE = 0.3
"""Part of the texture that must match once a cause is undone: below the true pairs' 0.41."""

RIGHT_ONLY_FRACTION = 0.06
"""This much more of the right view than of the left one is textured, and hardly matched: something
is before the right camera alone, or the left one is covered. True pairs: at most 0.026 / 0.026,
glare in the right view."""
_QUARTER = 4
_WINDOW_PX = 5

DARKER_STOPS = 2.0
"""Factors of two by which a quarter of one view, cut by rows, may be darker than the other's. True
pairs: at most 0.94 / 0.94, and that always the left one's, whose lens or lamp gives less. A near
thing's place differs by columns between the views, hence rows."""
_BANDS = 4
_ROW_STEP = 16
_COLUMN_STEP = 8

DIM_GREY = 12.0
"""Least mean grey level of a view. True pairs: 18.7 and more. At half the sea trial's light the
tower is not seen any more where 2 % of the view are textured, at a third where 7 % are."""

UNMATCHED_FRACTION = 0.12
"""Part of the view that may be textured without a match near by. True pairs: at most 0.062 /
0.081, nearer than 2 m; a hidden strip beside a near thing counts, too."""
_NEAR_BY = 7
_NEAR_BY_WIDTH = 170
"""Height and width in pixels of a view so wide that count as near by: about a block."""

MAX_SPREAD_PX = 1.6
"""Median deviation of a pair's row offsets, pixels of the full resolution. True pairs: at most
1.05 / 0.91, nearer than 2 m."""
FEWEST_AGREEING = 0.5
"""Part of the points found again within the rows searched. True pairs: 0.79 / 0.72 and more."""
MAX_DEVIATION_PX = 1.2
"""How far a pair's row offset may be from that of the pairs before. True pairs: at most
0.36 / 0.46."""
MAX_VARIATION_PX = 1.0
"""Median deviation of the remembered pairs' row offsets. True pairs: at most 0.17 / 0.15."""

LEVELNESS = 0.1
"""What is left of a view's contrast: the standard deviation of the mean grey levels of its 10x10
parts over their mean, without an even rise or fall. A lamp's light falls off from the middle, and
open water shows that; under haze, glow or a raised black level, inverted or enlarged it does not.
Frames without a near thing (1 to 146, 210 to 246): 0.173 / 0.173 and more; halved and raised by 50
at most 0.050 / 0.050, raised by 60 0.071 / 0.071, lit from below 0.047 / 0.047, enlarged twice
0.057 / 0.066."""
MIN_ALIKE = 0.85
"""Least correlation of the light of two views (the logarithms of those means). The same frames:
0.933 / 0.933 and more, rendered ones 0.875; cameras swapped at most 0.834 / 0.827. A view turned
or mirrored is more like the other when turned back, by 0.148 / 0.175 and more; a true one at least
0.116 / 0.106 less."""
_PARTS = 10
_PLACES = np.arange(_PARTS**2).reshape(_PARTS, _PARTS)
_TURNS = np.array([np.rot90(way, by).ravel() for way in (_PLACES, _PLACES.T) for by in range(4)])
"""Where each part comes from when a view is turned and mirrored; first as it is."""
_EVENLY = (np.arange(_PARTS) - (_PARTS - 1) / 2) / np.arange(_PARTS).std()
SPECKS = 4.2
"""How many times as bright as noise `_SPECK_PART` of the water is at least. Left and right view of
frames 1 to 131 and 205 to 246: 4.0 and 5.2 at least, of all but one 4.3 and 5.5. A light with a
camera's noise and nothing in it, or a view blurred under such noise: 4.0 at most."""
_SPECK_WIDTH = 340  # of the view at most, in pixels, so that a speck is a pixel or a few
_SPECK_PART = 2.3e-4  # of the pixels, 20 of them
_SPECK_PX, _AROUND_PX, _LOCAL_PX = 3, 9, 61
_BLACK_GREY = 3.0  # grey levels that are added before the logarithm: differences below are noise

MISFIT = "the left and right frames do not match: another moment, or something too near"
NEARER = "much of the left view matches nowhere: something may be nearer than the distance"
OUT_OF_STEP = "the rows of the two views do not agree: another moment, or a camera has moved"


@dataclass(frozen=True)
class PairFault:
    """Why a pair is not to be believed.

    It always vetoes a clear (`tokt.inference.verdict.Detection`) when it is the left camera, which
    other detectors look through, too; when the right one alone is lost, only where the left view
    has texture. Matches stand where what was matched all the same is there: a view that is dark in
    part still shows truly what it shows.
    """

    reason: str
    vetoes_clear: bool
    matches_stand: bool = False
    code: Reason = Reason.STEREO

    @property
    def fault(self) -> Fault:
        """The reason with its code."""
        return Fault(self.code, self.reason)


SIDES = ("left", "right")
Made = TypeVar("Made")


def of_both_sides(make: Callable[[str, U8], Made], frame: Frame, threads: int) -> tuple[Made, Made]:
    """Make something of each side and its picture; with two threads, left and right at once."""
    made: dict[str, Made] = {}

    def work(first: int, last: int) -> None:
        made.update((side, make(side, getattr(frame, side))) for side in SIDES[first:last])

    over_rows(work, len(SIDES), threads)
    return made["left"], made["right"]


def pair_fault(
    left_view: F32, right_view: F32, matches: Matches, offset: EpipolarOffset | None
) -> PairFault | None:
    """The fault that one pair's rectified views show without those before it, or None."""
    misfit = None
    if _something_there(matches) and _matched_of_textured(matches) < MATCHED_OF_TEXTURED:
        misfit = PairFault(MISFIT, vetoes_clear=True)
    misfit = misfit or _right_only_fault(left_view, right_view, matches) or _rows_fault(offset)
    dark = _darkness_fault(left_view, right_view, matches)
    # Darkness explains a misfit.
    return misfit if dark is None else replace(dark, matches_stand=misfit is None)


@dataclass(frozen=True)
class Unfit:
    """The reason why a picture proves nothing where nothing is matched; empty where both do."""

    fault: Fault = NO_FAULT
    # Of the left one, which other detectors look at, too; and where both cameras give one picture,
    # which may be the right one's.
    vetoes_clear: bool = False

    @property
    def is_one_picture(self) -> bool:
        """True where both cameras give one and the same picture, so that a match proves nothing."""
        return self.fault.reason is Reason.STEREO


def unfit_pictures(sight: SightMeter, frame: Frame) -> Unfit:
    """Find the picture of a pair of which too much is not seen."""
    left, right = frame.left, frame.right
    if left is None or right is None:
        return Unfit()
    for side in SIDES:
        if fault := sight.of(frame, side).fault:
            return Unfit(fault.about(side), vetoes_clear=side == "left")
    rows = zip(left[::_ROW_STEP], right[::_ROW_STEP], strict=True)
    if all(np.array_equal(one, other) for one, other in rows):  # the first differs as a rule
        one = "the left and right frames are one and the same picture"
        return Unfit(Fault(Reason.STEREO, one), vetoes_clear=True)
    return Unfit()


def open_water_fault(left_view: F32, right_view: F32) -> PairFault | None:
    """Why two views in which nothing was found are not to be taken for open water, or None.

    Open water gives no match, so that its light and specks alone tell whether both views are what
    they should be.
    """
    left, right = (_light(view) for view in (left_view, right_view))
    for side, light in (("left", left), ("right", right)):
        if _levelness(light) < LEVELNESS:
            level = f"the {side} view has lost its contrast: haze, glow or no true picture"
            return PairFault(level, vetoes_clear=True)
    for side, view in (("left", left_view), ("right", right_view)):
        if not _has_specks(view):
            words = f"the {side} view shows noise and not a speck of the water: nothing is seen"
            return PairFault(words, vetoes_clear=side == "left", code=Reason.BLANK)
    alike = _fall(right).ravel()[_TURNS] @ _fall(left).ravel()
    if alike[0] < max(MIN_ALIKE, float(alike.max())):
        words = "the light of the two views is not alike: swapped, turned, mirrored or covered"
        return PairFault(words, vetoes_clear=True)
    return None


def _has_specks(view: F32) -> bool:
    """Whether the brightest few pixels of a view stand out from noise near them (`SPECKS`).

    Water has specks in it, which scatter the lamps' light. Noise has no such tail: where that is
    all there is, no match does not mean that nothing is there.
    """
    width = min(_SPECK_WIDTH, view.shape[1])
    small = KERNELS.area_means(view, max(width * view.shape[0] // view.shape[1], 1), width)
    height, edge = len(small), _AROUND_PX
    if min(height, width) <= 2 * edge:  # a view of a few rows or columns
        return False
    enough = int(_SPECK_PART * (height - 2 * edge) * (width - 2 * edge))
    # No row depends on what is farther below: mostly the upper half has enough.
    above = height // 2 - _LOCAL_PX // 2 - _AROUND_PX // 2
    for rows, known in ((height // 2, above), (height, height - edge)):
        if known > edge:
            brightness = _brightness(small[:rows])[edge:known, edge:-edge]
            if np.count_nonzero(brightness > SPECKS) > enough:
                return True
    return False


def _brightness(small: F32) -> F32:
    """How far each pixel stands out, as a multiple of noise near it."""
    fine = cv2.blur(small, (_SPECK_PX, _SPECK_PX)) - cv2.blur(small, (_AROUND_PX, _AROUND_PX))
    # The mean of what is normally distributed, without its sign, is 0.8 standard deviations.
    noise = np.asarray(cv2.blur(np.abs(fine), (_LOCAL_PX, _LOCAL_PX)), np.float32)
    noise *= math.sqrt(math.pi / 2)
    fine /= np.maximum(noise, 1e-3, out=noise)
    return np.asarray(fine, np.float32)


def _light(view: F32) -> F64:
    """Mean grey levels of a view's parts, shape (`_PARTS`, `_PARTS`)."""
    some = np.ascontiguousarray(view[::_COLUMN_STEP, ::_COLUMN_STEP], np.float64)
    parts = cv2.resize(some, (_PARTS, _PARTS), interpolation=cv2.INTER_AREA)
    return np.asarray(parts, np.float64)


def _levelness(light: F64) -> float:
    """See `LEVELNESS`."""
    rises = (float(light.mean(axis=axis) @ _EVENLY) / _PARTS for axis in (0, 1))
    rest = float(light.var()) - sum(rise**2 for rise in rises)
    return math.sqrt(max(rest, 0.0)) / max(float(light.mean()), 1.0)


def _fall(light: F64) -> F64:
    """How the light falls off over a view, whatever its level: of mean 0 and length 1."""
    logs = np.log(light + _BLACK_GREY)
    logs -= logs.mean()
    return np.asarray(logs / max(float(np.linalg.norm(logs)), 1e-9), np.float64)


def _darkness_fault(left_view: F32, right_view: F32, matches: Matches) -> PairFault | None:
    left, right = (_band_levels(view) for view in (left_view, right_view))
    stops = np.log2((right + 1) / (left + 1))
    for dark, bright, by in (("left", "right", stops.max()), ("right", "left", -stops.min())):
        if by > DARKER_STOPS:
            darker = f"the {dark} view is {2**by:.0f} times darker than the {bright} one"
            vetoes_clear = dark == "left" or _something_there(matches)
            return PairFault(f"{darker}: covered or unlit", vetoes_clear, code=Reason.DARK)
    return None


def _dim_fault(left_view: F32, right_view: F32) -> PairFault | None:
    """Too little light for the texture of what is there."""
    for side, view in (("left", left_view), ("right", right_view)):
        level = view[::_ROW_STEP, ::_COLUMN_STEP].mean(dtype=np.float64)
        if level < DIM_GREY:
            reason = f"the {side} view is too dim for distances: mean grey level {level:.0f}"
            return PairFault(reason, vetoes_clear=False, matches_stand=True, code=Reason.DARK)
    return None


def _nearer_fault(matches: Matches) -> PairFault | None:
    """Something beside what is matched, nearer than the nearest distance that is searched."""
    step = max(matches.valid.shape[1] // _NEAR_BY_WIDTH, 1)
    some = np.s_[::step, ::step]
    alone = matches.textured[some] & matches.searched[some]
    if np.count_nonzero(alone) > UNMATCHED_FRACTION * alone.size:
        around = np.ones((_NEAR_BY, _NEAR_BY), np.uint8)
        alone &= cv2.dilate(matches.valid[some].astype(np.uint8), around) == 0
    if np.count_nonzero(alone) <= UNMATCHED_FRACTION * alone.size:
        return None
    return PairFault(NEARER, vetoes_clear=True, matches_stand=True)


def _band_levels(view: F32) -> F64:
    """Mean grey level of each quarter of the rows."""
    some = view[::_ROW_STEP, ::_COLUMN_STEP].mean(axis=1, dtype=np.float64)
    return np.array([part.mean() for part in np.array_split(some, _BANDS) if len(part)])


def _something_there(matches: Matches) -> bool:
    """Whether enough of the left view is textured for something to be there."""
    textured = int(np.count_nonzero(matches.textured & matches.searched))
    return textured > TEXTURED_FRACTION * matches.textured.size


def _matched_of_textured(matches: Matches) -> float:
    textured = int(np.count_nonzero(matches.textured & matches.searched))
    return int(np.count_nonzero(matches.valid)) / max(textured, 1)


def _right_only_fault(left_view: F32, right_view: F32, matches: Matches) -> PairFault | None:
    matched = np.count_nonzero(matches.valid) / matches.valid.size
    if matched >= MATCHED_OF_TEXTURED:
        return None
    right = _textured_fraction(right_view)
    if right <= RIGHT_ONLY_FRACTION or matched >= MATCHED_OF_TEXTURED * right:
        return None
    if right - _textured_fraction(left_view) <= RIGHT_ONLY_FRACTION:
        return None
    reason = "the right view shows what the left one does not: beside it, or the left is covered"
    return PairFault(reason, vetoes_clear=True)


def _textured_fraction(view: F32) -> float:
    """Part of a view with local contrast, seen at a quarter of its size."""
    small = view
    for by in (2, _QUARTER):  # in two steps, which take half the time of one
        small = KERNELS.area_means(small, max(view.shape[0] // by, 1), max(view.shape[1] // by, 1))
    sigma, _ = KERNELS.local_contrast(small, _WINDOW_PX, GAIN, MIN_SIGMA_GREY)
    return float(np.count_nonzero(sigma > LOCAL_SIGMA_GREY) / sigma.size)


def _rows_fault(offset: EpipolarOffset | None) -> PairFault | None:
    if offset is None:
        return None
    if offset.spread_px > MAX_SPREAD_PX or offset.agreeing < FEWEST_AGREEING:
        return PairFault(f"{OUT_OF_STEP} ({offset.spread_px:.1f} px)", vetoes_clear=True)
    if offset.turned:
        return PairFault(f"{OUT_OF_STEP} ({offset.turn_deg:+.1f} degrees)", vetoes_clear=True)
    return None


Transform = Callable[[U8, U8], tuple[U8, ...]]

CAUSES: tuple[tuple[str, Transform], ...] = (
    ("the left and right cameras are swapped", lambda left, right: (right, left)),
    ("the right camera is upside down", lambda left, right: (left, _turned(right))),
    ("the left camera is upside down", lambda left, right: (_turned(left), right)),
)
"""What may be behind views that do not match, and how to undo it."""


def _turned(frame: U8) -> U8:
    return np.asarray(cv2.rotate(frame, cv2.ROTATE_180), np.uint8)


class PairHealth:
    """Judge the pairs of one run in their order."""

    def __init__(self) -> None:
        self._before: tuple[F32, F32] | None = None
        self._repeats = 0
        self._cause = ""
        self._tried = 0

    def judge(
        self,
        left_view: F32,
        right_view: F32,
        matches: Matches,
        offset: EpipolarOffset | None,
        drift: EpipolarDriftCorrection | None,
    ) -> PairFault | None:
        """Why this pair is not to be believed, or None.

        `drift` is what `offset` was added to, and `right_view` moved by; None where rows are not
        followed.
        """
        fault = (
            self._frozen_fault(left_view, right_view, matches)
            or pair_fault(left_view, right_view, matches, offset)
            or _drift_fault(matches, drift)
            # Last, as an obstacle stands beside them.
            or _dim_fault(left_view, right_view)
            or _nearer_fault(matches)
        )
        if fault is None or fault.reason != MISFIT:
            self._cause, self._tried = "", 0
        return fault

    def _frozen_fault(self, left_view: F32, right_view: F32, matches: Matches) -> PairFault | None:
        """A camera that repeats its picture exactly, which noise forbids, while the other's
        changes. Where both repeat, the source may repeat a pair, yet not for long.
        """
        now = tuple(view[::_ROW_STEP].copy() for view in (left_view, right_view))
        before, self._before = self._before, (now[0], now[1])
        if before is None:
            return None
        left, right = (np.array_equal(old, new) for old, new in zip(before, now, strict=True))
        self._repeats = self._repeats + 1 if left and right else 0
        if self._repeats > Limits.frozen_repeats:
            reason = "both cameras repeat their last pictures: frozen"
            return PairFault(reason, vetoes_clear=True, code=Reason.FROZEN)
        if left == right or np.ptp(now[0] if left else now[1]) == 0:
            return None
        side = "left" if left else "right"
        reason = f"the {side} camera repeats its last picture: frozen"
        vetoes_clear = left or _something_there(matches)
        return PairFault(reason, vetoes_clear, code=Reason.FROZEN)

    def explained(
        self, fault: PairFault, left: U8, right: U8, match: Callable[[U8, U8], Matches]
    ) -> PairFault:
        """The same fault with its cause where that can be found; other faults as they are.

        Tries one of `CAUSES` a call, so that a pair costs at most one more matching, and none once
        a cause is found, until a pair fits. `match` rectifies and matches two frames.
        """
        if fault.reason != MISFIT:
            return fault
        if not self._cause and self._tried < len(CAUSES):
            cause, undo = CAUSES[self._tried]
            self._tried += 1
            found = match(*undo(left, right))
            if _something_there(found) and _matched_of_textured(found) >= CAUSE_UNDONE:
                self._cause = cause
        return replace(fault, reason=self._cause) if self._cause else fault


def _drift_fault(matches: Matches, drift: EpipolarDriftCorrection | None) -> PairFault | None:
    """Rows that agree among themselves, yet not with those of the pairs before."""
    if drift is None or not matches.valid.any():
        return None
    deviation, varying = drift.deviation_px, drift.variation_px
    if deviation is not None and deviation > MAX_DEVIATION_PX:
        return PairFault(f"{OUT_OF_STEP} ({deviation:.1f} px)", vetoes_clear=True)
    if varying is not None and varying > MAX_VARIATION_PX:
        return PairFault(f"{OUT_OF_STEP} ({varying:.1f} px from pair to pair)", vetoes_clear=True)
    return None
