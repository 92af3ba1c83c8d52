"""Robustness of a model: its figures on augmented frames that it did not learn from."""

from __future__ import annotations

from typing import Any

import numpy as np

from tokt.models.linear import LinearModel
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.evaluation.frame_figures import frame_figures
from tokt.training.evaluation.metrics import obstacle_metrics

from .cross_validation import HeldOutPredictions


def robustness_figures(
    dataset: DatasetVersion,
    held_out: HeldOutPredictions,
    model: LinearModel,
    learnt: tuple[str, ...],
) -> dict[str, Any]:
    """Figures on augmented frames beside those on the frames as they are.

    Each fold's model scores the augmented frames of its test part.

    Parameters
    ----------
    dataset : DatasetVersion
    held_out : HeldOutPredictions
        With `stressed`.
    model : LinearModel
        Says what decision values mean.
    learnt : tuple of str
        The augmentations that the models learnt from, on other frames.

    Returns
    -------
    dict
        By augmentation: f1, fall (of F1, against the frames as they are), false_status,
        ocean_frames, detected, obstacle_frames (at the folds' rules), and learnt.
    """
    tested = held_out.fold >= 0
    truth = np.asarray(model.obstacle, bool)[dataset.targets()[tested]]
    plain = obstacle_metrics(truth, model.obstacle_score(held_out.values[tested]))["f1"]
    found = {}
    for name, values in held_out.stressed.items():
        score = model.obstacle_score(values)
        f1 = obstacle_metrics(truth, score[tested])["f1"]
        frames = frame_figures(dataset, score, held_out.fold, held_out.rules)
        found[name] = {
            "f1": f1,
            "fall": None if f1 is None or plain is None else plain - f1,
            **{key: frames[key] for key in _COUNTS},
            "learnt": name in learnt,
        }
    return found


_COUNTS = ("false_status", "ocean_frames", "detected", "obstacle_frames")
