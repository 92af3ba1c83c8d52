"""Left, centre and right of the disparity map: Kostavelis and others' rule for a ground robot.

As the thesis tells it: the means of the disparity map's left, centre and right window; what is
dominant there is the obstacle, and the exit is to the side of the smaller mean.

Ours, because that is all it tells: the map is that of `tokt.inference.stereo.disparity`
(rectified, checked left to right), a pixel without a match counts as disparity 0, and the way is
barred where the centre's mean is the largest, and above `MIN_MEAN_PX`. A frame in which the stereo
detector itself cannot judge is unknown.

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
from tokt.inference.policy.policy import Judgement
from tokt.inference.reason import Fault, Reason
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, unknown_verdict, verdict_from_mask

from .thesis_texture import GRID

NO_PICTURE = unknown_verdict(Fault(Reason.MISSING, "a picture of it cannot be read"))
MIN_MEAN_PX = 0.5
"""Mean disparity below which a few matches by chance are all that there is."""


class Thirds:
    """Decide by the left, centre and right thirds of the disparity map."""

    name = "mean_disparity"

    def __init__(self, calibration: StereoCalibration) -> None:
        self._detector = DisparityDetector(calibration, GRID)

    def judge(self, frame: Frame) -> Judgement:
        """Judge one pair of a run, in their order."""
        if frame.left is None or frame.right is None:
            return Judgement(NO_PICTURE)
        # Without the frames missed before it, of which the method knows nothing.
        seen = self._detector.observe(Frame(frame.number, frame.t, frame.left, frame.right))
        matches = seen.matches
        if seen.detection.mask is None or matches is None:
            return Judgement(unknown_verdict(seen.detection.fault))
        height, width = seen.detection.mask.shape
        disparity = np.where(matches.valid, matches.disparity_px, 0.0)
        left, centre, right = (_mean_of_third(disparity, matches.searched, i) for i in range(3))
        matched = matches.valid.astype(np.uint8) * 255
        mask = self._detector.rectifier.to_left(matched, height, width)
        barred = centre > MIN_MEAN_PX and centre >= max(left, right)
        turn = (1 if right < left else -1) * (width // 3) if barred else 0
        verdict = verdict_from_mask(mask, self.name)
        verdict = replace(verdict, status=OBSTACLE if barred else CLEAR, x=turn, y=0)
        return Judgement(verdict, mask=mask)


def _mean_of_third(values: NDArray[Any], searched: Bools, which: int) -> float:
    """Mean over what is searched of the left (0), centre (1) or right (2) third of the columns.

    The blind margin at the left, where nothing can be matched, would else make that side the free
    one every time.
    """
    columns = np.array_split(np.arange(values.shape[1]), 3)[which]
    seen = searched[:, columns]
    return float(values[:, columns][seen].mean()) if seen.any() else 0.0
