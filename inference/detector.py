"""Detectors: from a frame to a mask, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..features.grid import Grid
from .frame_check import frame_fault
from .sources import Frame

TEXTURE, DISPARITY = "texture", "disparity"


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
    """

    mask: NDArray[np.uint8] | None
    method: str
    model: str | None = None
    distance_m: float | None = None
    decision_values: NDArray[np.float64] | None = None
    fault: str = ""


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
    def model(self) -> PatchJudge:
        """Decides what a decision value means."""

    def decision_values(self, frame: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Decision values of a frame's patches, shape (n_patches, n_outputs)."""


class GridDetector:
    """Texture: every patch the model takes for an obstacle is white in the mask.

    Parameters
    ----------
    scorer : PatchScorer
    """

    method = TEXTURE

    def __init__(self, scorer: PatchScorer) -> None:
        self.scorer = scorer

    def detect(self, frame: Frame) -> Detection:
        """Judge the left picture."""
        label = self.scorer.label
        fault = frame.left_fault if frame.left is None else frame_fault(frame.left)
        if frame.left is None or fault:
            return Detection(None, TEXTURE, label, fault=fault or "there is no left frame")
        values = self.scorer.decision_values(frame.left)
        if not np.isfinite(values).all():
            fault = "the model gave a decision value that is not finite"
            return Detection(None, TEXTURE, label, fault=fault)
        obstacle = self.scorer.model.obstacle_patches(values)
        grid = self.scorer.grid
        mask = grid.paint(obstacle, *grid.resized(*frame.left.shape[:2]))
        return Detection(mask, TEXTURE, label, decision_values=values)
