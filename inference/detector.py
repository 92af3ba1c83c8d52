"""Detectors: from a frame to a mask, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..features.frame_pictures import FramePictures
from ..features.grid import Grid
from ..features.levels import Levels
from ..models.operating_point import OperatingPoint
from .frame_check import frame_fault, shape_fault
from .frame_rule import RuleRun, least_white
from .reason import NO_FAULT, Fault, Reason
from .sources import Frame

TEXTURE, DISPARITY, PUSHBROOM = "texture", "disparity", "pushbroom"

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
    against_clear : bool
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
    against_clear: bool = False
    note: str = ""


class Detector(Protocol):
    """Something that judges frames."""

    @property
    def method(self) -> str:
        """``"texture"``, ``"disparity"`` or ``"pushbroom"``."""

    def detect(self, frame: Frame) -> Detection:
        """Judge one frame; may raise, and is guarded for that by the policy that calls it."""


class PatchJudge(Protocol):
    """The part of a linear model that turns decision values into obstacles."""

    def obstacle_score(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far each row of decision values is on the obstacle side; above 0 where it is one."""

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

    @property
    def operating_point(self) -> OperatingPoint:
        """Decides what the patches of some frames come to."""

    @property
    def images(self) -> tuple[Levels | None, ...]:
        """The pictures of a frame that it looks at; None is the plain one."""

    def features(
        self, frame: NDArray[np.uint8], pictures: FramePictures | None = None, threads: int = 1
    ) -> NDArray[np.float64]:
        """Features of a frame's patches, shape (n_patches, dim).

        Parameters
        ----------
        frame : array of uint8, shape (height, width) or (height, width, 3)
        pictures : FramePictures, optional
            The frame's pictures on this grid, where the caller has some already.
        threads : int
            How many threads share the work; the features do not depend on it.
        """

    def values_of(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Decision values, shape (n_patches, n_outputs), of features of (n_patches, dim)."""


class GridDetector:
    """Texture: where the frame rule says obstacle, the model's obstacle patches are the mask.

    Elsewhere the mask is empty. It judges the frames of one run in their order: what it says of a
    frame can depend on those before.

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
        self._rule = RuleRun(scorer.operating_point.rule)

    def detect(self, frame: Frame) -> Detection:
        """Judge the left picture."""
        self._rule.begin(frame.missed)
        if frame.left is None:
            return self._unjudged(
                frame.left_fault or Fault(Reason.MISSING, "there is no left frame")
            )
        # First what needs no look at the pixels: a picture of another shape may have no resize.
        fault = shape_fault(frame.left) or self._size_fault(*frame.left.shape[:2])
        if fault:
            return self._unjudged(fault)
        grid = self.scorer.grid
        # Resized once, for the check and for the features: it costs as much as these.
        pictures = FramePictures(frame.left, grid, threads=self.threads)
        gray = pictures.gray(self.scorer.images)
        fault = frame_fault(frame.left, gray, grid)
        if fault:
            return self._unjudged(fault)
        features = self.scorer.features(frame.left, pictures, self.threads)
        values = self.scorer.values_of(features)
        if not np.isfinite(values).all():
            words = "the model gave a decision value that is not finite"
            return self._unjudged(Fault(Reason.NOT_FINITE, words))
        return replace(self._ruled(values, *gray.shape), features=features)

    def _ruled(self, values: NDArray[np.float64], height: int, width: int) -> Detection:
        """What the decision values of a frame resized to `height` x `width` come to."""
        grid, model = self.scorer.grid, self.scorer.model
        ruled = self._rule.judge(
            model.obstacle_score(values),
            model.obstacle_patches(values),
            least_white(grid, height, width),
        )
        label = self.scorer.label
        if ruled.patches is None:
            return Detection(
                None,
                TEXTURE,
                label,
                decision_values=values,
                fault=Fault(Reason.FRAME_RULE, ruled.note),
                against_clear=True,
            )
        mask = grid.paint(ruled.patches, height, width)
        return Detection(mask, TEXTURE, label, decision_values=values, note=ruled.note)

    def _unjudged(self, fault: Fault) -> Detection:
        return Detection(None, TEXTURE, self.scorer.label, fault=fault)

    def _size_fault(self, height: int, width: int) -> Fault:
        """Why a frame is unlike all that the model learnt from, or an empty string."""
        learnt = self.scorer.frame_sizes
        if any(self._alike(height, width, *size) for size in learnt):
            return NO_FAULT
        sizes = " or ".join(f"{w}x{h}" for h, w in learnt)
        words = f"frames are {width}x{height}, the model learnt from {sizes}"
        return Fault(Reason.WRONG_SIZE, words)

    def _alike(self, height: int, width: int, learnt_height: int, learnt_width: int) -> bool:
        aspect_ratio = (width * learnt_height) / (height * learnt_width)
        # Below the grid's width detail is made up; unless the model learnt from such frames.
        least_width = min(self.scorer.grid.width or 0, learnt_width)
        return (
            abs(aspect_ratio - 1) <= ASPECT_TOLERANCE
            and LEAST_WIDTH_RATIO <= width / learnt_width <= LARGEST_WIDTH_RATIO
            and width >= least_width
        )
