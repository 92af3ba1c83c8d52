"""The base of both stereo cases: the thesis's pipeline as the baseline, and the counts."""

from __future__ import annotations

from typing import Any

from tokt.studies.baselines.thesis_stereo import judge_pair
from tokt.studies.speed.cases import Case

from .pairs import Pair


class PairCase(Case[Pair]):
    """A decoded pair to its detection, by the thesis's disparity pipeline and by a detector.

    Parameters
    ----------
    name : str
    exact_is : str
        What `check` holds ours against; of the thesis's pipeline nothing could be.
    """

    def __init__(self, name: str, exact_is: str) -> None:
        super().__init__(name)
        self._exact_is = exact_is
        self._found = dict.fromkeys(("pairs_checked", "pairs_different", "pairs_refused"), 0)
        self._obstacles = {"baseline": 0, "ours": 0}

    def baseline(self, item: Pair) -> object:
        """Undistort, match, stretch, contours."""
        return judge_pair(item.left, item.right)

    def refused(self) -> bool:
        """Count a pair that ours refuses to judge: False, as `check` says it."""
        self._found["pairs_refused"] += 1
        return False

    def compared(self, item: Pair, different: bool, obstacle: bool) -> bool:
        """Count a pair, and whether either way sees an obstacle: True, as `check` says it."""
        self._found["pairs_checked"] += 1
        self._found["pairs_different"] += different
        self._obstacles["ours"] += obstacle
        self._obstacles["baseline"] += judge_pair(item.left, item.right).obstacle
        return True

    @property
    def exact(self) -> bool:
        """Whether every pair was as `exact_is` says, and there was one."""
        return self._found["pairs_checked"] > 0 and self._found["pairs_different"] == 0

    def findings(self) -> dict[str, Any]:
        """What was compared."""
        return {
            "of": "one decoded pair to its verdict",
            "baseline_is": "the thesis's disparity pipeline: full resolution, not rectified",
            "exact_is": self._exact_is,
            "obstacle_pairs": dict(self._obstacles),
            **self._found,
        }
