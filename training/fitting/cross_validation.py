"""Cross-validation over blocks of frames, with every choice made inside the training part.

Before it, what cannot be learnt from or tested is refused; after it come the figures.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from tokt.features.common.arrays import F64, I64
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import format_frames
from tokt.models.linear import LinearModel
from tokt.models.operating_point import MofNRule
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.datasets.splits import Fold, blocked_folds
from tokt.training.evaluation.frame_scores import frame_figures
from tokt.training.evaluation.metrics import class_metrics, obstacle_metrics
from tokt.training.parallel import mapped

from .choose_operating_point import DEFAULT_TARGET, FalseStatusTarget, choose_frame_rule
from .classifier import decision_values, fit_classifier, linear_model
from .presets import Hyperparameters, TrainingSettings

Tables = Sequence[F64]


@dataclass(frozen=True)
class Split:
    """Folds and embargo of a cross-validation.

    Parameters
    ----------
    folds, embargo_frames : int
        Of the outer cross-validation; the inner one has one fold less, the same embargo.
    """

    folds: int
    embargo_frames: int

    def __post_init__(self) -> None:
        if self.folds < 2 or not 0 <= self.embargo_frames < 1 << 31:
            raise ValueError(f"{self.folds} folds, {self.embargo_frames} frames apart")

    @classmethod
    def logged(cls, parameters: Mapping[str, str]) -> Self:
        """What a run's parameters say."""
        return cls(int(parameters["split_folds"]), int(parameters["split_embargo_frames"]))


@dataclass(frozen=True)
class HeldOutPredictions:
    """Decision values of patches by models that did not learn from them.

    Parameters
    ----------
    values : array of float64, shape (n_patches, n_outputs)
    fold : array of int, shape (n_patches,)
        The fold in which a patch was tested; -1 for none.
    choices : tuple of Hyperparameters
        What each fold's model was trained with.
    rules : tuple of MofNRule
        Each fold's frame rule, chosen on its training part alone.
    stressed : mapping of str to array of float64, shape (n_patches, n_outputs)
        By augmentation: decision values of the patches on frames so augmented.
    """

    values: F64
    fold: I64
    choices: tuple[Hyperparameters, ...]
    rules: tuple[MofNRule, ...]
    stressed: Mapping[str, F64] = field(default_factory=dict)


@dataclass(frozen=True)
class BestCandidate:
    """The best candidate of a cross-validation.

    Parameters
    ----------
    choice : Hyperparameters
    values : array of float64, shape (n_patches, n_outputs)
        Its decision values of patches that were held out.
    """

    choice: Hyperparameters
    values: F64


def fit_rows(
    features: F64,
    targets: I64,
    rows: I64,
    choice: Hyperparameters,
    settings: TrainingSettings,
    augmented: Tables = (),
) -> Pipeline:
    """Fit to some patches, as they are and as they look on augmented frames.

    Parameters
    ----------
    features : array of float64, shape (n_patches, dim)
    targets : array of int, shape (n_patches,)
    rows : array of int
        What to learn from.
    choice, settings
        As for `fit_classifier`.
    augmented : sequence of arrays like `features`
        The same patches on augmented frames.
    """
    tables = [table[rows] for table in (features, *augmented)]
    known = np.tile(targets[rows], len(tables))
    weights = np.repeat([1.0] + [settings.change_weight] * len(augmented), len(rows))
    return fit_classifier(np.concatenate(tables), known, choice, settings, weights)


def choose_hyperparameters(
    patches: pd.DataFrame,
    features: F64,
    targets: I64,
    settings: TrainingSettings,
    split: Split,
    augmented: Tables = (),
    jobs: int = 1,
) -> BestCandidate:
    """The candidate with the best pooled F1 (macro-F1 for several classes) in a blocked CV.

    The simpler one wins a tie.

    Parameters
    ----------
    patches : DataFrame
        Columns mission, frame, group.
    features : array of float64, shape (n_patches, dim)
    targets : array of int, shape (n_patches,)
    settings : TrainingSettings
    split : Split
    augmented : sequence of arrays like `features`
        Learnt from too, as in `fit_rows`; tested on is `features` alone.
    jobs : int
        Processes; -1 for one a core. The result does not depend on it.

    Raises
    ------
    ToktError
        If there are too few groups; see `blocked_folds`.
    """
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    tasks = [
        (features, targets, fold, choice, settings, augmented)
        for choice in settings.choices
        for fold in folds
    ]
    results = map(_tested, tasks) if jobs == 1 else mapped(_tested, tasks, jobs)
    best, best_score = None, -np.inf
    for choice in settings.choices:
        values = np.empty((len(targets), _outputs(len(np.unique(targets)))))
        for fold in folds:
            values[fold.test] = next(results)
        score = _f1(targets, values)
        if best is None or score > best_score:
            best, best_score = BestCandidate(choice, values), score
    if best is None:
        raise ValueError("settings hold no candidate")
    return best


_Fit = tuple[F64, I64, Fold, Hyperparameters, TrainingSettings, Tables]
"""One fold of one candidate: features, targets, fold, choice, settings, augmented."""


def _tested(task: _Fit) -> F64:
    """Decision values of the fold's test rows."""
    features, targets, fold, choice, settings, augmented = task
    model = fit_rows(features, targets, fold.train, choice, settings, augmented)
    return decision_values(model, features[fold.test])


def _outputs(classes: int) -> int:
    return 1 if classes == 2 else classes


def _f1(targets: I64, values: F64) -> float:
    if values.shape[1] == 1:
        return float(obstacle_metrics(targets == 1, values[:, 0])["f1"] or 0.0)
    names = tuple(str(index) for index in range(values.shape[1]))
    return float(class_metrics(targets, values.argmax(axis=1), names)["macro_f1"] or 0.0)


def cross_validate(
    dataset: DatasetVersion,
    features: F64,
    settings: TrainingSettings,
    split: Split,
    progress: Callable[..., Any],
    target: FalseStatusTarget = DEFAULT_TARGET,
    augmented: Tables = (),
    stress: Mapping[str, F64] | None = None,
    jobs: int = 1,
) -> HeldOutPredictions:
    """Nested cross-validation: what is chosen is chosen inside the training part of each fold.

    Parameters
    ----------
    dataset : DatasetVersion
    features : array of float64, shape (n_patches, dim)
    settings : TrainingSettings
    split : Split
    progress : callable
        ``progress(items, total, what)`` passes the items through.
    target : FalseStatusTarget
        What the folds' frame rules are chosen for.
    augmented : sequence of arrays like `features`
        Of the settings' augmentations; learnt from too, never tested on.
    stress : mapping of str to array like `features`, optional
        By augmentation to test on beside.
    jobs : int
        As for `choose_hyperparameters`.

    Raises
    ------
    ToktError
        If the dataset has too few groups (see `blocked_folds`), or the features are not finite
        or all the same.
    """
    features = np.asarray(features)
    stress = stress or {}
    for table in (features, *augmented, *stress.values()):
        check_features(dataset, table)
    patches, targets = dataset.patches, dataset.targets()
    folds = blocked_folds(patches, targets, split.folds, split.embargo_frames)
    inner = Split(inner_folds(split.folds), split.embargo_frames)
    values = np.full((len(targets), _outputs(len(dataset.classes()))), np.nan)
    stressed = {name: values.copy() for name in stress}
    number = np.full(len(targets), -1)
    choices, rules = [], []
    for index, fold in enumerate(progress(folds, len(folds), "cross-validation")):
        part = patches.iloc[fold.train], features[fold.train], targets[fold.train]
        chosen = choose_hyperparameters(
            *part, settings, inner, [table[fold.train] for table in augmented], jobs
        )
        pipeline = fit_rows(features, targets, fold.train, chosen.choice, settings, augmented)
        model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
        rules.append(_inner_rule(dataset, fold.train, model.obstacle_score(chosen.values), target))
        values[fold.test] = decision_values(pipeline, features[fold.test])
        for name, table in stress.items():
            stressed[name][fold.test] = decision_values(pipeline, table[fold.test])
        number[fold.test] = index
        choices.append(chosen.choice)
    return HeldOutPredictions(values, number, tuple(choices), tuple(rules), stressed)


def _inner_rule(
    dataset: DatasetVersion, rows: I64, score: F64, target: FalseStatusTarget
) -> MofNRule:
    """The frame rule that a fold's training part asks for."""
    scores, tested = np.full(len(dataset.patches), np.nan), np.zeros(len(dataset.patches), bool)
    scores[rows], tested[rows] = score, True
    return choose_frame_rule(dataset, scores, tested, target)[0]


def held_out_metrics(
    dataset: DatasetVersion, held_out: HeldOutPredictions, model: LinearModel
) -> dict[str, Any]:
    """All figures of a cross-validation: pooled, by fold, by class, and of the ocean frames.

    Parameters
    ----------
    dataset : DatasetVersion
    held_out : HeldOutPredictions
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
            "penalty": choice.penalty,
            "class_weight": choice.class_weight,
            "frames": format_frames(frames[fold == index].tolist()),
        }
        for index, choice in enumerate(held_out.choices)
    ]
    all_scores = model.obstacle_score(held_out.values)
    return {
        "patch": {
            **obstacle_metrics(truth, score),
            **class_metrics(targets, model.predicted(values), model.classes),
        },
        "folds": folds,
        "frames": frame_figures(dataset, all_scores, held_out.fold, held_out.rules),
        "frames_at_zero": frame_figures(
            dataset, all_scores, held_out.fold, [MofNRule()] * len(held_out.rules)
        ),
        "fold_rules": [rule.to_json() for rule in held_out.rules],
        "patches_tested": int(tested.sum()),
    }


def check_blocks(dataset: DatasetVersion, n_folds: int, embargo_frames: int) -> None:
    """Raise ToktError unless the dataset can be cross-validated, choices inside each fold too."""
    patches, targets = dataset.patches, dataset.targets()
    for fold in blocked_folds(patches, targets, n_folds, embargo_frames):
        part = patches.iloc[fold.train]
        blocked_folds(part, targets[fold.train], inner_folds(n_folds), embargo_frames)


def inner_folds(n_folds: int) -> int:
    """Folds of the cross-validation inside the training part of one of `n_folds` folds."""
    return max(2, n_folds - 1)


def check_features(dataset: DatasetVersion, features: F64) -> None:
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
