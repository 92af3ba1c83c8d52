"""Detectors: from a frame to a mask, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..features.extractor import gray_picture
from ..features.grid import Grid
from .frame_check import frame_fault, shape_fault
from .sources import Frame

TEXTURE, DISPARITY = "texture", "disparity"

# What a frame may differ from those a model learnt from. Set here: LBP radii and windows are in
# pixels of the resized frame, and what is in it changes with the field of view and with how
# much detail the camera gave.
ASPECT_TOLERANCE = 0.02
"""Relative difference of width over height: one row more or less is a crop, more another camera."""
LEAST_WIDTH_RATIO, LARGEST_WIDTH_RATIO = 0.75, 1.33
"""Width over the training frames' width: a sensor's binning or a half-size stream is outside."""


@dataclass(frozen=True)
class Detection:
    """What one detector found in one frame.

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
    decision_values : array of float64, shape (n_patches, n_outputs), or None
    fault : str
        Why the frame could not be judged; empty when it was.
    against_clear : bool
        Whether the fault is itself a sign that something may be there, such as two views that do
        not fit together, and not merely the lack of a picture or of a detector. No other
        detector's *clear* stands against it.
    """

    mask: NDArray[np.uint8] | None
    method: str
    model: str | None = None
    distance_m: float | None = None
    decision_values: NDArray[np.float64] | None = None
    fault: str = ""
    against_clear: bool = False


class Detector(Protocol):
    """Something that judges frames."""

    @property
    def method(self) -> str:
        """``"texture"`` or ``"disparity"``."""

    def detect(self, frame: Frame) -> Detection:
        """Judge one frame; may raise, and is guarded for that by the policy that calls it."""


class PatchJudge(Protocol):
    """The part of a linear model that turns decision values into obstacles."""

    def obstacle_patches(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """For each row of decision values whether that patch is an obstacle."""


class PatchScorer(Protocol):
    """What the grid detector needs of a bundle (`tokt.models.bundle.Bundle` is one)."""

    @property
    def label(self) -> str:
        """``name/version``."""

    @property
    def grid(self) -> Grid:
        """The grid of patches."""

    @property
    def frame_sizes(self) -> tuple[tuple[int, int], ...]:
        """Height and width in pixels of frames like those it learnt from."""

    @property
    def model(self) -> PatchJudge:
        """Decides what a decision value means."""

    def decision_values(
        self, frame: NDArray[np.uint8], gray: NDArray[np.uint8] | None = None, threads: int = 1
    ) -> NDArray[np.float64]:
        """Decision values of a frame's patches, shape (n_patches, n_outputs).

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
        gray : array of uint8, shape (height, width), optional
            ``gray_picture(frame, grid)``, where the caller has it already.
        threads : int
            How many threads share the work; the values do not depend on it.
        """


class GridDetector:
    """Texture: every patch the model takes for an obstacle is white in the mask.

    Parameters
    ----------
    scorer : PatchScorer
    threads : int
        How many threads share one frame's rows of patches; the verdict does not depend on it.
    """

    method = TEXTURE

    def __init__(self, scorer: PatchScorer, threads: int = 1) -> None:
        self.scorer = scorer
        self.threads = threads

    def detect(self, frame: Frame) -> Detection:
        """Judge the left picture."""
        if frame.left is None:
            return self._unjudged(frame.left_fault or "there is no left frame")
        # First what needs no look at the pixels: a picture of another shape may have no resize.
        fault = shape_fault(frame.left) or self._size_fault(*frame.left.shape[:2])
        if fault:
            return self._unjudged(fault)
        grid = self.scorer.grid
        # Resized once, for the check and for the features: it costs as much as these.
        gray = gray_picture(frame.left, grid, self.threads)
        fault = frame_fault(frame.left, gray, grid)
        if fault:
            return self._unjudged(fault)
        values = self.scorer.decision_values(frame.left, gray=gray, threads=self.threads)
        if not np.isfinite(values).all():
            return self._unjudged("the model gave a decision value that is not finite")
        mask = grid.paint(self.scorer.model.obstacle_patches(values), *gray.shape)
        return Detection(mask, TEXTURE, self.scorer.label, decision_values=values)

    def _unjudged(self, fault: str) -> Detection:
        return Detection(None, TEXTURE, self.scorer.label, fault=fault)

    def _size_fault(self, height: int, width: int) -> str:
        """Why a frame is unlike all that the model learnt from, or an empty string."""
        learnt = self.scorer.frame_sizes
        if any(self._alike(height, width, *size) for size in learnt):
            return ""
        sizes = " or ".join(f"{w}x{h}" for h, w in learnt)
        return f"frames are {width}x{height}, the model learnt from {sizes}"

    def _alike(self, height: int, width: int, learnt_height: int, learnt_width: int) -> bool:
        aspect_ratio = (width * learnt_height) / (height * learnt_width)
        # Below the grid's width detail is made up; unless the model learnt from such frames.
        least_width = min(self.scorer.grid.width or 0, learnt_width)
        return (
            abs(aspect_ratio - 1) <= ASPECT_TOLERANCE
            and LEAST_WIDTH_RATIO <= width / learnt_width <= LARGEST_WIDTH_RATIO
            and width >= least_width
        )
