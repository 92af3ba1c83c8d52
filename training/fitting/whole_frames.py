"""Decision values of whole frames, in their order: what a boundary that moves is found from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.extractors.textures import Extractor
from tokt.models.linear import moved, obstacle_score
from tokt.models.water import WaterPrior, WaterState
from tokt.training.datasets.changed_patches import ChangedPatches
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.evaluation.frame_scores import frame_table

Judge = Callable[[F64, I64], F64]
"""Decision values, shape (n, n_outputs), of some rows of a table of features."""


@dataclass(frozen=True)
class WholeFrames:
    """Features of all patches of a dataset's frames, and the dataset's own patches among them."""

    features: F64  # (n_frames * n_patches, dim): as `cached_features` has those of whole frames
    at: I64  # (n_frames, n_patches): their rows in it; frames as `frame_table` has them
    place: I64  # (n_frames,): as of `FrameTable`
    obstacle: tuple[bool, ...]  # for each class whether it is an obstacle
    frame: I64  # (n_rows,): the frame of each row of a table of patches
    cell: I64  # (n_rows,): its place in the grid
    gray: Bools  # (n_frames,): whether it has no colour
    gray_changes: ChangedPatches  # patches of changed frames without colour

    @classmethod
    def of(
        cls,
        dataset: DatasetVersion,
        features: F64,
        extractor: Extractor,
        changed: Sequence[ChangedPatches] = (),
    ) -> WholeFrames:
        """Lay out a dataset's frames.

        Parameters
        ----------
        dataset : DatasetVersion
        features : array of float64, shape (n_frames * n_patches, dim)
            What `cached_features` computed of its whole frames.
        extractor : Extractor
            Whose features they are.
        changed : sequence of ChangedPatches, optional
            Patches of changed frames that are learnt from as well.
        """
        table, grid, patches = frame_table(dataset), dataset.grid, dataset.patches
        cell = (patches.row * grid.cols + patches.col).to_numpy(np.int64)
        at = np.full((len(table), grid.n_patches), -1)
        at[table.of_patch, cell] = np.arange(len(patches))
        at[at < 0] = np.arange(len(patches), at.size)
        is_gray = partial(extractor.is_gray, of_4_bits=not dataset.pictured.all())
        gray, flags = is_gray(features[at[:, 0]]), dataset.obstacle_flags()
        changes = [_gray_part(one, is_gray) for one in changed]
        table_of_changes = ChangedPatches(
            np.concatenate([features[:0], *(one.features for one in changes)]),
            np.concatenate([np.zeros(0, np.int64), *(one.source for one in changes)]),
        )
        return cls(features, at, table.place, flags, table.of_patch, cell, gray, table_of_changes)

    def part(self, rows: I64) -> WholeFrames:
        """Of some rows of the table."""
        return replace(self, frame=self.frame[rows], cell=self.cell[rows])

    def values(self, judge: Judge) -> tuple[I64, F64]:
        """The table's frames, rising, and their decision values, (n, n_patches, n_outputs)."""
        frames = np.unique(self.frame)
        found = self.at[frames]
        return frames, judge(self.features, found.ravel()).reshape(*found.shape, -1)

    def moved(self, frames: I64, values: F64, prior: WaterPrior | None) -> F64:
        """Decision values of the table's patches, given `values`, less the boundary in their frame.

        Without a prior the boundary stays at 0.
        """
        at = np.searchsorted(frames, self.frame)
        own = values[at, self.cell]
        if prior is None:
            return np.asarray(own)
        scores = obstacle_score(values.reshape(-1, values.shape[2]), self.obstacle)
        state, boundary = WaterState(prior), np.zeros(len(frames))
        missed = np.diff(self.place[frames], prepend=self.place[frames[:1]] - 1) - 1
        for index, frame in enumerate(scores.reshape(values.shape[:2])):
            state.begin(int(missed[index]))
            boundary[index] = state.judge(frame, gray=bool(self.gray[frames[index]]))
        return moved(own, boundary[at][:, None], self.obstacle)


def _gray_part(changed: ChangedPatches, is_gray: Callable[[F64], Bools]) -> ChangedPatches:
    gray = is_gray(changed.features)
    return ChangedPatches(changed.features[gray], changed.source[gray])


def judged(
    judge: Judge, features: F64, rows: I64, whole: WholeFrames | None, prior: WaterPrior | None
) -> F64:
    """What a model says of some patches; with whole frames, frame by frame in their order."""
    if whole is None:
        return judge(features, rows)
    part = whole.part(rows)
    return part.moved(*part.values(judge), prior)
