"""Obstacle patches said against obstacle patches that are there."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import U8, Bools
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.simulation.rendering.patch_labels import MIN_COVERAGE, coverage

Truth = NDArray[np.int8]
"""Of each patch of a frame, (n_patches,): 1 obstacle, 0 clear, -1 unsure or not labelled, which is
not scored."""


@dataclass(frozen=True)
class PatchScore:
    """Counts of patches, and the figures that follow from them; None where they are undefined.

    Hits are said and there, false ones said but not there, missed ones there but not said.
    """

    hits: int = 0
    false: int = 0
    missed: int = 0

    @property
    def precision(self) -> float | None:
        """Of the patches said, the share that is there."""
        return _share(self.hits, self.hits + self.false)

    @property
    def recall(self) -> float | None:
        """Of the patches there, the share that is said."""
        return _share(self.hits, self.hits + self.missed)

    @property
    def f1(self) -> float | None:
        """Harmonic mean of precision and recall."""
        return _share(2 * self.hits, 2 * self.hits + self.false + self.missed)


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def score_patches(said: Bools, truth: Truth) -> PatchScore:
    """Count the sure patches; `said` is bool, (n_patches,)."""
    sure = truth >= 0
    said, there = said[sure], truth[sure] == 1
    return PatchScore(*(int(one.sum()) for one in (said & there, said & ~there, ~said & there)))


def pooled_score(said: Mapping[int, Bools], truths: Mapping[int, Truth]) -> PatchScore:
    """Count the sure patches of the frames that both have."""
    both = [number for number in truths if number in said]
    if not both:
        return PatchScore()
    return score_patches(*(np.concatenate([part[n] for n in both]) for part in (said, truths)))


def truth_by_mask(mask: U8) -> Truth:
    """The truth of a frame's patches by a mask, under the rule of the mission's labels.

    The mask is of the frame as the camera gave it; 128 and above is the obstacle, and a patch is
    one from `MIN_COVERAGE` on. A patch that less of it touches is not scored.
    """
    covered = coverage(mask >= 128, GRID)
    return np.select([covered >= MIN_COVERAGE, covered == 0], [1, 0], -1).astype(np.int8)


def patches_of_mask(mask: U8) -> Bools:
    """The patches that a method says are an obstacle whose 0/255 mask is not made by patches.

    By the rule of the labels: `MIN_COVERAGE` of the patch is white.
    """
    return np.asarray(coverage(mask >= 128, GRID) >= MIN_COVERAGE)
