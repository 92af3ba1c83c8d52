"""Temporal cues: the trend of a policy's verdicts over time, and the anchor's errors.

::

    frame ──> policy ──> verdict ──> trend of its mean      (its method, its model: else anew)
                                └──> errors of the anchor   (where one was asked for)
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from tokt.features.common.errors import ToktError
from tokt.inference.frame import Frame
from tokt.inference.texture.detector import ReloadableTextureDetector
from tokt.inference.verdict import OBSTACLE, STATUS_MEAN_THRESHOLD, UNKNOWN, Verdict

from .object_model import Box, inside
from .object_tracker import ObjectTracker
from .policy import Judgement, Policy

MIN_SIZE, MAX_SIZE = 0.01, 0.9
"""Wanted shares of the picture that can be held: from one patch of a 10x10 grid, smaller than which
nothing is seen, up to a picture that is full."""


class AnchorErrors(NamedTuple):
    """Errors of the object from where it is wanted, to three decimals; None where none is seen.

    Its centre from the picture's, -1..1: right and down are positive. Its size as ln(sqrt(share /
    wanted share)), which is ln(wanted distance / distance) of an object wholly in view: positive
    too near, negative too far.
    """

    x: float | None = None
    y: float | None = None
    size: float | None = None


@dataclass(frozen=True)
class Anchor:
    """The object's wanted size in the picture's centre.

    Three errors for a control system that keeps the vehicle before an object, such as one that is
    looked at from all sides (L. S. Brusletto, NTNU 2016, section 7.2). They say where the object
    is, not where to steer: `Verdict.x` and `Verdict.y` point away from it.

    ::

        -1        0        1  x      x, y   the object's centre in the picture: 0, 0 in its middle,
         +--------+--------+ -1             1 at its right and its lower edge
         |        |        |         size   ln of the wanted distance over the distance, were the
         |        |  ###   |                object wholly in view: half the ln of the share of the
         |--------+--###---|  0             picture that it covers over the share that is wanted
         |        |  ###   |
         |        |        |         x > 0     it is right: turn, or sway, to the right
         +--------+--------+  1      y > 0     it is below: go down
                             y       size > 0  it is too large, too near: go back

    ToktError if the wanted share is not `MIN_SIZE` to `MAX_SIZE`.
    """

    size: float  # wanted share of the picture that the object covers

    def __post_init__(self) -> None:
        if not MIN_SIZE <= self.size <= MAX_SIZE:
            raise ToktError(
                f"an anchor is the share of the frame that the object is to cover, "
                f"{MIN_SIZE:g} to {MAX_SIZE:g}, not {self.size:g} (--anchor SHARE)"
            )

    def errors(self, verdict: Verdict) -> AnchorErrors:
        """The errors of what a frame's verdict says is there; none without an obstacle."""
        x, y, mean, size = verdict.x, verdict.y, verdict.mean, verdict.mask_size
        if verdict.status != OBSTACLE or x is None or y is None or mean is None or size is None:
            return AnchorErrors()
        if not mean > 0:
            return AnchorErrors()
        height, width = size
        too_large = 0.5 * math.log(mean / 255 / self.size)
        return AnchorErrors(_share(-x, width), _share(-y, height), round(too_large, 3))


def _share(from_centre_px: int, length_px: int) -> float:
    """A place in pixels from the picture's centre, over the half of its length."""
    return _rounded(from_centre_px / max(length_px // 2, 1))


def _rounded(share: float) -> float:
    return round(min(max(share, -1.0), 1.0), 3) + 0.0  # + 0.0: no -0.0


GROWING, STEADY, SHRINKING = "growing", "steady", "shrinking"
TRENDS = (GROWING, STEADY, SHRINKING)

SLOT_S = 0.25
SLOTS = 16
"""The means of a quarter of a second count as one, the newest 16 count. A model's errors in frames
that follow each other fast are alike, so that more frames a second tell little more."""
MIN_SLOTS = 5
MIN_SPAN_S = 1.5
"""Fewest slots, and least seconds from the first to the last, that give a trend."""
GAP_S = 1.5
"""After so long without anything seen it is another thing that is seen: the means start anew."""
HORIZON_S = (SLOTS + 1) * SLOT_S
"""Nothing that is older has a part in a trend."""
END_S = 1e12
"""No time is later, as in milliseconds or nanoseconds: its fractions of a second would be lost."""

STEADY_PER_S = 0.05
"""A mean that changes by less than this part of itself a second is steady: what comes nearer is
then more than 40 s away."""
PATCH_MEAN = 2.55
"""Mean of one patch of a 10x10 grid. No mean is taken to be truer than a patch's rounding."""
MAX_ALIKE = 0.7
"""Most that errors of neighbouring slots are taken to be alike (their correlation)."""
MIN_CONFIDENCE = 0.5
"""Less is not said: no trend is known."""
CONTACT_CONFIDENCE = 0.9
"""Least confidence of *growing* with which a time to contact is given."""
SATURATED_MEAN = 0.9 * 255
"""Over it the picture is full, and what comes nearer cannot grow: no trend."""
_MIN_INVERSE = 255**-0.5


class Trend(NamedTuple):
    """The trend of the last means.

    `trend` is the mean's, growing, steady or shrinking; None where it is not known. What leaves the
    picture at its edge shrinks as well, and is no farther away. `confidence`, 0.5..1 to three
    decimals, is its probability, given the means and equal chances of any slope before.
    `contact_s`, to two decimals, holds for one thing at a constant speed; None unless it grows with
    `CONTACT_CONFIDENCE` and was wholly in view all the while.
    """

    trend: str | None = None
    confidence: float | None = None
    contact_s: float | None = None


@dataclass(slots=True)
class _Slot:
    """The means of a quarter of a second."""

    index: int
    n: int = 0
    t_s: float = 0.0
    mean: float = 0.0
    cut: bool = False

    def add(self, t_s: float, mean: float, whole: bool) -> None:
        """Take one mean in."""
        self.n += 1
        self.t_s += (t_s - self.t_s) / self.n
        self.mean += (mean - self.mean) / self.n
        self.cut |= not whole


class TrendEstimator:
    """Follow one mean value over time.

    The mean value of the mask over time as a relative distance (L. S. Brusletto, NTNU 2016,
    sections 5.2.1 and 7.2): what comes nearer covers more of the picture. No calibration is needed,
    and no second camera.

    ::

        mean                 .      a line through the means of the last seconds, one mean a slot
          |            o   .o       of a quarter of a second; what the rest differs from the line
          |       o  . o            tells how sure its slope is. A frame in which nothing is seen
          |    o .o                 (a status that flickers) is passed over.
          |  .o
          +-------------------- time

        1 / sqrt(mean)              of a thing wholly in view is its distance times a constant: at a
          |  o.                     constant speed it falls on a line, which reaches 0 when the
          |     o .o                thing is reached.
          |          .o o
          |              . - - .
          +---------------------x-- time

    The mean is proportional to the projected area A of a thing wholly in view, A ~ 1 / Z**2, hence
    the time to contact tau = Z / -(dZ/dt) = 2 A / (dA/dt) (Lee, 1976, A theory of visual control of
    braking based on information about time-to-collision, Perception 5). The line through 1 /
    sqrt(A) gives the same without the lag that a slope of A itself has, since A grows faster and
    faster.

    Notes
    -----
    Times need not be regular; a clock may tick so coarsely that two are the same. A time before the
    last one, or that is no number, starts anew, as a clock that was set back does. Memory is
    `SLOTS` slots; what is older than `HORIZON_S` has no influence to the last bit.
    """

    def __init__(self) -> None:
        self._slots: deque[_Slot] = deque()
        self._last_s = self._seen_s = -math.inf

    def add(self, t_s: float, mean: float | None, whole: bool = True) -> Trend:
        """Take the mean of the 0/255 mask, 0..255, at one moment, in seconds of any even clock.

        It is None where nothing could be judged. Such a frame, and one in which nothing is seen,
        has no trend itself and leaves the means before it standing for `GAP_S`. `whole` is whether
        what is seen lies wholly in the picture.
        """
        # Written so that what is not a number is no time, and no mean that was seen.
        timed = abs(t_s) < END_S
        if not (timed and t_s >= self._last_s):
            self._slots.clear()
        self._last_s = t_s if timed else -math.inf
        if mean is None or not STATUS_MEAN_THRESHOLD < mean <= 255 or not timed:
            return Trend()
        self._take(t_s, mean, whole)
        if mean > SATURATED_MEAN:
            return Trend()
        return self._fitted(t_s)

    def _take(self, t_s: float, mean: float, whole: bool) -> None:
        slots = self._slots
        if slots and t_s - self._seen_s > GAP_S:
            slots.clear()
        self._seen_s = t_s
        # Slots of the clock, not of the first mean: they do not hang on when somebody began.
        index = math.floor(t_s / SLOT_S)
        if not slots or slots[-1].index != index:
            slots.append(_Slot(index))
        slots[-1].add(t_s, mean, whole)
        while slots[0].index <= index - SLOTS:
            slots.popleft()

    def _fitted(self, t_s: float) -> Trend:
        slots = self._slots
        if len(slots) < MIN_SLOTS or slots[-1].t_s - slots[0].t_s < MIN_SPAN_S:
            return Trend()
        times = [slot.t_s - t_s for slot in slots]
        means = [slot.mean for slot in slots]
        trend, confidence = _judged(*_line(times, means))
        if confidence < MIN_CONFIDENCE:
            return Trend()
        contact_s = None
        growing = trend == GROWING and confidence >= CONTACT_CONFIDENCE
        if growing and not any(slot.cut for slot in slots):
            contact_s = _contact_s(times, means)
        return Trend(trend, round(confidence, 3), contact_s)


def _line(times: list[float], means: list[float]) -> tuple[float, float, int]:
    """The line through points by least squares.

    Its slope over the mean of the points, that figure's standard error, and its degrees of freedom.
    Where a residual is like the one before it, the points are worth fewer (first-order
    autocorrelation, its estimate corrected for few points: Marriott and Pope 1954), and each has at
    least the error of a patch's rounding.
    """
    n = len(times)
    middle_s, level = sum(times) / n, sum(means) / n
    offsets = [time - middle_s for time in times]
    spread = product = 0.0
    for offset, mean in zip(offsets, means, strict=True):
        spread += offset * offset
        product += offset * mean
    slope = product / spread
    squares = neighbours = before = 0.0
    for offset, mean in zip(offsets, means, strict=True):
        error = mean - level - slope * offset
        squares += error * error
        neighbours += error * before
        before = error
    worth = 1.0
    if squares > 0:
        alike = neighbours / squares
        alike = min(max(alike + (1 + 4 * alike) / n, 0.0), MAX_ALIKE)
        worth = (1 - alike) / (1 + alike)
    variance = squares / (n - 2) / worth + PATCH_MEAN**2 / 12
    return slope / level, math.sqrt(variance / spread) / level, n - 2


def _judged(per_s: float, error_per_s: float, freedom: int) -> tuple[str, float]:
    """The likeliest of the three trends, and how likely it is."""
    growing = _probability((per_s - STEADY_PER_S) / error_per_s, freedom)
    shrinking = _probability((-STEADY_PER_S - per_s) / error_per_s, freedom)
    steady = 1 - growing - shrinking
    # STEADY first: nothing says which way where two are equal.
    trends = (steady, STEADY), (growing, GROWING), (shrinking, SHRINKING)
    probability, likeliest = max(trends, key=itemgetter(0))
    return likeliest, probability


def _probability(t: float, freedom: int) -> float:
    """Student's t distribution function, by Abramowitz and Stegun 26.7.8, within 0.003."""
    z = t * (1 - 1 / (4 * freedom)) / math.sqrt(1 + t * t / (2 * freedom))
    return 0.5 * math.erfc(-z / math.sqrt(2))


def _contact_s(times: list[float], means: list[float]) -> float | None:
    """Seconds from time 0 until the line through 1 / sqrt(mean) is 0; None if it does not fall."""
    inverse = [1 / math.sqrt(mean) for mean in means]
    value, slope = _weighted_line(times, inverse, means)
    # An error of the mean is one of mean**-1.5 / 2 in its inverse root. Weighed by the line's
    # means and not by the points': a mean that is too high by chance would weigh more.
    on_line = [max(value + slope * time, _MIN_INVERSE) for time in times]
    weights = [1 / (y * y * y * y * y * y) for y in on_line]
    value, slope = _weighted_line(times, inverse, weights)
    if slope >= 0 or value <= 0:
        return None
    return round(-value / slope, 2)


def _weighted_line(
    times: list[float], values: list[float], weights: list[float]
) -> tuple[float, float]:
    """Value at 0 and slope of the line through points by weighted least squares."""
    total = t = v = tt = tv = 0.0
    for time, value, weight in zip(times, values, weights, strict=True):
        weighed = weight * time
        total += weight
        t += weighed
        v += weight * value
        tt += weighed * time
        tv += weighed * value
    slope = (total * tv - t * v) / (total * tt - t * t)
    return (v - slope * t) / total, slope


EDGE = 0.04
"""What comes nearer to the picture's edge than this share of its length may be cut off by it: more
than the rows and columns that a grid leaves over, less than one of its patches."""


def wholly_in_view(verdict: Verdict, blind_m: float = 0.0) -> bool:
    """Whether what was seen lies wholly in the picture.

    `blind_m`, of a stereo pair, is the part of the picture's width at the left edge that the right
    camera does not see, times the distance in metres. It holds where the verdict has a distance.
    """
    if verdict.box is None or verdict.mask_size is None:
        return False
    x0, y0, box_width, box_height = verdict.box
    height, width = verdict.mask_size
    blind = 0.0
    if verdict.distance_m is not None:
        blind = blind_m / max(verdict.distance_m, blind_m) if blind_m > 0 else 0.0
    return (
        x0 >= (EDGE + blind) * width
        and x0 + box_width <= (1 - EDGE) * width
        and y0 >= EDGE * height
        and y0 + box_height <= (1 - EDGE) * height
    )


ALONE = 0.8
"""Of what a detector sees, in the box of an object: then the distance is that object's."""


def _distance_m(judgement: Judgement, box: Box) -> float | None:
    """Distance of what is in a box, where hardly anything is seen beside it."""
    mask = judgement.mask
    if mask is None or judgement.verdict.distance_m is None:
        return None
    seen, there = (int(np.count_nonzero(each)) for each in (mask, mask[inside(box, mask.shape)]))
    return judgement.verdict.distance_m if there >= ALONE * max(seen, 1) else None


@dataclass(eq=False)
class TemporalCues:
    """Another policy's verdicts, with their trend over time and the anchor's errors.

    A trend is that of one method and one model: where another one judges, as the policy's may be
    exchanged, it begins anew. It needs frames with times (`Frame.timed`). `blind_m` is as in
    `wholly_in_view`. With a `tracker` the errors are those of the object that it holds; without
    an `anchor` it is wanted as large as where it was named.
    """

    policy: Policy
    texture: ReloadableTextureDetector | None = None
    anchor: Anchor | None = None
    blind_m: float = 0.0
    tracker: ObjectTracker | None = None

    def __post_init__(self) -> None:
        self._watch = TrendEstimator()
        self._detector = None if self.texture is None else self.texture.detector
        self._method = ""

    def judge(self, frame: Frame) -> Judgement:
        """The policy's answer, with what follows from it."""
        judgement = self.policy.judge(frame)
        verdict = judgement.verdict
        trend = self._trend(frame, verdict)
        errors, held = self._errors(frame, judgement)
        if trend.trend is None and errors.x is None and self.tracker is None:
            return judgement
        with_cues = replace(
            verdict,
            trend=trend.trend,
            trend_confidence=trend.confidence,
            expansion_contact_s=trend.contact_s,
            anchor_x=errors.x,
            anchor_y=errors.y,
            anchor_size=errors.size,
            anchor=None if self.tracker is None else self.tracker.state,
        )
        return replace(judgement, verdict=with_cues, held=held)

    def _errors(self, frame: Frame, judgement: Judgement) -> tuple[AnchorErrors, Box | None]:
        """The anchor's errors, and where the named object is held."""
        tracker, anchor = self.tracker, self.anchor
        if tracker is None:
            return AnchorErrors() if anchor is None else anchor.errors(judgement.verdict), None
        model = tracker.model
        place = tracker.look(
            frame.left,
            frame.missed,
            distance=lambda at: _distance_m(judgement, model.box_at(at)),
            shared=frame.shared,
        )
        if place is None:
            return AnchorErrors(), None
        x, y, wide, high = box = model.box_at(place)
        wanted = 0.0 if anchor is None else model.size_of(anchor.size)
        across, down = (_rounded(2 * share - 1) for share in (x + wide / 2, y + high / 2))
        return AnchorErrors(across, down, round(place.size - wanted, 3) + 0.0), box

    def _trend(self, frame: Frame, verdict: Verdict) -> Trend:
        if not frame.timed:
            return Trend()
        detector = None if self.texture is None else self.texture.detector
        judged = verdict.status != UNKNOWN
        if detector is not self._detector or (judged and verdict.method != self._method):
            self._watch = TrendEstimator()
            self._detector = detector
        if not judged:
            return self._watch.add(frame.t, None)
        self._method = verdict.method
        return self._watch.add(frame.t, verdict.mean, wholly_in_view(verdict, self.blind_m))
