"""Frames that may be older than they look: after a suspend of the computer, and after a stall."""

import math
from collections import deque
from dataclasses import replace
from typing import Any

from tokt.features.common.arrays import median
from tokt.inference.clock import Clock
from tokt.inference.config import Limits
from tokt.inference.frame import MANY_MISSED, Frame
from tokt.inference.reason import Fault, Reason

_SUSPENDED_S = 0.05
_SPACINGS, _FEWEST_SPACINGS = 9, 4  # frames whose spacing is remembered, and least to go by

STALLED = 2.0
"""How many times the usual spacing of frames, and more than the age at which a frame is stale, is a
stall: what was on its way meanwhile comes when it ends, and is as old as the stall is long."""
IN_STEP = 0.75
"""Part of the usual spacing by which a frame follows the one before it that is no longer held up.
What was held up comes as fast as the network or the server can send it."""


class StaleFrameDetector:
    """Remove the pictures of frames that may be older than they look.

    ::

        taken    1   2   3   4   5   6   7   8   9
        comes    1   2   3 - - - - - - 4567  8   9      after a stall
        known    1   2   3   ?   ?   ?   ????    9      8 is in step with the time 7 was taken at,
                                                        or may be; 9 is in step with 8

    What was in a camera's or its driver's buffers when the computer was suspended is handed over
    afterwards as if it were new: from the first frame on that comes then, nothing is believed for
    as long as a frame may be old. After a stall nothing is believed until a frame follows the one
    before it in step, or as many have come as are taken in that time. A source that knows when its
    frames were taken says when they would have arrived, and so has no stall.
    """

    def __init__(self, clock: Clock, limits: Limits) -> None:
        self._clock = clock
        self._limits = limits
        self._suspended_s = clock.suspended()
        self._believed_from = -math.inf
        self._last_s: float | None = None
        self._spacings_s: deque[float] = deque(maxlen=_SPACINGS)
        self._stalled_s: float | None = None  # since the last frame before a stall
        self._since = 0  # frames that were taken since

    def remove(self, frame: Frame) -> Frame:
        """The same frame; without its pictures, and none before it known, where it is in doubt."""
        suspended_s = self._clock.suspended()
        if suspended_s - self._suspended_s > _SUSPENDED_S:
            self._suspended_s = suspended_s
            self._believed_from = self._clock.monotonic() + self._limits.stale_s
        if frame.arrived is None:
            return frame
        words = self._stalled(frame.arrived, frame.missed + 1)
        if frame.arrived < self._believed_from:
            words = "the computer was suspended just before this frame"
        if not words:
            return frame
        fault = Fault(Reason.STALE, f"stale: {words}")
        doubtful: dict[str, Any] = {"missed": MANY_MISSED}
        for side in ("left", "right"):
            if getattr(frame, side) is not None:
                doubtful |= {side: None, f"{side}_fault": fault}
        return replace(frame, **doubtful)

    def _stalled(self, arrived_s: float, taken: int) -> str:
        """Why a frame may be old, by when it and those before it arrived; or an empty string."""
        last_s, self._last_s = self._last_s, arrived_s
        if last_s is None:
            return ""
        gap_s, spacing_s = arrived_s - last_s, (arrived_s - last_s) / taken
        known = len(self._spacings_s) >= _FEWEST_SPACINGS
        usual_s = float(median(self._spacings_s)) if known else 0.0
        in_step = spacing_s >= IN_STEP * usual_s
        self._since += taken
        if known and gap_s > max(STALLED * usual_s, self._limits.stale_s):
            self._stalled_s, self._since = last_s, taken
        elif self._stalled_s is not None and (
            in_step or self._since * usual_s >= arrived_s - self._stalled_s
        ):
            self._stalled_s = None
        if in_step or self._stalled_s is None:  # a stall, too: the camera may have become slower
            self._spacings_s.append(spacing_s)
        if self._stalled_s is None:
            return ""
        stalled_s = arrived_s - self._stalled_s
        return f"frames stalled {stalled_s:.1f} s ago, and this one may be from then"
