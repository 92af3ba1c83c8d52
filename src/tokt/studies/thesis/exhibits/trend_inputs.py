"""Inputs of the trend: means of texture and of disparity, and depths, by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import FrameError
from tokt.inference.frame import Frame
from tokt.inference.policy.assembly import StereoSetup
from tokt.inference.policy.temporal_cues import wholly_in_view
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import UNKNOWN, verdict_from_mask
from tokt.studies.baselines.thesis_texture import GRID
from tokt.studies.thesis.context import StudyContext
from tokt.studies.thesis.methods.curves import Curves
from tokt.studies.thesis.methods.trend_scores import FrameMean


def means_of_patches(curves: Curves, name: str, frames: Sequence[int]) -> list[FrameMean]:
    """Means of a texture method's curve, frame by frame.

    Parameters
    ----------
    curves : Curves
    name : str
        One of its patches.
    frames : sequence of int
        Those that it did not judge have no mean.
    """
    mean, status, patches = curves.mean[name], curves.status[name], curves.patches[name]
    found = []
    for number in frames:
        known = number in mean.index and status[number] != UNKNOWN
        if not known or not np.isfinite(mean[number]):
            found.append(FrameMean(number, None, False))
            continue
        whole = number in patches and _whole(patches[number])
        found.append(FrameMean(number, float(mean[number]), whole))
    return found


def _whole(patches: NDArray[np.bool_]) -> bool:
    """Whether the patches lie wholly in the picture, at any of the grid's sizes."""
    height, width = GRID.rows * 27, GRID.cols * 36
    return wholly_in_view(verdict_from_mask(GRID.paint(patches, height, width), "texture"))


def _pair(context: StudyContext, number: int) -> Frame:
    """A pair, without the pictures that cannot be read."""
    try:
        return Frame(number, float(number), context.left(number), context.right(number))
    except FrameError:
        return Frame(number, float(number), None, None)


def means_of_stereo(
    context: StudyContext, calibration: StereoCalibration, frames: Sequence[int]
) -> tuple[list[FrameMean], dict[int, float]]:
    """The runtime's own disparity over frames in their order.

    Returns
    -------
    seen : list of FrameMean
    depth_m : dict of int to float
        Median of the matched depths; nan where nothing was matched, or it could not be judged.
    """
    detector = DisparityDetector(calibration, GRID)
    blind_m = StereoSetup(calibration).blind_m
    seen, depth_m = [], {}
    for number in context.progress(frames, len(frames), "trend: stereo"):
        depth_m[number] = math.nan
        detection, matches = detector.observe(_pair(context, number))
        if detection.mask is None:
            seen.append(FrameMean(number, None, False))
            continue
        verdict = verdict_from_mask(detection.mask, "disparity", distance_m=detection.distance_m)
        seen.append(FrameMean(number, verdict.mean, wholly_in_view(verdict, blind_m)))
        if matches is not None and matches.valid.any():
            depth_m[number] = float(np.median(detector.depth_m(matches)[matches.valid]))
    return seen, depth_m
