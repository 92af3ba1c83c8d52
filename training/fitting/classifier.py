"""The classifier of a model: optional scaler and map, a LinearSVC, as scikit-learn has them."""

import warnings
from collections.abc import Callable

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.kernel_approximation import Nystroem
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import F64, I64
from tokt.models.linear import LinearModel

from .presets import Hyperparameters, TrainingSettings

_AT_ONCE = 1 << 15  # patches: 160 MB at 600 landmarks


def fit_classifier(
    features: F64,
    targets: I64,
    choice: Hyperparameters,
    settings: TrainingSettings,
    weights: F64 | None = None,
    scaled_by: F64 | None = None,
) -> Pipeline:
    """Fit scaler, map if there is one, and LinearSVC; deterministic for the same input.

    Scaled features are solved in the primal, which converges to the same weights whatever the
    seed. The thesis's unscaled ones are solved in the dual with its seed, as scikit-learn did in
    2016, and need not converge; `converged` says whether they did.

    Parameters
    ----------
    features : array of float64, shape (n, dim)
    targets : array of int, shape (n,)
    choice : Hyperparameters
        LinearSVC's C and the weights of the classes.
    settings : TrainingSettings
    weights : array of float64, shape (n,), optional
        How much each patch's error counts, and the patch itself before a map.
    scaled_by : array of float64, shape (n,), optional
        How much each patch counts in a scaler without a map; by default all alike.
    """
    svc = LinearSVC(
        C=choice.penalty,
        class_weight=choice.class_weight,
        random_state=settings.seed,
        dual=not settings.scale,
        max_iter=5000,
    )
    features = np.asarray(features)
    steps = _fitted_map(features, weights, settings) if settings.landmarks else []
    if settings.scale and not steps:
        steps = [("scaler", StandardScaler().fit(features, sample_weight=scaled_by))]
    mapped = Pipeline(steps).transform(features) if steps else features
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        svc.fit(mapped, targets, sample_weight=weights)
    return Pipeline([*steps, ("svc", svc)])


def _fitted_map(
    features: F64, weights: F64 | None, settings: TrainingSettings
) -> list[tuple[str, TransformerMixin]]:
    """A scaler that limits what lies far out, and Nystroem's map; both take weights into account.

    Landmarks are drawn from the patches by weight, so that a long dive does not have them all.
    """
    parts = np.ones(len(features)) if weights is None else weights
    usual = StandardScaler().fit(features, sample_weight=parts)
    far = settings.limit * usual.scale_
    scaler = MinMaxScaler((-settings.limit, settings.limit), clip=True)
    scaler.fit(np.stack([usual.mean_ - far, usual.mean_ + far]))
    drawn = np.random.default_rng(settings.seed).choice(
        len(features),
        min(int(np.count_nonzero(parts)), settings.landmarks),
        replace=False,
        p=parts / parts.sum(),
    )
    nystroem = Nystroem(
        gamma=settings.gamma / features.shape[1],
        n_components=len(drawn),
        random_state=settings.seed,
    )
    nystroem.fit(scaler.transform(features[drawn]))
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


def in_parts(function: Callable[[F64], F64], features: F64, rows: I64) -> F64:
    """A function of features, row by row, of some rows of a table; so many rows at a time."""
    parts = np.split(rows, range(_AT_ONCE, len(rows), _AT_ONCE))
    return np.concatenate([np.asarray(function(features[part]), np.float64) for part in parts])


def linear_model(
    pipeline: Pipeline, classes: tuple[str, ...], obstacle: tuple[bool, ...]
) -> LinearModel:
    """The same model with scaler and map folded in and thresholds of 0."""
    outputs = len(pipeline.named_steps["svc"].coef_)
    return LinearModel.from_pipeline(pipeline, np.zeros(outputs), classes, obstacle)
