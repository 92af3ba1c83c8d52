"""A stereo pair to its verdict: the thesis's disparity pipeline against tokt's block matching."""

from __future__ import annotations

import numpy as np

from tokt.features.kernels.dispatch import LIBRARY, load_kernels
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.matching import Matches
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD
from tokt.studies.baselines.thesis_texture import GRID

from .pair_case import PairCase
from .pairs import Pair


class StereoPair(PairCase):
    """A decoded pair to its detection, as ``tokt run --policy disparity`` does it.

    Parameters
    ----------
    calibration : StereoCalibration
        Its maps are made once, as in a run.
    """

    def __init__(self, calibration: StereoCalibration) -> None:
        super().__init__(
            "stereo.pair", "ours matches every pixel as it does with OpenCV's own StereoBM"
        )
        self._detector = DisparityDetector(calibration, GRID)
        self._library = DisparityDetector(calibration, GRID, kernels=load_kernels(LIBRARY))

    def ours(self, item: Pair) -> object:
        """Rectify, match, filter, distance."""
        return self._detector.detect(item.frame)

    def sees_obstacle(self, item: Pair) -> bool | None:
        """Whether ours says obstacle; None where it refuses to judge."""
        mask = self._detector.detect(item.frame).mask
        return None if mask is None else bool(np.mean(mask) > STATUS_MEAN_THRESHOLD)

    def check(self, item: Pair) -> bool:
        """The matches of every pixel with tokt's kernels and with OpenCV's own block matching."""
        seen = self.sees_obstacle(item)
        if seen is None:
            return self.refused()
        ours, theirs = (
            detector.match(item.left, item.right) for detector in (self._detector, self._library)
        )
        return self.compared(item, not _same(ours, theirs), seen)


def _same(one: Matches, other: Matches) -> bool:
    """Whether the same pixels were matched, with the same disparities."""
    valid = one.valid
    return np.array_equal(valid, other.valid) and np.array_equal(
        one.disparity_px[valid], other.disparity_px[valid]
    )
