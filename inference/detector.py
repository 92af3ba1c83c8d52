"""The detectors' contract: from a frame to a mask, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .frame import Frame
from .reason import NO_FAULT, Fault

TEXTURE, DISPARITY, PUSHBROOM = "texture", "disparity", "pushbroom"


@dataclass(frozen=True)
class Detection:
    """One detector's answer on one frame: a mask, or why there is none.

    Parameters
    ----------
    mask : array of uint8, shape (height, width), or None
        Of the left frame resized to the grid's width; 255 where an obstacle was seen. None when
        the detector could not judge the frame.
    method : str
    model : str or None
        ``name/version`` of the model used, if there is one.
    distance_m : float or None
        Distance in metres to the nearest part, if the detector measures it.
    closing_m_s : float or None
        Metres a second by which the distance falls, negative where it grows, if the detector
        measures it.
    contact_s : float or None
        Seconds until the distance is 0 at that speed, if it falls.
    decision_values : array of float64, shape (n_patches, n_outputs), or None
    features : array of float64, shape (n_patches, dim), or None
        What the decision values come from.
    fault : Fault
        Why the frame could not be judged; empty when it was.
    vetoes_clear : bool
        Whether the fault is itself a sign that something may be there, such as two views that do
        not fit together, and not merely the lack of a picture or of a detector. No other
        detector's *clear* stands against it.
    note : str
        What else the pilot should know about a frame that was judged.
    """

    mask: NDArray[np.uint8] | None
    method: str
    model: str | None = None
    distance_m: float | None = None
    closing_m_s: float | None = None
    contact_s: float | None = None
    decision_values: NDArray[np.float64] | None = None
    features: NDArray[np.float64] | None = None
    fault: Fault = NO_FAULT
    vetoes_clear: bool = False
    note: str = ""


class Detector(Protocol):
    """Something that judges frames."""

    @property
    def method(self) -> str:
        """``"texture"``, ``"disparity"`` or ``"pushbroom"``."""

    def detect(self, frame: Frame) -> Detection:
        """Judge one frame; may raise, and is guarded for that by the policy that calls it."""
