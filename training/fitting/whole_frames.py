"""Decision values of whole frames, in their order: what a boundary that moves is found from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.pipeline import Pipeline

from tokt.features.common.arrays import F64, I64
from tokt.models.linear import moved, obstacle_score
from tokt.models.water import WaterPrior, WaterState
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.evaluation.frame_scores import frame_table

from .classifier import decision_values


@dataclass(frozen=True)
class WholeFrames:
    """Features of all patches of a dataset's frames, labelled or not, and the dataset's among them.

    Parameters
    ----------
    features : array of float64, shape (n_frames, n_patches, dim)
        Frames as `frame_table` has them: by mission, camera and number.
    place : array of int, shape (n_frames,)
        As of `FrameTable`.
    obstacle : tuple of bool
        For each class whether it is an obstacle.
    frame, cell : array of int, shape (n_rows,)
        Of each row of a table of patches: its frame, and its place in the grid.
    """

    features: F64
    place: I64
    obstacle: tuple[bool, ...]
    frame: I64
    cell: I64

    @classmethod
    def of(
        cls,
        dataset: DatasetVersion,
        spec: dict[str, Any],
        cache: Path,
        progress: Callable[..., Any],
        jobs: int = -1,
        dask: str | None = None,
        augmentation: str = "",
    ) -> WholeFrames:
        """Compute them; the parameters are those of `cached_features`."""
        features = cached_features(
            dataset, spec, cache, progress, jobs, dask, augmentation, whole_frames=True
        )
        table, grid, patches = frame_table(dataset), dataset.grid, dataset.patches
        return cls(
            features.reshape(len(table), grid.n_patches, -1),
            table.place,
            dataset.obstacle_flags(),
            table.of_patch,
            (patches.row * grid.cols + patches.col).to_numpy(np.int64),
        )

    @property
    def rows(self) -> F64:
        """Features of the table's patches, shape (n_rows, dim)."""
        return np.asarray(self.features[self.frame, self.cell])

    def part(self, rows: I64) -> WholeFrames:
        """Of some rows of the table."""
        return replace(self, frame=self.frame[rows], cell=self.cell[rows])

    def values(self, pipeline: Pipeline) -> tuple[I64, F64]:
        """The frames of the table's patches, rising, and all their patches' decision values.

        Returns
        -------
        array of int, shape (n,), and array of float64, shape (n, n_patches, n_outputs)
        """
        frames = np.unique(self.frame)
        found = self.features[frames]
        values = decision_values(pipeline, found.reshape(-1, found.shape[2]))
        return frames, values.reshape(*found.shape[:2], -1)

    def moved(self, frames: I64, values: F64, prior: WaterPrior | None) -> F64:
        """Decision values of the table's patches, less the boundary in their frame.

        Parameters
        ----------
        frames, values
            As from `values`, of all frames that the table has patches of.
        prior : WaterPrior or None
            None for a boundary that stays at 0.

        Returns
        -------
        numpy.ndarray
            float64, shape (n_rows, n_outputs).
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
            boundary[index] = state.judge(frame)
        return moved(own, boundary[at][:, None], self.obstacle)

    def judged(self, pipeline: Pipeline, prior: WaterPrior | None) -> F64:
        """What a model says of the table's patches, frame by frame in their order."""
        return self.moved(*self.values(pipeline), prior)
