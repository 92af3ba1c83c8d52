"""A stereo pair to its verdict: the thesis's disparity pipeline against tokt's block matching."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...features.kernels import LIBRARY, load_kernels
from ...inference.calibration import StereoCalibration
from ...inference.disparity import DisparityDetector
from ...inference.matching import Matches
from ...inference.verdict import STATUS_MEAN_THRESHOLD
from .cases import Case
from .pairs import Pair
from .thesis_stereo import judge_pair
from .thesis_way import GRID

PAIR_WORK = "one decoded pair to its verdict"
THESIS_PIPELINE = "the thesis's disparity pipeline: full resolution, not rectified"


class StereoPair(Case[Pair]):
    """A decoded pair to its detection, as ``tokt run --policy disparity`` does it.

    Parameters
    ----------
    calibration : StereoCalibration
        Its maps are made once, as in a run.
    """

    def __init__(self, calibration: StereoCalibration) -> None:
        super().__init__("stereo.pair")
        self._detector = DisparityDetector(calibration, GRID)
        self._library = DisparityDetector(calibration, GRID, kernels=load_kernels(LIBRARY))
        self._found = dict.fromkeys(("pairs_checked", "pairs_different", "pairs_refused"), 0)
        self._obstacles = {"baseline": 0, "ours": 0}

    def baseline(self, item: Pair) -> object:
        """Undistort, match, stretch, contours."""
        return judge_pair(item.left, item.right)

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
            self._found["pairs_refused"] += 1
            return False
        ours, theirs = (
            detector.match(item.left, item.right) for detector in (self._detector, self._library)
        )
        self._found["pairs_checked"] += 1
        self._found["pairs_different"] += not _same(ours, theirs)
        self._obstacles["ours"] += seen
        self._obstacles["baseline"] += judge_pair(item.left, item.right).obstacle
        return True

    @property
    def exact(self) -> bool:
        """Whether all matches were the same; of the thesis's pipeline nothing could be."""
        return self._found["pairs_checked"] > 0 and self._found["pairs_different"] == 0

    def findings(self) -> dict[str, Any]:
        """What was compared."""
        return {
            "of": PAIR_WORK,
            "baseline_is": THESIS_PIPELINE,
            "exact_is": "ours matches every pixel as it does with OpenCV's own StereoBM",
            "obstacle_pairs": dict(self._obstacles),
            **self._found,
        }


def _same(one: Matches, other: Matches) -> bool:
    """Whether the same pixels were matched, with the same disparities."""
    valid = one.valid
    return np.array_equal(valid, other.valid) and np.array_equal(
        one.disparity_px[valid], other.disparity_px[valid]
    )
