"""The classifier of a model: optional scaler and map, and a linear model, by scikit-learn."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import F64, I64
from tokt.models.linear import LinearModel
from tokt.training.datasets.changed_patches import ChangedPatches
from tokt.training.datasets.folds import Dives

from .presets import Hyperparameters, TrainingSettings

Tables = Sequence[ChangedPatches]

_LOGISTIC_WEIGHT = 1e5
"""Of all patches together: at C = 1 a ridge of 1e-5 against their mean loss, chosen with whole
sites held out."""

_AT_ONCE = 1 << 15  # patches: 160 MB at 600 landmarks


def fit_rows(
    features: F64,
    targets: I64,
    rows: I64,
    choice: Hyperparameters,
    settings: TrainingSettings,
    augmented: Tables = (),
    dives: Dives | None = None,
) -> Pipeline:
    """Fit to some patches, as they are and as they look on augmented frames.

    Of more than `settings.max_samples` some are drawn: half of them by class, so that a rare one is
    not lost. Each class, and of a dive what was drawn, then counts by as much as among all patches;
    the mean weight stays 1, so that C acts as on so few. Of augmented frames each dive counts
    `settings.change_weight` times as much as of frames as they are, however many patches it has.
    Dives that were added to a model (`Dives.added`) change neither scaler nor map, nor what is
    drawn of the others: the linear model alone learns from them.

    Parameters
    ----------
    features : array of float64, shape (n_patches, dim)
    targets : array of int, shape (n_patches,)
    rows : array of int
        What to learn from.
    choice, settings
        As for `fit_classifier`.
    augmented : sequence of ChangedPatches
        Patches of augmented frames; learnt from are those whose source is among `rows`.
    dives : Dives, optional
        The dive of each patch, which then count by `Dives.weights`; by default patches count alike.
    """
    own, parts = None, np.ones(len(rows))
    mine = None if dives is None else dives.part(rows)
    if mine is not None and len(np.unique(mine.number)) > 1:
        own, parts = mine.number, mine.weights()
        added = mine.added[own]
        if added.any() and not added.all():
            parts /= parts[~added].mean()  # so that C acts on the others as without it
            kept, late = (
                _learning_set(features, targets, rows[of], own[of], parts[of], settings, augmented)
                for of in (~added, added)
            )
            steps = _fitted_steps(kept, settings)
            return _fit_linear(_joined([kept, late]), choice, settings, steps)
    learnt = _learning_set(features, targets, rows, own, parts, settings, augmented)
    return fit_classifier(
        *(learnt.features, learnt.targets, choice, settings),
        *(learnt.weights, learnt.scaled_by, learnt.landmarks),
    )


@dataclass(frozen=True)
class _LearningSet:
    """The patches that a fit learns from."""

    features: F64  # (n, dim)
    targets: I64  # (n,)
    weights: F64 | None  # (n,), as `fit_classifier` takes them, like the two below
    scaled_by: F64 | None = None
    landmarks: F64 | None = None
    share: float = 1.0  # how much all of them count, over the sum of their weights


def _learning_set(
    features: F64,
    targets: I64,
    rows: I64,
    own: I64 | None,
    parts: F64,
    settings: TrainingSettings,
    augmented: Tables,
) -> _LearningSet:
    """Draw what to learn from; `own` and `parts` are dive and weight of each of `rows`."""
    landmarks, all_rows = None, parts.sum()
    scaled = own is not None or len(rows) > settings.max_samples
    changed = [changed_rows(table, rows, own, parts, settings) for table in augmented]
    if len(rows) > settings.max_samples:
        if settings.landmarks:
            landmarks = features[rows[drawn(parts, settings.landmarks, settings.seed)]]
        kept, parts = _sample(targets[rows], own, parts, settings)
        rows = rows[kept]
    tables, known, counted = [features[rows]], [targets[rows]], [parts]
    for table, (at, share) in zip(augmented, changed, strict=True):
        tables.append(table.features[at])
        known.append(targets[table.source[at]])
        counted.append(share * (parts.sum() / all_rows))
    weights = [parts, *(settings.change_weight * part for part in counted[1:])]
    return _LearningSet(
        np.concatenate(tables),
        np.concatenate(known),
        np.concatenate(weights),
        np.concatenate(counted) if scaled else None,
        landmarks,
        all_rows / parts.sum(),
    )


def _joined(sets: Sequence[_LearningSet]) -> _LearningSet:
    """Some sets as one, each with its share; the weights are of the first one's size."""
    weights = [np.asarray(one.weights) * (one.share / sets[0].share) for one in sets]
    return _LearningSet(
        np.concatenate([one.features for one in sets]),
        np.concatenate([one.targets for one in sets]),
        np.concatenate(weights),
    )


def changed_rows(
    table: ChangedPatches, rows: I64, dives: I64 | None, parts: F64, settings: TrainingSettings
) -> tuple[I64, F64]:
    """Rows of a table that come from `rows`, and how much each counts: a dive as much as there.

    `dives` and `parts`, how much each counts, are of `rows`.
    """
    at = table.of(rows)
    if len(at) > settings.max_samples:
        rng = np.random.default_rng(settings.seed)
        at = np.sort(rng.choice(at, settings.max_samples, replace=False))
    dive = np.zeros(len(rows), np.int64) if dives is None else dives
    own = dive[np.searchsorted(rows, table.source[at])]
    patches = np.bincount(own, minlength=int(dive.max()) + 1)
    return at, (np.bincount(dive, parts) / np.maximum(patches, 1))[own]


def _sample(
    targets: I64, dives: I64 | None, parts: F64, settings: TrainingSettings
) -> tuple[I64, F64]:
    """Some patches and how much each counts, given how much each would count among all."""
    of_class = np.bincount(targets, parts)
    chance = parts / parts.sum() + parts / of_class[targets] / np.count_nonzero(of_class)
    kept = np.sort(drawn(chance, settings.max_samples, settings.seed))
    cell = targets if dives is None else targets + len(of_class) * dives
    found = np.bincount(cell[kept])
    share = np.bincount(cell, parts)[: len(found)] / np.maximum(found, 1)
    weights = share[cell[kept]]
    # What a dive has of a class, and none of it was drawn, the other dives' patches stand for.
    drawn_of_class = np.bincount(targets[kept], weights, len(of_class))[targets[kept]]
    weights *= of_class[targets[kept]] / drawn_of_class
    return kept, weights * len(kept) / weights.sum()


def fit_classifier(
    features: F64,
    targets: I64,
    choice: Hyperparameters,
    settings: TrainingSettings,
    weights: F64 | None = None,
    scaled_by: F64 | None = None,
    landmarks: F64 | None = None,
) -> Pipeline:
    """Fit scaler, map if there is one, and linear model; deterministic for the same input.

    Scaled features are solved in the primal, which converges to the same weights whatever the
    seed. With the logistic loss weights add up to `_LOGISTIC_WEIGHT`, so that C acts the same on
    many patches and on few. The thesis's unscaled features are solved in the dual with its seed, as
    scikit-learn did in 2016, and need not converge; `converged` says whether they did.

    Parameters
    ----------
    features : array of float64, shape (n, dim)
    targets : array of int, shape (n,)
    choice : Hyperparameters
        The linear model's C and the weights of the classes.
    weights : array of float64, shape (n,), optional
        How much each patch's error counts, and the patch itself before a map.
    scaled_by : array of float64, shape (n,), optional
        How much each patch counts in a scaler without a map; by default all alike.
    landmarks : array of float64, shape (n_landmarks, dim), optional
        Features of the map's landmarks; by default some of `features`, drawn by weight.
    """
    learnt = _LearningSet(np.asarray(features), targets, weights, scaled_by, landmarks)
    return _fit_linear(learnt, choice, settings, _fitted_steps(learnt, settings))


def _fitted_steps(
    learnt: _LearningSet, settings: TrainingSettings
) -> list[tuple[str, TransformerMixin]]:
    """Fit what comes before the linear model."""
    parts = np.ones(len(learnt.features)) if learnt.weights is None else learnt.weights
    landmarks = learnt.landmarks
    if landmarks is None and settings.landmarks:
        landmarks = learnt.features[drawn(parts, settings.landmarks, settings.seed)]
    if landmarks is not None:
        return _fitted_map(learnt.features, parts, landmarks, settings)
    if settings.scale:
        scaler = StandardScaler().fit(learnt.features, sample_weight=learnt.scaled_by)
        return [("scaler", scaler)]
    return []


def _fit_linear(
    learnt: _LearningSet,
    choice: Hyperparameters,
    settings: TrainingSettings,
    steps: list[tuple[str, TransformerMixin]],
) -> Pipeline:
    weights = learnt.weights
    shared: dict[str, Any] = {"C": choice.penalty, "class_weight": choice.class_weight}
    linear: LinearSVC | LogisticRegression
    if settings.logistic:
        parts = np.ones(len(learnt.features)) if weights is None else weights
        weights = parts * (_LOGISTIC_WEIGHT / parts.sum())
        linear = LogisticRegression(**shared, solver="newton-cholesky")
    else:
        # In the dual for unscaled features: `random_state` counts there.
        linear = LinearSVC(
            **shared, random_state=settings.seed, dual=not settings.scale, max_iter=5000
        )
    mapped = Pipeline(steps).transform(learnt.features) if steps else learnt.features
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        linear.fit(mapped, learnt.targets, sample_weight=weights)
    return Pipeline([*steps, ("svc", linear)])


def drawn(parts: F64, count: int, seed: int) -> I64:
    """So many patches drawn by weight, so that a long dive does not have them all; or all."""
    return np.random.default_rng(seed).choice(
        len(parts), min(int(np.count_nonzero(parts)), count), replace=False, p=parts / parts.sum()
    )


def _fitted_map(
    features: F64, weights: F64, landmarks: F64, settings: TrainingSettings
) -> list[tuple[str, TransformerMixin]]:
    """A scaler that limits what lies far out, and Nystroem's map."""
    usual = StandardScaler().fit(features, sample_weight=weights)
    far = settings.limit * usual.scale_
    scaler = MinMaxScaler((-settings.limit, settings.limit), clip=True)
    scaler.fit(np.stack([usual.mean_ - far, usual.mean_ + far]))
    nystroem = Nystroem(
        gamma=settings.gamma / features.shape[1],
        n_components=len(landmarks),
        random_state=settings.seed,
    )
    nystroem.fit(scaler.transform(landmarks))
    return [("scaler", scaler), ("map", nystroem)]


def converged(pipeline: Pipeline) -> bool:
    """Whether the solver stopped before its iteration limit."""
    svc = pipeline.named_steps["svc"]
    return bool(np.max(svc.n_iter_) < svc.max_iter)


def decision_values(pipeline: Pipeline, features: F64, rows: I64 | None = None) -> F64:
    """The pipeline's decision function, shape (n, n_outputs), of all rows or of some.

    The table may be larger than memory, and what a map makes of it is larger still.
    """
    rows = np.arange(len(features)) if rows is None else rows
    return in_parts(pipeline.decision_function, features, rows).reshape(len(rows), -1)


def in_parts(function: Callable[[F64], Any], features: F64, rows: I64) -> F64:
    """Apply a function of features to some rows of a table, so many rows at a time."""
    parts = np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE))
    return np.concatenate([np.asarray(function(features[part]), np.float64) for part in parts])


def linear_model(
    pipeline: Pipeline, classes: tuple[str, ...], obstacle: tuple[bool, ...]
) -> LinearModel:
    """The same model with scaler and map folded in and thresholds of 0."""
    outputs = len(pipeline.named_steps["svc"].coef_)
    return LinearModel.from_pipeline(pipeline, np.zeros(outputs), classes, obstacle)
