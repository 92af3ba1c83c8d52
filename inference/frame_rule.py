"""The operating point's frame rule over one run: which patches of which frame become the mask."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..features.grid import Grid
from ..models.operating_point import FrameRule, FrameRuleState
from .verdict import OBSTACLE, STATUS_MEAN_THRESHOLD, UNKNOWN


def least_white(grid: Grid, height: int, width: int) -> int:
    """Patches it takes to bring a mask's mean over the thesis's limit.

    1, but in grids of more than 700 patches, where a single one is too little for a status.

    Parameters
    ----------
    grid : Grid
    height, width : int
        Of the resized frame, in pixels.
    """
    mean_of_one = 255.0 * math.prod(grid.patch_size(height, width)) / (height * width)
    return int(STATUS_MEAN_THRESHOLD // mean_of_one) + 1


@dataclass(frozen=True)
class Ruled:
    """What the rule makes of one frame.

    Parameters
    ----------
    patches : array of bool, shape (n_patches,), or None
        What is white in the mask: nothing where the frame is clear; None where the frames before
        are not known well enough to say.
    note : str
        Which frames the rule waits for or holds on to, in words; empty where this frame alone
        decides.
    """

    patches: NDArray[np.bool_] | None
    note: str = ""


class RuleRun:
    """One run's frames in their order.

    Parameters
    ----------
    rule : FrameRule
    """

    def __init__(self, rule: FrameRule) -> None:
        self.rule = rule
        self._state = FrameRuleState(rule)
        self._begun = 0

    def begin(self, missed: int) -> None:
        """The next frame, `missed` frames after the one before; not judged unless `judge` is."""
        self._state.skip(missed + self._begun)
        self._begun = 1

    def judge(
        self, scores: NDArray[np.float64], patches: NDArray[np.bool_], least_white: int
    ) -> Ruled:
        """Judge the frame that was begun.

        Parameters
        ----------
        scores : array of float64, shape (n_patches,)
            Its patches' obstacle scores.
        patches : array of bool, shape (n_patches,)
            Its obstacle patches.
        least_white : int
            Patches it takes to bring the mask's mean over the thesis's limit.
        """
        self._begun = 0
        status = self._state.add(scores, least_white)
        over = int(np.count_nonzero(scores > self.rule.margin))
        confirmed = self._state.confirmed
        if status == OBSTACLE:
            # What stayed for some frames is where it was, even if this frame does not show it.
            seen = bool(over) or not confirmed.any()
            return Ruled(patches | confirmed, "" if seen else self._words("holds", over))
        if status == UNKNOWN:
            return Ruled(None, self._words("waits, frames before are not known", over))
        nothing = np.zeros_like(patches)
        return Ruled(nothing, self._words("waits", over) if over else "")

    def _words(self, does: str, over: int) -> str:
        rule = self.rule
        return (
            f"frame rule {does}: {over} patches over the margin in this frame, "
            f"{int(self._state.confirmed.sum())} in {rule.hits} of the last {rule.window}, "
            f"{rule.least_patches} needed"
        )
