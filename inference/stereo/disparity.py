"""Disparity: distances measured by a rectified stereo pair, and a mask of what is there.

Whatever both cameras see at a distance that is searched is white in the mask; open water gives no
match at all. Works at half the camera's resolution. What it cannot see is drawn in `matching`.

A frame with texture in it of which hardly any is matched is unknown, not clear: a wrong pair, a
wrong calibration, or something nearer than the nearest distance. So is one with some matches, yet
too few for a status. What stays over several frames is an obstacle, also where each of them shows
too little (`faint_matches`); and clear is only what looks like open water (`open_water_fault`).
"""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, U8
from tokt.features.extractors.frame_pictures import scaled_gray
from tokt.features.extractors.patch_detail import detail_grid
from tokt.features.frames.grid import Grid
from tokt.features.kernels.dispatch import KERNELS, Kernels
from tokt.features.kernels.quantization import STEPS_PER_LEVEL
from tokt.inference.config import BM, DEFAULT_SCALE
from tokt.inference.frame import Frame, pair_shape_fault
from tokt.inference.reason import Reason
from tokt.inference.sight import CONTRAST_FRAMES, SightMeter, stereo_meter
from tokt.inference.verdict import DISPARITY, STATUS_MEAN_THRESHOLD, Detection

from .calibration import StereoCalibration
from .epipolar_drift import EpipolarDriftCorrection
from .faint_matches import FaintMatches
from .matching import STEP_PX, DenseMatcher, Matches
from .pair_health import PairFault, PairHealth, Unfit, of_both_sides, unfit_pictures
from .rectify import Rectifier

NEAR_PERCENTILE = 20.0
"""Percentile of the depths that is reported as the distance: near, yet no few stray matches."""
FAR_PERCENTILE = 95.0
"""Percentile of the depths that says how far one sees."""


class Observation(NamedTuple):
    """A pair's detection, and the matches it comes from; None where nothing was matched at all."""

    detection: Detection
    matches: Matches | None


@dataclass(eq=False)
class DisparityDetector:
    """Judge stereo pairs, those of one run in their order.

    The drift correction, the check for a frozen camera, faint matches and the closing speed come
    from the pairs before.

    The mask is in the *unrectified* left frame resized to the grid's width: positions are those of
    the picture that the texture detector and the pilot see. Blind at the left edge are as many
    pixels as the disparity of what is there, since the right camera does not see them.

    Raises ToktError if by the calibration most of the left frame is out of view or not seen by the
    right camera, or there is no such matcher.
    """

    calibration: StereoCalibration
    grid: Grid  # its width is the mask's, so that texture's mask and this one are of one size
    matcher: str = BM  # as in `DenseMatcher`
    scale: float = DEFAULT_SCALE  # of the views that are matched, over the frames' size
    kernels: Kernels = KERNELS
    step: int = STEP_PX  # match every so many rows and columns only, for speed; 1 for all
    sight: SightMeter = field(default_factory=stereo_meter)
    threads: int = 1  # with 2 the left and right views are made side by side
    method: ClassVar = DISPARITY

    def __post_init__(self) -> None:
        self.rectifier = Rectifier(self.calibration, self.scale)
        self._drift = EpipolarDriftCorrection()
        self._health = PairHealth()
        self._closing = ClosingSpeed()
        self._farthest_px: deque[float | None] = deque(maxlen=CONTRAST_FRAMES)
        self._matcher = DenseMatcher(self.rectifier, self.matcher, self.kernels, self.step)
        width, height = self.calibration.frame_size
        self._mask_size = self.grid.resized(height, width)
        views = self.calibration, self.scale, self.kernels
        self._faint = FaintMatches(*views, self._mask_size, DISPARITY)

    def detect(self, frame: Frame) -> Detection:
        """Judge one pair.

        A missing picture or one of another size makes it unknown. In a dark, blank, saturated or
        damaged one, matches still prove an obstacle, while no match proves nothing: unknown too.
        """
        return self.observe(frame).detection

    def observe(self, frame: Frame) -> Observation:
        """Judge one pair, and tell the matches."""
        self._faint.begin(frame.missed)
        fault = pair_shape_fault(frame, self.calibration.frame_size)
        if frame.left is None or frame.right is None or fault:
            return Observation(Detection(None, DISPARITY, fault=fault), None)

        def view(side: str, picture: U8) -> F32:
            scaled = scaled_gray(picture, self.rectifier.size)
            small = _gray16(picture, scaled)
            if small is not None:
                frame.pictures(side, detail_grid(picture.shape[1])).offer(small)
            self.sight.of(frame, side)
            if side == "left":
                return self.rectifier.left_of(scaled)
            return self.rectifier.right_of(scaled, self.row_shift_px)

        views = of_both_sides(view, frame, self.threads)
        unfit = unfit_pictures(self.sight, frame)
        found = self._matcher.match(*views)
        offset = self._drift.add(*views, found, self.rectifier.scale)
        doubt = self._health.judge(*views, found, offset, self._drift)
        if doubt is not None and not unfit.fault:
            doubt = self._health.explained(doubt, frame.left, frame.right, self.match)
        judged = self._judged(views, found, unfit, doubt)
        judged = replace(judged, sight=replace(self.sight.of(frame), reach_m=self._reach_m(found)))
        if frame.timed:
            closing_m_s, contact_s = self._closing.add(frame.t, judged.distance_m)
            judged = replace(judged, closing_m_s=closing_m_s, contact_s=contact_s)
        return Observation(judged, found)

    @property
    def row_shift_px(self) -> float:
        """Rows at full resolution by which the right view of the next pair is moved down."""
        return self._drift.px

    def match(self, left: U8, right: U8, row_shift_px: float = 0.0) -> Matches:
        """Rectify and match a pair of frames of the calibration's size."""
        views = self.rectifier.left(left), self.rectifier.right(right, row_shift_px)
        return self._matcher.match(*views)

    def _judged(
        self, views: tuple[F32, F32], found: Matches, unfit: Unfit, doubt: PairFault | None
    ) -> Detection:
        """What matches come to: `unfit` says why a picture is, `doubt` why the two do not fit."""
        mask = np.zeros(self._mask_size, np.uint8)
        if found.valid.any():
            mask = self.rectifier.to_left(found.valid.astype(np.uint8) * 255, *self._mask_size)
        obstacle = cv2.mean(mask)[0] > STATUS_MEAN_THRESHOLD
        if doubt is not None and not (doubt.matches_stand and obstacle):
            # An unfit picture explains it; two good ones that do not match are a sign of danger.
            vetoes_clear = unfit.vetoes_clear or (doubt.vetoes_clear and not unfit.fault)
            fault = unfit.fault or doubt.fault
            return Detection(None, DISPARITY, fault=fault, vetoes_clear=vetoes_clear)
        distance = self.distance_m(found)
        if obstacle:
            self._faint.take(found.valid, self.rectifier)
            note = unfit.fault or (doubt.reason if doubt is not None else "")
            return Detection(mask, DISPARITY, distance_m=distance, note=note)
        unjudged = Detection(None, DISPARITY, fault=unfit.fault, vetoes_clear=unfit.vetoes_clear)
        if unfit.is_one_picture:
            return unjudged
        faint = self._faint.judge(*views, distance)
        if not unfit.fault:
            return faint
        # What is found in the part that is seen stays; that nothing is found proves nothing.
        if faint.mask is not None and faint.mask.any():
            return replace(faint, note=f"{faint.note}; {unfit.fault}")
        waits = faint.fault.reason is Reason.FRAME_RULE
        return replace(unjudged, vetoes_clear=unjudged.vetoes_clear or waits)

    def _reach_m(self, found: Matches) -> float | None:
        """Distance in metres of the farthest that was matched in the last pairs."""
        px = None
        if found.valid.any():
            px = float(np.percentile(found.disparity_px[found.valid], 100 - FAR_PERCENTILE))
        self._farthest_px.append(px)
        known = [each for each in self._farthest_px if each is not None]
        return self.rectifier.focal_baseline_px_m / min(known) if known else None

    def depth_m(self, found: Matches) -> F32:
        """Depth in metres along the views' axis, float32, (height, width); nan without a match."""
        depth = np.full(found.valid.shape, np.nan, np.float32)
        depth[found.valid] = self.rectifier.focal_baseline_px_m / found.disparity_px[found.valid]
        return depth

    def distance_m(self, found: Matches) -> float | None:
        """Near end of the matched depths in metres (`NEAR_PERCENTILE`), or None without matches."""
        if not found.valid.any():
            return None
        far = np.percentile(found.disparity_px[found.valid], 100 - NEAR_PERCENTILE)
        return float(self.rectifier.focal_baseline_px_m / far)


def _gray16(frame: U8, scaled: F32) -> NDArray[np.uint16] | None:
    """The small gray picture that sight is measured on, of one that is smaller than the frame."""
    height, width = detail_grid(frame.shape[1]).resized(*frame.shape[:2])
    if scaled.shape[1] < width:
        return None
    small = KERNELS.area_means(scaled, height, width)
    return np.asarray(np.rint(small * STEPS_PER_LEVEL), np.uint16)


WINDOW_S = 2.0
"""Seconds of distances that a line is fitted to. With the sea trial's jitter of distance, 0.03 m,
and 10 pairs a second the speed then has an error of 0.012 m/s (0.03 after `MIN_SPAN_S`), and it
is that of one second ago."""
MAX_POINTS = 40
"""Of more points in the window the oldest are left out: the slopes of 40 take 0.1 ms."""
MIN_POINTS = 5
MIN_SPAN_S = 1.0
"""Fewest points, and least seconds from the first to the last, that give a speed."""
GAP_S = 1.0
"""After so long without a distance it is another thing that is seen: the line starts anew."""
FASTEST_M_S = 3.0
"""No thing's distance changes faster. Source: twice the speed of a work-class ROV."""
JUMP_M = 0.3
"""Beside `FASTEST_M_S`, a distance may differ by this much from the last: ten times the jitter."""
MIN_CLOSING_M_S = 0.05
"""Slower is taken for standing still: no contact. Source: the speed's error, above."""


class Closing(NamedTuple):
    """Closing speed and time to contact, as far as the last distances tell."""

    closing_m_s: float | None = None  # by which the distance shrinks, negative while it grows
    contact_s: float | None = None  # until it is 0 at that speed; None unless it shrinks


class ClosingSpeed:
    """Follow one distance over time.

    ::

        distance          .     the slope is the median of the slopes between all pairs of points
           |  o            .    of the last seconds (Theil-Sen): a quarter of them may be wrong
           |     o  o       .
           |           o  *     a point off the line waits: it is dropped when the next ones are on
           |              o     the line again, and starts a new line when they are off like itself
           +------------------ time

    Notes
    -----
    Times need not be regular. A time that is not later than the last one, or is no number, starts
    anew, as a clock that was set does. Memory is at most `MAX_POINTS` points.
    """

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=MAX_POINTS)
        self._waiting: list[tuple[float, float]] = []
        self._last_s = -math.inf

    def add(self, t_s: float, distance_m: float | None) -> Closing:
        """Take the distance in metres at one moment, in seconds of any clock that goes evenly.

        It is None where nothing was seen or measured. A gap shorter than `GAP_S` leaves the
        distances before it standing, and gives no speed itself.
        """
        if not self._last_s < t_s < math.inf:
            self._start_anew()
        self._last_s = t_s if math.isfinite(t_s) else -math.inf
        if distance_m is None or not math.isfinite(t_s) or not 0 <= distance_m < math.inf:
            return Closing()
        self._take((t_s, distance_m))
        return Closing() if self._waiting else self._fitted(t_s)

    def _start_anew(self) -> None:
        self._points.clear()
        self._waiting.clear()

    def _take(self, point: tuple[float, float]) -> None:
        """Add a point to the line, or keep it waiting where it is off the line."""
        newest = self._waiting or self._points
        if newest and point[0] - newest[-1][0] > GAP_S:
            self._start_anew()
        if not self._points or _continues(self._points[-1], point):
            self._waiting.clear()
            self._points.append(point)
        elif self._waiting and _continues(self._waiting[-1], point):
            # Two alike: what is seen has changed.
            self._points.clear()
            self._points.extend((*self._waiting, point))
            self._waiting.clear()
        else:
            self._waiting[:] = [point]
        while self._points and point[0] - self._points[0][0] > WINDOW_S:
            self._points.popleft()

    def _fitted(self, t_s: float) -> Closing:
        """Speed and time to contact from the points of the window."""
        points = np.array(self._points)
        if len(points) < MIN_POINTS or points[-1, 0] - points[0, 0] < MIN_SPAN_S:
            return Closing()
        # The line through the points by Theil and Sen.
        x, y = points[:, 0] - t_s, points[:, 1]
        first, second = np.triu_indices(len(x), 1)
        slope = float(np.median((y[second] - y[first]) / (x[second] - x[first])))
        distance_m, closing = float(np.median(y - slope * x)), -slope
        if closing < MIN_CLOSING_M_S:
            return Closing(closing)
        return Closing(closing, max(distance_m, 0.0) / closing)


def _continues(old: tuple[float, float], new: tuple[float, float]) -> bool:
    """Whether one thing can have been at both distances."""
    return abs(new[1] - old[1]) <= JUMP_M + FASTEST_M_S * (new[0] - old[0])
