r"""Faint matches: what is too small or too faint for one pair to prove, and stays for several.

::

      frame  1    2    3    4    5    6
             x    .    x    x    x    .     matched in one patch of the left frame in 4 of the last
             .    .    x    .    .    .     6 frames: an obstacle. Marine snow matches now here, now
                                            there.

The views are halved again, which takes noise away, and matched where they have a third of the
contrast that one pair's proof needs. A patch with texture of which hardly any is matched counts
likewise, in 4 of 5: where that stays, something is in view and the views do not fit together, or
it is too near; then the frame is unknown.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, Bools
from tokt.features.kernels.dispatch import Kernels
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.verdict import OBSTACLE, UNKNOWN, Detection
from tokt.models.operating_point import MofNRule, MofNState

from .calibration import StereoCalibration
from .matching import Contrast, DenseMatcher
from .pair_health import MISFIT, open_water_fault
from .rectify import Rectifier

VIEW_WIDTH = 340
"""Pixels: a quarter of the mission cameras' resolution."""

# Chosen on the sea trial's odd frames taken for a run of their own, which moves twice as far from
# frame to frame, and held on the even ones taken so: no patch in open water either way. Over all
# 246 frames in their order, which were looked at as well, a rule of 3 hits would have one, a
# drifting speck 5 m away in frames 17 to 21; hence 4.
FAINT = Contrast(local_sigma=0.7, least_sigma=0.5, blob_px=100)
"""Frames 1 to 131: at most 4 % of the view is textured so, and at times 40 pixels of it match."""
PATCHES = 10
"""Rows and columns of patches that are followed."""
MATCHED_SHARE = 0.055
"""Of a patch, matched in one frame. With 0.03 to 0.06 no patch of frames 1 to 131 reaches
`MATCHED_HITS`, and every frame from 140 to 246 has one; at half the frames, odd or even, the first
at 142 or 143."""
TEXTURED_SHARE = 0.3
"""Of a patch, textured in one frame while less than `MATCHED_OF_TEXTURED` of that is matched."""
MATCHED_OF_TEXTURED = 0.25
MATCHED_HITS, MATCHED_WINDOW = 4, 6
ALONE_HITS, ALONE_WINDOW = 4, 5
"""A patch counts with so many of the last frames."""
_SAMPLES = 20  # rows and columns of points of a patch that are looked at


class _Faint(NamedTuple):
    """What the last frames come to.

    `matched` and `alone` are 1, 0 or -1: unknown where the frames before are not known and could
    have shown it.
    """

    matched: int  # whether matches stay
    alone: int  # whether texture without a match does
    patches: Bools  # of the left frame, where matches stay: (`PATCHES`, `PATCHES`)
    disparity_px: float | None  # largest median of this frame's matches in one of these patches


class FaintMatches:
    """Follow faint matches over the pairs of one run, in their order.

    The views that are given are `scale` times the frames' size; the rectifier is of the smaller
    ones that are matched.
    """

    def __init__(
        self,
        calibration: StereoCalibration,
        scale: float,
        kernels: Kernels,
        mask_size: tuple[int, int],
        method: str,
    ) -> None:
        self._mask_size, self._method = mask_size, method
        smaller = min(VIEW_WIDTH / calibration.frame_size[0], scale)
        self.rectifier = Rectifier(calibration, smaller)
        self._matcher = DenseMatcher(self.rectifier, kernels=kernels, step=1, contrast=FAINT)
        self._matched = MofNState(MofNRule(MATCHED_SHARE, m=MATCHED_HITS, n=MATCHED_WINDOW))
        self._alone = MofNState(MofNRule(TEXTURED_SHARE, m=ALONE_HITS, n=ALONE_WINDOW))

    def begin(self, missed: int) -> None:
        """The next pair, `missed` pairs after the one before; not known unless it is looked at."""
        self._matched.begin(missed)
        self._alone.begin(missed)

    def take(self, valid: Bools, rectifier: Rectifier) -> None:
        """A pair that is proof by itself: its matches, in the views of its own rectifier."""
        self._matched.judge(_shares(valid, rectifier).ravel())

    def judge(self, left: F32, right: F32, distance_m: float | None = None) -> Detection:
        """What a pair comes to that shows no obstacle by itself.

        `left` and `right` are its rectified views, `distance_m` that of the few matches found in
        it.
        """
        faint = self._look(left, right)
        water = open_water_fault(left, right)
        if water is not None:
            self._doubt()
        if faint.matched == OBSTACLE:
            patches = faint.patches.astype(np.uint8) * 255
            size = self._mask_size[::-1]
            mask = np.asarray(cv2.resize(patches, size, interpolation=cv2.INTER_NEAREST), np.uint8)
            if distance_m is None and faint.disparity_px is not None:
                distance_m = self.rectifier.focal_baseline_px_m / faint.disparity_px
            note = f"faint: few matches, in {MATCHED_HITS} of the last {MATCHED_WINDOW} frames"
            return Detection(mask, self._method, distance_m=distance_m, note=note)
        if water is not None:
            fault = water.fault
        elif faint.alone == OBSTACLE:
            fault = Fault(Reason.STEREO, MISFIT)
        elif distance_m is not None:
            few = f"too few matches for a status, at {distance_m:.1f} m"
            fault = Fault(Reason.STEREO, few)
        elif UNKNOWN in (faint.matched, faint.alone):
            words = "something faint is in view, and the frames before are not known"
            fault = Fault(Reason.FRAME_RULE, words)
        else:
            fault = NO_FAULT
        if fault:
            vetoes_clear = water is None or water.vetoes_clear
            return Detection(None, self._method, fault=fault, vetoes_clear=vetoes_clear)
        return Detection(np.zeros(self._mask_size, np.uint8), self._method)

    def _doubt(self) -> None:
        """Nothing that the last pair shows is believed."""
        self._matched.doubt()
        self._alone.doubt()

    def _look(self, left: F32, right: F32) -> _Faint:
        """Match a pair of views, and say what stays."""
        width, height = self.rectifier.size
        views = (self._matcher.kernels.area_means(view, height, width) for view in (left, right))
        found = self._matcher.match(*views)
        shares = _shares(found.valid, self.rectifier)
        textured = _shares(found.textured, self.rectifier)
        alone = np.where(shares < MATCHED_OF_TEXTURED * textured, textured, 0.0)
        statuses = self._matched.judge(shares.ravel()), self._alone.judge(alone.ravel())
        patches = self._matched.confirmed.reshape(shares.shape)
        nearest = None
        if statuses[0] == OBSTACLE:
            nearest = self._nearest(found.disparity_px, found.valid, patches)
        return _Faint(*statuses, patches, nearest)

    def _nearest(self, disparity: F32, valid: Bools, patches: Bools) -> float | None:
        """See `_Faint.disparity_px`."""
        rows, columns = np.nonzero(valid)
        width, height = self.rectifier.calibration.frame_size
        places = self.rectifier.to_frame(np.column_stack([columns, rows]))
        x, y = (places * PATCHES // (width, height)).clip(0, PATCHES - 1).astype(np.int64).T
        own, seen = PATCHES * y + x, disparity[rows, columns]
        medians = [np.median(seen[own == patch]) for patch in np.unique(own[patches[y, x]])]
        return float(max(medians)) if medians else None


def _shares(view: NDArray[np.bool_], rectifier: Rectifier) -> F64:
    """Which part of each patch of the left frame is true in the left view."""
    side = PATCHES * _SAMPLES
    seen = rectifier.to_left(view.view(np.uint8), side, side)
    shares = cv2.resize(seen.astype(np.float64), (PATCHES, PATCHES), interpolation=cv2.INTER_AREA)
    return np.asarray(shares, np.float64)
