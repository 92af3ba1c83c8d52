"""Pairing the captures of two cameras that were taken at the same moment.

Two captures are of one moment when they were taken within half a period of each other. What makes
that hard is that each camera stamps with a clock of its own, of any zero and a little drift:

::

    taken_s of the left     ───┬───────┬───────┬───>   its own seconds
                               │ + least (arrived - taken) so far
    both, in host seconds   ───L─R─────L─R─────L───>   |L - R| < period / 2: one moment
                                 │ + the same for the right
    taken_s of the right    ─────┴───────┴─────────>   its own seconds

The difference between a camera's clock and this machine's is taken as the least that was seen, as
a capture is delayed by the link and the scheduler but never comes early. It is let rise as fast as
clocks can drift apart, and no faster: a link that is slow for seconds does not move it. What stays
is the least delay of the link, which is the same for two alike cameras. Where one's is longer by
half a period or more from the start, or for a minute, no estimate from arrivals can see it: only
clocks set by PTP pair right (`ClockFit.shared`: their times are compared as they are). As long as
too little is known nothing is paired.

Everything here is free of clocks and threads: the caller says what time it is.
"""

import math
from collections import deque
from dataclasses import dataclass

from tokt.inference.reason import NO_FAULT, Fault, Reason

from .capture import LEFT, RIGHT, Capture

_WINDOW = 64  # intervals between captures, for the period
# A camera's crystal is within 100 ppm, and a PC's clock is corrected by 500 ppm at most.
_DRIFT = 600e-6
_MIN_SAMPLES = 8  # more than a driver has buffers: no single stall has delayed all of them
_MAX_WAITING = 4  # captures of a camera that wait for the other's
_MAX_STEP = 1000  # more than a camera can leave out before it is lost: a number that is no count

NOT_FITTED = Fault(Reason.UNPAIRED, "the cameras' clocks have not been compared yet")
_NO_TIME = Fault(Reason.UNPAIRED, "the camera gave no time of exposure")
_NO_PARTNER = Fault(Reason.UNPAIRED, "no frame within half a period")


class _Exposures:
    """The exposures that a camera has delivered, by their times or numbers."""

    def __init__(self) -> None:
        self.seen: deque[float] = deque(maxlen=_WINDOW)  # the last ones, each once
        self._newest = -math.inf
        self._forward = 0

    def old(self, mark: float) -> str:
        """What is wrong with the next one, in words; empty where it is new.

        One that goes back is a buffer from before, or the clock was set: that is believed when more
        run forward in a row than a driver has buffers, none of them seen before.
        """
        if mark in self.seen:
            self._forward = 0
            return "was handed out again"
        runs_on = bool(self.seen) and mark > self.seen[-1]
        self.seen.append(mark)
        if mark <= self._newest:
            self._forward = self._forward + 1 if runs_on else 1
            if self._forward <= _MIN_SAMPLES:
                return "is older than one before"
        self._newest, self._forward = mark, 0
        return ""


class ClockFit:
    """A camera's clock against this machine's, and its period, estimated from its captures.

    `period_s` is that between two exposures as the camera is set, and `shared` whether its clock is
    that of the other already.
    """

    def __init__(self, period_s: float | None = None, shared: bool = False) -> None:
        # A camera may well say NaN.
        self._nominal_s = [each for each in (period_s,) if each and math.isfinite(each)]
        self.shared = shared
        self._offset_s = math.inf  # from the camera's clock to the host's, with the least delay
        self._samples = 0
        self._periods: deque[float] = deque(maxlen=_WINDOW)
        self._last: Capture | None = None
        self._exposures = _Exposures(), _Exposures()

    def old(self, capture: Capture) -> Fault:
        """Why a capture is of no new exposure; empty where it is of one. To be asked once for each.

        By its time, or its number where it has no time. A camera that gives neither, or each the
        same number, cannot be told from one that repeats its buffers: their pictures tell.
        """
        untimed = math.isnan(capture.taken_s)
        exposures = self._exposures[untimed]
        words = exposures.old(float(capture.frame_id) if untimed else capture.taken_s)
        if not words or (untimed and len(exposures.seen) < 2):
            return NO_FAULT
        how = "number" if untimed else "time"
        return Fault(Reason.STALE, f"frame {capture.frame_id} {words}, by its {how}")

    def add(self, capture: Capture) -> int:
        """Learn from a capture that has a time; how many were left out before it.

        Those the camera took since the one before and did not deliver, by its own numbers; 0 where
        these do not tell.
        """
        last, self._last = self._last, capture
        step = 0
        if last is not None:
            step = capture.frame_id - last.frame_id
            step = step if step <= _MAX_STEP else 0
            self._follow(capture.taken_s - last.taken_s, max(1, step))
            self._offset_s += _DRIFT * max(0.0, capture.arrived - last.arrived)
        self._offset_s = min(self._offset_s, capture.arrived - capture.taken_s)
        self._samples += 1
        return max(0, step - 1)

    def _follow(self, elapsed_s: float, step: int) -> None:
        """See whether the clock went on, by so many exposures, or was set back."""
        if elapsed_s <= 0 or elapsed_s < (step - 0.5) * (self.period_s or 0.0):
            self._offset_s, self._samples = math.inf, 0
            self._periods.clear()
        if elapsed_s > 0:
            # Numbers may wrap, or count delivered captures only: then a period comes out too
            # long, which is why the least of them is taken.
            self._periods.append(elapsed_s / step)

    @property
    def period_s(self) -> float | None:
        """Seconds between exposures, rather too short than too long; None if not known."""
        return min((*self._nominal_s, *self._periods), default=None)

    def common_s(self, taken_s: float, shared: bool) -> float:
        """A time by the camera's clock, in seconds that both cameras share; NaN if not known.

        `shared` is whether both cameras' clocks are one.
        """
        if shared:
            return taken_s
        return taken_s + self._offset_s if self._samples >= _MIN_SAMPLES else math.nan


@dataclass(frozen=True)
class Moment:
    """The captures of one moment: a pair, or that of one camera alone."""

    left: Capture | None
    right: Capture | None
    alone: Fault  # why one is missing; empty for a pair, and where there is but one camera
    at: float  # in seconds that all moments share; not a number where that is not known


class Pairer:
    """Put the captures of two cameras together, each in exactly one moment."""

    def __init__(self) -> None:
        self.fits: list[ClockFit | None] = [None, None]
        self._waiting: tuple[deque[tuple[float, Capture]], ...] = (deque(), deque())
        self._newest = [-math.inf, -math.inf]

    def present(self, camera: int, fit: ClockFit) -> None:
        """A camera delivers from now on, for the first time or again."""
        self.fits[camera] = fit
        self._newest = [-math.inf, -math.inf]

    def absent(self, camera: int) -> list[Moment]:
        """A camera is gone: nothing waits for it any more, or of it; what is settled by that."""
        self.fits[camera] = None
        left, right = map(len, self._waiting)
        return [*self._alone(LEFT, left), *self._alone(RIGHT, right)]

    @property
    def period_s(self) -> float | None:
        """The shorter of the cameras' periods, or None if one is not known."""
        fits = (fit for fit in self.fits if fit is not None)
        periods = [fit.period_s for fit in fits if fit.period_s is not None]
        return min(periods) if len(periods) == len(self.fits) else None

    def add(self, capture: Capture) -> list[Moment]:
        """Take a capture that its camera's `ClockFit` has learnt from; what is settled by it."""
        camera, other = capture.camera, 1 - capture.camera
        fit = self.fits[camera]
        if fit is None or math.isnan(capture.taken_s):
            return [_moment(capture, _NO_TIME, math.nan)]
        shared = all(known.shared for known in self.fits if known is not None)
        at, period_s = fit.common_s(capture.taken_s, shared), self.period_s
        if self.fits[other] is None:  # its source knows why better
            return [_moment(capture, _NO_PARTNER, at)]
        if math.isnan(at) or period_s is None:
            return [_moment(capture, NOT_FITTED, math.nan)]
        self._newest[camera] = at
        return self._paired(capture, at, 0.5 * period_s)

    def _paired(self, capture: Capture, at: float, half_s: float) -> list[Moment]:
        camera, other = capture.camera, 1 - capture.camera
        others = self._waiting[other]
        # Captures of a camera come in order: what is too old for this one is for all after it.
        past = sum(when <= at - half_s for when, _ in others)
        settled = self._alone(other, past)
        if others and others[0][0] < at + half_s:
            when, partner = others.popleft()
            settled += self._alone(camera, len(self._waiting[camera]))
            pair = (capture, partner) if camera == LEFT else (partner, capture)
            return [*settled, Moment(*pair, NO_FAULT, at if camera == LEFT else when)]
        if self._newest[other] >= at + half_s:  # the other camera is further already
            return [*settled, _moment(capture, _NO_PARTNER, at)]
        self._waiting[camera].append((at, capture))
        if len(self._waiting[camera]) > _MAX_WAITING:
            settled += self._alone(camera, 1)
        return settled

    def expired(self, now: float) -> list[Moment]:
        """What has waited for longer than a period, by `Clock.monotonic`."""
        return [
            moment
            for camera, waiting in enumerate(self._waiting)
            for moment in self._alone(camera, sum(self._due(held) <= now for _, held in waiting))
        ]

    def due(self) -> float | None:
        """When `expired` is to be asked next: `Clock.monotonic`, in seconds."""
        return min((self._due(waiting[0][1]) for waiting in self._waiting if waiting), default=None)

    def _due(self, capture: Capture) -> float:
        return capture.arrived + (self.period_s or 0.0)

    def _alone(self, camera: int, count: int) -> list[Moment]:
        """Settle the first so many of those of a camera that wait."""
        waiting = self._waiting[camera]
        held = [waiting.popleft() for _ in range(count)]
        return [_moment(capture, _NO_PARTNER, at) for at, capture in held]


def _moment(capture: Capture, alone: Fault, at: float) -> Moment:
    """What one camera has alone."""
    if capture.camera == LEFT:
        return Moment(capture, None, alone, at)
    return Moment(None, capture, alone, at)
