"""What the trend is followed on: means of texture and of disparity, and depths, by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...features.errors import FrameError
from ...inference.assemble import Stereo
from ...inference.calibration import StereoCalibration
from ...inference.disparity import DisparityDetector
from ...inference.followed import in_whole
from ...inference.sources import Frame
from ...inference.verdict import UNKNOWN, verdict_from_mask
from ..bench.thesis_way import GRID
from .curves import Curves
from .material import Material
from .trend_scores import Seen


def seen_by_patches(curves: Curves, name: str, frames: Sequence[int]) -> list[Seen]:
    """What a texture method's curve gave.

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
            found.append(Seen(number, None, False))
            continue
        whole = number in patches and _whole(patches[number])
        found.append(Seen(number, float(mean[number]), whole))
    return found


def _whole(patches: NDArray[np.bool_]) -> bool:
    """Whether the patches lie wholly in the picture, at any of the grid's sizes."""
    height, width = GRID.rows * 27, GRID.cols * 36
    return in_whole(verdict_from_mask(GRID.paint(patches, height, width), "texture"))


def _pair(material: Material, number: int) -> Frame:
    """A pair, without the pictures that cannot be read."""
    try:
        return Frame(number, float(number), material.left(number), material.right(number))
    except FrameError:
        return Frame(number, float(number), None, None)


def seen_by_stereo(
    material: Material, calibration: StereoCalibration, frames: Sequence[int]
) -> tuple[list[Seen], dict[int, float]]:
    """The runtime's own disparity over frames in their order.

    Returns
    -------
    seen : list of Seen
    depth_m : dict of int to float
        Median of the matched depths; nan where nothing was matched, or it could not be judged.
    """
    detector = DisparityDetector(calibration, GRID)
    blind_m = Stereo(calibration).blind_m
    seen, depth_m = [], {}
    for number in material.progress(frames, len(frames), "trend: stereo"):
        depth_m[number] = math.nan
        detection, matches = detector.observe(_pair(material, number))
        if detection.mask is None:
            seen.append(Seen(number, None, False))
            continue
        verdict = verdict_from_mask(detection.mask, "disparity", distance_m=detection.distance_m)
        seen.append(Seen(number, verdict.mean, in_whole(verdict, blind_m)))
        if matches is not None and matches.valid.any():
            depth_m[number] = float(np.median(detector.depth_m(matches)[matches.valid]))
    return seen, depth_m
