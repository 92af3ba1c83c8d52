"""Cross-validation over blocks of frames, with every choice made inside the training part."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..features.mission import format_frames
from ..inference.verdict import STATUS_MEAN_THRESHOLD
from ..models.linear import LinearModel
from .classifier import decision_values, fit_classifier
from .dataset import DatasetVersion
from .metrics import class_metrics, obstacle_metrics
from .presets import TrainingSettings
from .splits import Fold, blocked_folds


@dataclass(frozen=True)
class Split:
    """How a dataset is split.

    Parameters
    ----------
    folds, embargo_frames : int
        Of the outer cross-validation; the inner one has one fold less, the same embargo.
    """

    folds: int
    embargo_frames: int


@dataclass(frozen=True)
class HeldOut:
    """Decision values of patches by models that did not learn from them.

    Parameters
    ----------
    values : array of float64, shape (n_patches, n_outputs)
    fold : array of int, shape (n_patches,)
        The fold in which a patch was tested; -1 for none.
    penalties : tuple of float
        The C of each fold.
    """

    values: NDArray[np.float64]
    fold: NDArray[np.int64]
    penalties: tuple[float, ...]


def choose_penalty(
    patches: pd.DataFrame,
    features: NDArray[np.float64],
    targets: NDArray[np.int64],
    settings: TrainingSettings,
    split: Split,
) -> float:
    """The candidate C with the best pooled F1 (macro-F1 for several classes) in a blocked CV.

    The smaller C wins a tie. With one candidate nothing is measured.
    """
    if len(settings.penalties) == 1:
        return settings.penalties[0]
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    scores = []
    for penalty in settings.penalties:
        predicted = np.empty_like(targets)
        for fold in folds:
            model = fit_classifier(features[fold.train], targets[fold.train], penalty, settings)
            predicted[fold.test] = model.predict(features[fold.test])
        scores.append(_f1(targets, predicted))
    return settings.penalties[int(np.argmax(scores))]


def _f1(targets: NDArray[np.int64], predicted: NDArray[np.int64]) -> float:
    if targets.max() <= 1:
        return float(
            obstacle_metrics(targets == 1, np.asarray(predicted - 0.5, np.float64))["f1"] or 0.0
        )
    names = tuple(str(index) for index in range(int(targets.max()) + 1))
    return float(class_metrics(targets, predicted, names)["macro_f1"] or 0.0)


def cross_validate(
    dataset: DatasetVersion,
    features: NDArray[np.float64],
    settings: TrainingSettings,
    split: Split,
    progress: Callable[..., Any],
) -> HeldOut:
    """Nested cross-validation: C is chosen anew inside the training part of each fold.

    Raises
    ------
    ToktError
        If the dataset has too few groups; see `blocked_folds`.
    """
    patches, targets = dataset.patches, dataset.targets()
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    inner = Split(max(2, split.folds - 1), split.embargo_frames)
    outputs = 1 if len(dataset.classes()) == 2 else len(dataset.classes())
    values = np.full((len(targets), outputs), np.nan)
    number = np.full(len(targets), -1)
    penalties = []
    features = np.asarray(features)
    for index, fold in enumerate(progress(folds, len(folds), "cross-validation")):
        penalty = _inner_choice(patches, features, targets, fold, settings, inner)
        model = fit_classifier(features[fold.train], targets[fold.train], penalty, settings)
        values[fold.test] = decision_values(model, features[fold.test])
        number[fold.test] = index
        penalties.append(penalty)
    return HeldOut(values, number, tuple(penalties))


def _inner_choice(
    patches: pd.DataFrame,
    features: NDArray[np.float64],
    targets: NDArray[np.int64],
    fold: Fold,
    settings: TrainingSettings,
    inner: Split,
) -> float:
    part = patches.iloc[fold.train]
    return choose_penalty(part, features[fold.train], targets[fold.train], settings, inner)


def ocean_frame_statuses(
    dataset: DatasetVersion, said_obstacle: NDArray[np.bool_], tested: NDArray[np.bool_]
) -> dict[str, Any]:
    """False statuses on frames whose every patch is labelled clear and was tested.

    Parameters
    ----------
    dataset : DatasetVersion
    said_obstacle, tested : arrays of bool, shape (n_patches,)

    Returns
    -------
    dict
        ocean_frames, false_status (counts), false_status_frames (``mission:frame``).
    """
    keys = ["mission", "camera", "frame"]
    grid = dataset.grid
    table = dataset.patches[keys].copy()
    table["clear"] = ~np.asarray(dataset.obstacle_flags(), bool)[dataset.targets()]
    table["tested"], table["said"] = tested, said_obstacle
    frames = table.groupby(keys).agg(
        n=("clear", "size"), clear=("clear", "all"), tested=("tested", "all"), said=("said", "sum")
    )
    ocean = frames[(frames.n == grid.n_patches) & frames.clear & frames.tested]
    sizes = dataset.frames.set_index(keys).loc[ocean.index, ["height", "width"]]
    means = []
    for said, height, width in zip(ocean.said, sizes.height, sizes.width, strict=True):
        resized = grid.resized(height, width)
        means.append(255.0 * said * math.prod(grid.patch_size(*resized)) / math.prod(resized))
    false = ocean[np.asarray(means) > STATUS_MEAN_THRESHOLD]
    return {
        "ocean_frames": len(ocean),
        "false_status": len(false),
        "false_status_frames": [f"{mission}:{frame}" for mission, _, frame in false.index],
    }


def held_out_metrics(
    dataset: DatasetVersion, held_out: HeldOut, model: LinearModel
) -> dict[str, Any]:
    """All figures of a cross-validation: pooled, by fold, by class, and of the ocean frames.

    Parameters
    ----------
    dataset : DatasetVersion
    held_out : HeldOut
    model : LinearModel
        Says what decision values mean: thresholds, classes, obstacle flags.
    """
    tested = held_out.fold >= 0
    fold, targets = held_out.fold[tested], dataset.targets()[tested]
    values = held_out.values[tested]
    truth = np.asarray(model.obstacle, bool)[targets]
    score = model.obstacle_score(values)
    frames = dataset.patches.frame.to_numpy()[tested]
    folds = [
        {
            **obstacle_metrics(truth[fold == index], score[fold == index]),
            "penalty": penalty,
            "frames": format_frames(frames[fold == index].tolist()),
        }
        for index, penalty in enumerate(held_out.penalties)
    ]
    said = np.zeros(len(tested), bool)
    said[tested] = model.obstacle_patches(values)
    return {
        "patch": {
            **obstacle_metrics(truth, score),
            **class_metrics(targets, model.predicted(values), model.classes),
        },
        "folds": folds,
        "frames": ocean_frame_statuses(dataset, said, tested),
        "patches_tested": int(tested.sum()),
    }
