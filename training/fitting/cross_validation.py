"""Cross-validation over dives or blocks of frames; choices are made inside the training part.

Before it, what cannot be learnt from or tested is refused; after it come the figures.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, I64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import format_frames
from tokt.models.linear import LinearModel, obstacle_score
from tokt.models.operating_point import MofNRule
from tokt.models.water import WaterPrior
from tokt.training.datasets.dataset import PATCH_KEY, DatasetVersion
from tokt.training.datasets.folds import DIVE, Dives, Fold
from tokt.training.datasets.split import Split
from tokt.training.evaluation.frame_scores import frame_figures
from tokt.training.evaluation.metrics import (
    class_metrics,
    metrics_by,
    obstacle_metrics,
    over_dives,
    right_by_margin,
)
from tokt.training.parallel import mapped

from .choose_operating_point import DEFAULT_TARGET, FalseStatusTarget, choose_frame_rule
from .classifier import Tables, decision_values, fit_rows, in_parts, linear_model
from .presets import Hyperparameters, TrainingSettings
from .whole_frames import WholeFrames, judged


@dataclass(frozen=True)
class HeldOutPredictions:
    """Decision values of patches by models that did not learn from them."""

    values: F64  # (n_patches, n_outputs)
    fold: I64  # (n_patches,): the fold in which a patch was tested; -1 for none
    choices: tuple[Hyperparameters, ...]  # what each fold's model was trained with
    rules: tuple[MofNRule, ...]  # each fold's frame rule, chosen on its training part alone
    # By augmentation: (n_patches, n_outputs) of the patches on frames so augmented.
    stressed: Mapping[str, F64] = field(default_factory=dict)
    # (n_patches,): how far each was from the nearest landmark (`NystroemMap.distance`); NaN where
    # it was not tested, None without a map.
    distance: F64 | None = None


@dataclass(frozen=True)
class BestCandidate:
    """The best candidate of a cross-validation."""

    choice: Hyperparameters
    values: F64  # (n_patches, n_outputs) where a patch was held out (`Split.cut`); NaN of others
    prior: WaterPrior | None  # of these values before the boundary was moved by it, if it was


def choose_hyperparameters(
    patches: pd.DataFrame,
    features: F64,
    targets: I64,
    settings: TrainingSettings,
    split: Split,
    augmented: Tables = (),
    jobs: int = 1,
    whole: WholeFrames | None = None,
    rows: I64 | None = None,
) -> BestCandidate:
    """The candidate with the best F1 (macro-F1 for several classes) of patches held out.

    Pooled over blocks; by dive, the mean of the dives' F1, so that a long dive does not decide
    alone. The simpler one wins a tie.

    Parameters
    ----------
    patches : DataFrame
        Columns mission, frame, group.
    features : array of float64, shape (n_patches, dim)
    targets : array of int, shape (n_patches,)
    augmented : sequence of ChangedPatches
        Learnt from too, as in `fit_rows`; tested on is `features` alone.
    jobs : int
        Processes; -1 for one a core. The result does not depend on it.
    whole : WholeFrames, optional
        The patches' frames, over which the boundary moves.
    rows : array of int, optional
        Of the patches to choose on; by default those of `Split.judged`.

    Raises
    ------
    ToktError
        If there are too few groups; see `blocked_folds`.
    """
    rows = split.judged(patches, targets) if rows is None else rows
    cut = split.cut(patches.iloc[rows], targets[rows], to_choose=True)
    folds = [Fold(rows[fold.train], rows[fold.test]) for fold in cut]
    parts = [*patches.groupby("mission").indices.values()] if split.by == DIVE else []
    dives = split.dives(patches)
    tasks = [
        (features, targets, fold, choice, settings, augmented, dives, whole)
        for choice in settings.choices
        for fold in folds
    ]
    results = map(_tested, tasks) if jobs == 1 else mapped(_tested, tasks, jobs)
    best, best_score = None, -np.inf
    outputs = _outputs(len(np.unique(targets)))
    for choice in settings.choices:
        values, prior = np.full((len(targets), outputs), np.nan), None
        found = [next(results) for _ in folds]
        if whole is None:
            for fold, one in zip(folds, found, strict=True):
                values[fold.test] = one
        else:
            gray = np.full((len(whole.gray_changes.source), outputs), np.nan)
            for fold, one in zip(folds, found, strict=True):
                values[fold.test] = whole.part(fold.test).moved(one.frames, one.values, None)
                gray[whole.gray_changes.of(fold.test)] = one.gray_changes
            if prior := _prior(patches, targets, values, gray, whole):
                for fold, one in zip(folds, found, strict=True):
                    values[fold.test] = whole.part(fold.test).moved(one.frames, one.values, prior)
        score = _mean_f1(targets, values, parts)
        if best is None or score > best_score:
            best, best_score = BestCandidate(choice, values, prior), score
    if best is None:
        raise ValueError("settings hold no candidate")
    return best


_Fit = tuple[
    F64, I64, Fold, Hyperparameters, TrainingSettings, Tables, Dives | None, WholeFrames | None
]
"""One fold of one candidate: features, targets, fold, choice, settings, augmented, dives, whole."""


@dataclass(frozen=True)
class _JudgedFrames:
    """Decision values of the whole frames of a fold's test rows."""

    frames: I64  # as `WholeFrames.values` has these two
    values: F64
    gray_changes: F64  # (n, n_outputs): of the patches of `WholeFrames.gray_changes`


def _tested(task: _Fit) -> Any:
    """Judge a fold's test rows: their decision values, or `_JudgedFrames`."""
    features, targets, fold, choice, settings, augmented, dives, whole = task
    model = fit_rows(features, targets, fold.train, choice, settings, augmented, dives)
    judge = partial(decision_values, model)
    if whole is None:
        return judge(features, fold.test)
    frames, of_frames = whole.part(fold.test).values(judge)
    gray = whole.gray_changes.of(fold.test)
    of_changes = np.zeros((0, of_frames.shape[2]))
    if len(gray):
        of_changes = judge(whole.gray_changes.features, gray)
    return _JudgedFrames(frames, of_frames, of_changes)


_FEWEST_GRAY = 100
_FEWEST_GRAY_DIVES = 5
"""Gray patches of obstacles, and as many of water, and dives with both, or all that there are where
they are fewer. Of less nothing is expected: patches of one frame say the same."""


def _prior(
    patches: pd.DataFrame, targets: I64, values: F64, gray_values: F64, whole: WholeFrames
) -> WaterPrior | None:
    """Find the prior that held-out patches give, and that of gray frames where there are enough.

    `gray_values` are of `WholeFrames.gray_changes`.
    """
    flags, mission = np.asarray(whole.obstacle, bool), patches.mission.to_numpy()
    tested = np.flatnonzero(rows_tested(values))
    is_gray = whole.gray[whole.frame[tested]]
    # A dataset of gray frames alone has no other water to tell of.
    own = tested if is_gray.all() else tested[~is_gray]
    scores = obstacle_score(values, whole.obstacle)
    prior = WaterPrior.of(scores[own], flags[targets[own]], mission[own])
    if prior is None:
        return None
    gray, changed = tested[is_gray], np.flatnonzero(rows_tested(gray_values))
    source = np.concatenate([gray, whole.gray_changes.source[changed]])
    obstacle = flags[targets[source]]
    of_colour = _dives_with_both(mission[own], flags[targets[own]])
    enough = min(_FEWEST_GRAY_DIVES, of_colour)
    if (
        min(obstacle.sum(), (~obstacle).sum()) < _FEWEST_GRAY
        or _dives_with_both(mission[source], obstacle) < enough
    ):
        return prior
    of_changes = obstacle_score(gray_values[changed], whole.obstacle)
    pool = np.concatenate([scores[gray], of_changes])
    return replace(prior, gray=WaterPrior.of(pool, obstacle, mission[source]))


def _dives_with_both(dives: NDArray[Any], obstacle: Bools) -> int:
    """Count the dives that have patches of obstacles and of water."""
    return len(set(dives[obstacle]) & set(dives[~obstacle]))


def _outputs(classes: int) -> int:
    return 1 if classes == 2 else classes


def _mean_f1(targets: I64, values: F64, parts: Sequence[I64]) -> float:
    """Over the parts that have both sides tested; pooled where none has, or there are none."""
    tested = rows_tested(values)
    rows = [part[tested[part]] for part in parts]
    mixed = [part for part in rows if len(np.unique(targets[part])) > 1]
    pooled = [np.flatnonzero(tested)]
    return float(np.mean([_f1(targets[part], values[part]) for part in mixed or pooled]))


def rows_tested(values: F64) -> Bools:
    """The patches that `BestCandidate` has values of."""
    return np.asarray(np.isfinite(values).all(axis=1), bool)


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
    whole: Mapping[str, WholeFrames] | None = None,
) -> HeldOutPredictions:
    """Nested cross-validation: each choice is made inside the training part of its fold.

    Of very many patches some are tested, and learnt from by the folds (`Split.judged`).

    Parameters
    ----------
    features : array of float64, shape (n_patches, dim)
    progress : callable
        ``progress(items, total, what)`` passes the items through.
    target : FalseStatusTarget
        What the folds' frame rules are chosen for.
    augmented : sequence of ChangedPatches
        Of the settings' augmentations; learnt from too, never tested on.
    stress : mapping of str to array like `features`, optional
        By augmentation to test on beside.
    jobs : int
        As for `choose_hyperparameters`.
    whole : mapping of str to WholeFrames, optional
        By augmentation, ``""`` for none, of `features` and `stress`: the boundary then moves over
        the frames of a fold, from the prior that its training part gives.

    Raises
    ------
    ToktError
        If the dataset has too few groups (see `blocked_folds`), or the features are not finite
        or all the same.
    """
    features = np.asarray(features)
    tables, whole = {"": features, **(stress or {})}, whole or {}
    for table in (features, *(one.features for one in augmented), *(stress or {}).values()):
        check_features(dataset, table)
    patches, targets = dataset.patches, dataset.targets()
    folds, dives = split.cut(patches, targets), split.dives(patches)
    shape = len(targets), _outputs(len(dataset.classes()))
    values = {name: np.full(shape, np.nan) for name in tables}
    number, distance = np.full(len(targets), -1), np.full(len(targets), np.nan)
    choices, rules = [], []
    for index, fold in enumerate(progress(folds, len(folds), "cross-validation")):
        learnt = patches, features, targets, settings, split.inner, augmented
        chosen = choose_hyperparameters(*learnt, jobs, whole.get(""), fold.train)
        pipeline = fit_rows(
            features, targets, fold.train, chosen.choice, settings, augmented, dives
        )
        model = linear_model(pipeline, dataset.classes(), dataset.obstacle_flags())
        scores, tested = model.obstacle_score(chosen.values), rows_tested(chosen.values)
        by_dive = split.by == DIVE
        rules.append(choose_frame_rule(dataset, scores, tested, target, by_dive)[0])
        judge = partial(decision_values, pipeline)
        for name, table in tables.items():
            values[name][fold.test] = judged(judge, table, fold.test, whole.get(name), chosen.prior)
        if model.map is not None:
            distance[fold.test] = in_parts(model.map.distance, features, fold.test)
        number[fold.test] = index
        choices.append(chosen.choice)
    told = values.pop(""), number, tuple(choices), tuple(rules), values
    return HeldOutPredictions(*told, distance if settings.landmarks else None)


def held_out_metrics(
    dataset: DatasetVersion,
    held_out: HeldOutPredictions,
    model: LinearModel,
    sites: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """All figures of a cross-validation: pooled, by fold, by class, and of the ocean frames.

    Of several dives also ``dives`` and ``over_dives``, their mean; with `sites` by mission,
    ``sites``. The model says what decision values mean: thresholds, classes, obstacle flags.
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
    predicted = model.predicted(values)
    said = truth, score, targets, predicted, model.classes
    mission = dataset.patches.mission[tested]
    dives = metrics_by(mission.to_numpy(), *said)
    by_site = mission.map(lambda name: (sites or {}).get(name, name)).to_numpy()
    return {
        "patch": {
            **obstacle_metrics(truth, score),
            **class_metrics(targets, predicted, model.classes),
        },
        **({"dives": dives, "over_dives": over_dives(dives)} if len(dives) > 1 else {}),
        **({"sites": metrics_by(by_site, *said)} if sites and len(dives) > 1 else {}),
        "folds": folds,
        "frames": frame_figures(dataset, all_scores, held_out.fold, held_out.rules),
        "frames_at_zero": frame_figures(
            dataset, all_scores, held_out.fold, [MofNRule()] * len(held_out.rules)
        ),
        "fold_rules": [rule.to_json() for rule in held_out.rules],
        "right_by_margin": right_by_margin(truth, score),
        "patches_tested": int(tested.sum()),
    }


def check_features(dataset: DatasetVersion, features: F64) -> None:
    """Raise ToktError unless there is something to learn from in the features.

    A feature that is the same everywhere is harmless; the scaler leaves it at 0.
    """
    every = np.arange(len(features))
    sound = in_parts(lambda some: np.isfinite(some).all(axis=1), features, every) > 0
    if not sound.all():
        mission, camera, frame, row, col = dataset.patches.iloc[int(np.argmin(sound))][PATCH_KEY]
        raise ToktError(
            f"dataset {dataset.label}: the extractor gives {int((~sound).sum())} patches a feature "
            f"that is not a finite number. The first is mission {mission}, {camera} frame {frame}, "
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

    Each fold's model scores the augmented frames of its test part. `learnt` are the augmentations
    that the models learnt from, on other frames. By augmentation there are f1, average_precision,
    fall (of F1, against the frames as they are), false_status, ocean_frames, detected,
    obstacle_frames (at the folds' rules), learnt, and of several dives `metrics_by` them (dives).
    """
    tested = held_out.fold >= 0
    targets, found = dataset.targets()[tested], {}
    truth = np.asarray(model.obstacle, bool)[targets]
    plain = obstacle_metrics(truth, model.obstacle_score(held_out.values[tested]))["f1"]
    mission = dataset.patches.mission[tested].to_numpy()
    for name, values in held_out.stressed.items():
        score = model.obstacle_score(values)
        patch = obstacle_metrics(truth, score[tested])
        f1 = patch["f1"]
        said = score[tested], targets, model.predicted(values[tested]), model.classes
        dives = metrics_by(mission, truth, *said)
        frames = frame_figures(dataset, score, held_out.fold, held_out.rules)
        found[name] = {
            "f1": f1,
            "average_precision": patch["average_precision"],
            **({"dives": dives} if len(dives) > 1 else {}),
            "fall": None if f1 is None or plain is None else plain - f1,
            **{key: frames[key] for key in _COUNTS},
            "learnt": name in learnt,
        }
    return found


_COUNTS = ("false_status", "ocean_frames", "detected", "obstacle_frames")
