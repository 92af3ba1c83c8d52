"""Checks of a dataset before training: what cannot be learnt from or tested is refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.splits import blocked_folds


def check_blocks(dataset: DatasetVersion, n_folds: int, embargo_frames: int) -> None:
    """Raise ToktError unless the dataset can be cross-validated, choices inside each fold too."""
    patches, targets = dataset.patches, dataset.targets()
    for fold in blocked_folds(patches, targets, n_folds, embargo_frames):
        part = patches.iloc[fold.train]
        blocked_folds(part, targets[fold.train], inner_folds(n_folds), embargo_frames)


def inner_folds(n_folds: int) -> int:
    """Folds of the cross-validation inside the training part of one of `n_folds` folds."""
    return max(2, n_folds - 1)


def check_features(dataset: DatasetVersion, features: NDArray[np.float64]) -> None:
    """Raise ToktError unless there is something to learn from in the features.

    A feature that is the same everywhere is harmless; the scaler leaves it at 0.

    Parameters
    ----------
    dataset : DatasetVersion
    features : array of float64, shape (n_patches, dim)
    """
    sound = np.isfinite(features).all(axis=1)
    if not sound.all():
        mission, camera, frame, row, col = dataset.patches.iloc[int(np.argmin(sound))][
            ["mission", "camera", "frame", "row", "col"]
        ]
        raise ToktError(
            f"dataset {dataset.label}: the extractor gives {int((~sound).sum())} patches a feature "
            f"that is not a finite number; the first is mission {mission}, {camera} frame {frame}, "
            f"row {row}, col {col}"
        )
    if not np.ptp(features, axis=0).any():
        raise ToktError(
            f"dataset {dataset.label}: all patches have the same features, so nothing can be "
            "learnt; are its frames blank?"
        )
