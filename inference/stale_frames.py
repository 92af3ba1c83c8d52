"""Frames that may be older than they look: after a suspend of the computer."""

import math
from dataclasses import replace
from typing import Any

from .clock import Clock
from .config import Limits
from .frame import MANY_MISSED, Frame
from .reason import Fault, Reason

_SUSPENDED_S = 0.05


class SuspendDetector:
    """Remove the pictures of frames that may be older than they look: after a suspend.

    What was in a camera's or its driver's buffers when the computer was suspended is handed over
    afterwards as if it were new. From the first frame on that comes then, nothing is believed for
    as long as a frame may be old.
    """

    def __init__(self, clock: Clock, limits: Limits) -> None:
        self._clock = clock
        self._limits = limits
        self._suspended_s = clock.suspended()
        self._believed_from = -math.inf

    def remove(self, frame: Frame) -> Frame:
        """The same frame; without its pictures, and none before it known, where it is in doubt."""
        suspended_s = self._clock.suspended()
        if suspended_s - self._suspended_s > _SUSPENDED_S:
            self._suspended_s = suspended_s
            self._believed_from = self._clock.monotonic() + self._limits.stale_s
        if frame.arrived is None or frame.arrived >= self._believed_from:
            return frame
        fault = Fault(Reason.STALE, "stale: the computer was suspended just before this frame")
        doubtful: dict[str, Any] = {"missed": MANY_MISSED}
        for side in ("left", "right"):
            if getattr(frame, side) is not None:
                doubtful |= {side: None, f"{side}_fault": fault}
        return replace(frame, **doubtful)
