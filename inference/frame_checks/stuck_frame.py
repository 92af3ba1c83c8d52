"""A check for stuck frames: a camera that repeats its last picture exactly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason

_STEP_ROWS = 32


@dataclass
class _Camera:
    """The last picture of one camera, when it came first, and how often since."""

    picture: NDArray[np.uint8] | None = None
    since: float | None = None
    repeats: int = 0

    def fault(self, side: str, picture: NDArray[np.uint8], frame: Frame, limits: Limits) -> Fault:
        """What is wrong with the next picture, if it is the same for too often or too long."""
        if self.picture is None or not _same(self.picture, picture):
            self.picture, self.since, self.repeats = picture, frame.arrived, 0
            return NO_FAULT
        self.repeats += 1
        age_s = 0.0
        if frame.timed and frame.arrived is not None and self.since is not None:
            age_s = frame.arrived - self.since
        if self.repeats <= limits.frozen_repeats and age_s <= limits.stale_s:
            return NO_FAULT
        words = f"the {side} camera repeats its last picture, {self.repeats} times: frozen"
        return Fault(Reason.FROZEN, words)


class StuckFrameDetector:
    """Remove the pictures that a camera repeats, so that no detector judges them.

    Parameters
    ----------
    limits : Limits
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._left = _Camera()
        self._right = _Camera()

    def remove(self, frame: Frame) -> Frame:
        """The same frame, without a picture where a camera has frozen.

        Parameters
        ----------
        frame : Frame
            The next one of the run; its pictures are kept until others come.
        """
        if frame.left is not None:
            fault = self._left.fault("left", frame.left, frame, self._limits)
            if fault:
                frame = replace(frame, left=None, left_fault=fault)
        if frame.right is not None:
            fault = self._right.fault("right", frame.right, frame, self._limits)
            if fault:
                frame = replace(frame, right=None, right_fault=fault)
        return frame


def _same(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    # Some rows first: they differ in any two frames of a live camera.
    return np.array_equal(one[::_STEP_ROWS], other[::_STEP_ROWS]) and np.array_equal(one, other)
