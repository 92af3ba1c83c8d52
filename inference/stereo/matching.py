r"""Dense matching of two rectified views: which pixels both cameras see, and their disparity.

::

      left camera  *---------* right camera        z = f * B / d
                   |\       /|
        blind: the | \     / |   nearer than `NEAREST_M` nothing is matched;
        left d px  |  \   /  |   farther than `FARTHEST_M` neither
        of the     |   \ /   |
        left frame |    X    |

What has no texture has no match. A match is kept where it is unique, where matching from right to
left finds it too, where both views have enough contrast, and in patches that are large enough.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, I16, U8, Bools
from tokt.features.common.errors import ToktError
from tokt.features.kernels.block_matching import (
    MAX_DISPARITY_PX,
    PADDING,
    PER_PIXEL,
    BlockMatching,
    padded,
)
from tokt.features.kernels.dispatch import KERNELS, Kernels
from tokt.inference.config import BM, MATCHERS

from .rectify import Rectifier

MIN_SIGMA_GREY = 1.0
"""Grey levels. A local deviation below counts as this much, or noise alone would fill the view."""

NEAREST_M, FARTHEST_M = 1.65, 10.6
"""Depths in metres that are searched: disparities 32 to 207 at half the mission's resolution."""

# Settings in pixels of a view `SETTINGS_WIDTH` wide: half the mission cameras' resolution. Source:
# the mission's measurements (valid matches on ocean frames 0, 23 % at frame 180) and the control
# that another right frame, or the right frame upside down, must leave hardly any at frame 180.
SETTINGS_WIDTH = 680
BLOCK_PX = 21
"""Also the largest: the sums of a larger block do not fit 16 bits."""
WINDOW_PX = 21
"""Height and width of what counts as around a pixel for its local contrast."""
BLOB_PX = 150
"""Fewest pixels of a patch of valid matches of like disparity; fewer are specks."""
LIKE_PX = 1
"""Most that the disparities of two neighbours in a patch differ by."""
GAIN = 12.5
"""Grey levels that one local standard deviation becomes before matching."""
CAP = 31
"""Where gradients are clipped: the largest for which OpenCV's matcher sums 16 bits."""
TEXTURE = 150
"""Least sum of absolute gradients over a block of `BLOCK_PX`."""
UNIQUENESS_PERCENT = 12
LEFT_RIGHT_PX = 1.5
LOCAL_SIGMA_GREY = 2.0
"""Grey levels of local contrast that a pixel needs in both views."""
SEMI_GLOBAL_BLOCK_PX = 7
STEP_PX = 2
"""Every so many rows and columns a pixel is matched, and its neighbours are taken to be alike: the
blocks of two neighbours share nine tenths of their pixels."""
_MIN_SEARCHED = 0.5
"""Part of the left frame that is searched: what is not cannot be told from open water."""


class Contrast(NamedTuple):
    """How little of a thing is looked for."""

    local_sigma: float = LOCAL_SIGMA_GREY  # grey levels that a pixel needs in both views
    least_sigma: float = MIN_SIGMA_GREY  # grey levels that a smaller local deviation counts as
    blob_px: int = BLOB_PX  # fewest pixels of a patch of matches, of a view `SETTINGS_WIDTH` wide


CLEAR_CONTRAST = Contrast()
"""What stands out so much that one pair proves it."""


@dataclass(frozen=True)
class Matches:
    """The matches of one pair, in the rectified left view; arrays of shape (height, width).

    What is not `searched` is the blind margin: where the left view shows nothing, or the right
    camera does not see what is there at any depth that is searched.
    """

    disparity_px: F32
    valid: Bools
    textured: Bools  # where the left view has enough local contrast to be matched
    searched: Bools


def disparity_range(rectifier: Rectifier) -> tuple[int, int]:
    """The smallest disparity in pixels that is searched, and how many, a multiple of 16."""
    # At disparity 0 the distance is infinite, and beside it negative.
    smallest = max(int(rectifier.focal_baseline_px_m / FARTHEST_M), 1)
    largest = math.ceil(rectifier.focal_baseline_px_m / NEAREST_M)
    return smallest, max(math.ceil((largest + 1 - smallest) / 16), 1) * 16


@dataclass(eq=False)
class DenseMatcher:
    """Match the views of one rectifier.

    The matcher is block matching (bm), or OpenCV's semi-global matching (sgbm): more matches,
    several times the time.

    Raises ToktError if there is no such matcher, the disparities do not fit the view or their
    integers, or most of the left frame would not be searched.
    """

    rectifier: Rectifier
    matcher: str = BM
    kernels: Kernels = KERNELS
    step: int = STEP_PX  # 1 for every pixel
    block_px: float = BLOCK_PX  # nearly, of a view `SETTINGS_WIDTH` wide
    contrast: Contrast = CLEAR_CONTRAST

    def __post_init__(self) -> None:
        if self.matcher not in MATCHERS:
            known = ", ".join(MATCHERS)
            raise ToktError(f"unknown matcher {self.matcher!r} (choose from {known})")
        width = self.rectifier.size[0]
        ratio = width / SETTINGS_WIDTH
        smallest, count = disparity_range(self.rectifier)
        if smallest >= width:
            raise ToktError(
                f"views of {width} pixels show nothing at {FARTHEST_M:g} m: the disparity there "
                f"is {smallest} pixels; is the calibration for these frames?"
            )
        if smallest + count > MAX_DISPARITY_PX:
            raise ToktError(
                f"disparities up to {smallest + count} pixels would be searched, {NEAREST_M:g} m "
                f"away, and at most {MAX_DISPARITY_PX} can be: take smaller views"
            )
        block = min(max(2 * round((self.block_px * ratio - 1) / 2) + 1, 5), BLOCK_PX)
        texture = round(TEXTURE * block**2 / BLOCK_PX**2)
        self.settings = BlockMatching(smallest, count, block, CAP, texture, UNIQUENESS_PERCENT)
        self._window = max(2 * round((WINDOW_PX * ratio - 1) / 2) + 1, 3)
        self._least_blob = max(round(self.contrast.blob_px * ratio**2), 2)
        self.searched = _searched(self.rectifier, self.settings)
        seen = self.rectifier.to_left(self.searched, 64, 64).mean()
        if seen < _MIN_SEARCHED:
            raise ToktError(
                f"by the calibration the right camera sees {100 * seen:.0f} % of what the left "
                f"one does, {NEAREST_M:g} to {FARTHEST_M:g} m away: is it for these cameras?"
            )
        self._searched = self.searched.view(np.uint8)
        self._matched_pixels = np.zeros_like(self._searched)
        self._matched_pixels[:: self.step, :: self.step] = 1

    def match(self, left: F32, right: F32) -> Matches:
        """Match a pair of rectified views, float32, of the rectifier's size."""
        least = self.contrast.least_sigma
        left_sigma, left_even = self.kernels.local_contrast(left, self._window, GAIN, least)
        textured = (left_sigma > self.contrast.local_sigma).view(np.uint8)
        textured &= self._searched
        if cv2.countNonZero(textured) < self._least_blob:
            nothing = np.zeros(left.shape, bool)
            none = np.full(left.shape, self.settings.unmatched / PER_PIXEL, np.float32)
            return Matches(none, nothing, textured.view(bool), self.searched)
        right_sigma, right_even = self.kernels.local_contrast(right, self._window, GAIN, least)
        wanted = np.asarray(cv2.bitwise_and(textured, self._matched_pixels), np.uint8)
        disparity = self._disparity(left_even, right_even, wanted)
        matched = np.s_[:: self.step, :: self.step]
        sparse = disparity[matched].astype(np.float32) / np.float32(PER_PIXEL)
        # First without specks: what is lost from right to left makes no speck larger.
        disparity[matched] = self._without_specks(disparity[matched])
        seen = self._seen_twice(disparity, left_even, right_even, right_sigma)
        kept = self._without_specks(seen[matched])
        valid = np.asarray(kept != self.settings.unmatched, np.uint8)
        return Matches(
            self._spread(sparse), self._spread(valid).view(bool), textured.view(bool), self.searched
        )

    def _without_specks(self, disparity: NDArray[Any]) -> I16:
        """Only connected regions of enough pixels of like disparity."""
        kept = disparity.astype(np.int16)
        largest_speck = math.ceil(self._least_blob / self.step**2) - 1
        cv2.filterSpeckles(kept, self.settings.unmatched, largest_speck, LIKE_PX * PER_PIXEL)
        return kept

    def _spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """What was found of every `step`-th pixel, for all of them."""
        height, width = self.searched.shape
        return np.asarray(cv2.resize(values, (width, height), interpolation=cv2.INTER_NEAREST))

    def _disparity(self, left: U8, right: U8, wanted: U8) -> I16:
        """Disparities in 1/16 pixel of the wanted pixels; `unmatched` elsewhere."""
        if self.matcher == BM:
            return self.kernels.block_disparity(left, right, self.settings, wanted)
        settings, area = self.settings, SEMI_GLOBAL_BLOCK_PX**2
        matcher = cv2.StereoSGBM.create(
            settings.min_disparity,
            settings.n_disparities,
            SEMI_GLOBAL_BLOCK_PX,
            P1=8 * area,  # as OpenCV itself recommends
            P2=32 * area,
            preFilterCap=settings.cap,
            uniquenessRatio=settings.uniqueness,
            mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
        )
        views = [padded(view, settings, PADDING) for view in (left, right)]
        found = matcher.compute(*views)[:, settings.margin :]
        return np.asarray(np.where(wanted != 0, found, settings.unmatched), np.int16)

    def _seen_twice(self, disparity: I16, left: U8, right: U8, right_sigma: F32) -> I16:
        """The disparities to which matching the right view with the left one leads back."""
        # By place in the flattened view: half the work of rows and columns.
        width = disparity.shape[1]
        here = np.flatnonzero(disparity.ravel() > self.settings.unmatched).astype(np.int32)
        found = disparity.ravel()[here]
        shift = (found + PER_PIXEL // 2) // PER_PIXEL
        there = here - shift
        kept = here % width >= shift
        kept &= right_sigma.ravel()[np.maximum(there, 0)] > self.contrast.local_sigma
        here, found, there = here[kept], found[kept], there[kept]
        wanted = np.zeros(disparity.shape, np.uint8)
        wanted.ravel()[there] = 1
        mirrored = [np.asarray(cv2.flip(view, 1), np.uint8) for view in (right, left, wanted)]
        back = np.asarray(cv2.flip(self._disparity(*mirrored), 1), np.int16)
        same = np.abs(back.ravel()[there] - found) <= LEFT_RIGHT_PX * PER_PIXEL
        seen = np.full(disparity.shape, self.settings.unmatched, np.int16)
        seen.ravel()[here[same]] = found[same]
        return seen


def _searched(rectifier: Rectifier, settings: BlockMatching) -> Bools:
    """Where the left view shows its frame, and the right one too at some disparity searched."""
    height, width = rectifier.left_inside.shape
    seen = np.zeros((height, width), bool)
    for disparity in range(settings.min_disparity, min(settings.margin, width)):
        seen[:, disparity:] |= rectifier.right_inside[:, : width - disparity]
    return seen & rectifier.left_inside
