"""Left, centre and right of the disparity map: Kostavelis and others' rule for a ground robot.

As the method is known: the disparity map is cut into three windows side by side. In the centre
window the pixels whose disparity is above a threshold are counted; where they are at most a given
part of the window the way is free. Otherwise the side whose mean disparity is smaller, which is
the one with less in it or with what is farther away, is the way to go.

Ours, because the paper's text and its numbers are not at hand: the map is that of
`tokt.inference.stereo.disparity` (rectified, checked left to right), pixels without a match count
as disparity 0, the threshold is given as a distance, and the part as `BLOCKED`. A frame in which
the stereo detector itself cannot judge is unknown.

References
----------
I. Kostavelis, L. Nalpantidis and A. Gasteratos, *Real-time algorithm for obstacle avoidance using
a stereoscopic camera*, 3rd Panhellenic Scientific Student Conference on Informatics, 2009.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import Bools
from tokt.inference.frame import Frame
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.verdict import CLEAR, OBSTACLE, verdict_from_mask

from .baseline import NO_PICTURE, BaselineResult, not_judged
from .thesis_texture import GRID

NEAR_M = 6.0
"""A matched pixel nearer than this counts: ten seconds at 0.6 m/s."""
BLOCKED = 0.01
"""Part of the centre window that must be near: a lattice tower covers little of what it stands
in, and what is matched by chance is less."""


class Thirds:
    """Decide by the left, centre and right thirds of the disparity map."""

    name = "mean_disparity"

    def __init__(self, calibration: StereoCalibration) -> None:
        self._detector = DisparityDetector(calibration, GRID)

    def judge(self, frame: Frame) -> BaselineResult:
        """Judge one pair of a run, in their order."""
        if frame.left is None or frame.right is None:
            return not_judged(NO_PICTURE)
        # Without the frames missed before it, of which the method knows nothing.
        seen = self._detector.observe(Frame(frame.number, frame.t, frame.left, frame.right))
        if seen.detection.mask is None or seen.matches is None:
            return not_judged(seen.detection.fault)
        return self._decide(seen.matches, seen.detection.mask.shape)

    def _decide(self, matches: Matches, size: tuple[int, ...]) -> BaselineResult:
        rectifier = self._detector.rectifier
        disparity = np.where(matches.valid, matches.disparity_px, 0.0)
        near = disparity > rectifier.focal_baseline_px_m / NEAR_M
        centre = _mean_of_third(near, matches.searched, 1)
        left, right = (_mean_of_third(disparity, matches.searched, side) for side in (0, 2))
        mask = rectifier.to_left(near.astype(np.uint8) * 255, size[0], size[1])
        verdict = verdict_from_mask(mask, self.name)
        blocked = centre > BLOCKED
        turn = (1 if right < left else -1) * (size[1] // 3) if blocked else 0
        verdict = replace(verdict, status=OBSTACLE if blocked else CLEAR, x=turn, y=0)
        return BaselineResult(verdict, mask)


def _mean_of_third(values: NDArray[Any], searched: Bools, which: int) -> float:
    """Mean over what is searched of the left (0), centre (1) or right (2) third of the columns.

    The blind margin at the left, where nothing can be matched, would else make that side the free
    one every time.
    """
    columns = np.array_split(np.arange(values.shape[1]), 3)[which]
    seen = searched[:, columns]
    return float(values[:, columns][seen].mean()) if seen.any() else float("inf")
