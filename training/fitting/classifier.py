"""The classifier of a model: an optional scaler and a LinearSVC, as scikit-learn has them."""

import warnings

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from tokt.features.common.arrays import F64, I64
from tokt.models.linear import LinearModel

from .presets import Hyperparameters, TrainingSettings


def fit_classifier(
    features: F64,
    targets: I64,
    choice: Hyperparameters,
    settings: TrainingSettings,
    weights: F64 | None = None,
    scaled_by: F64 | None = None,
) -> Pipeline:
    """Fit scaler and LinearSVC; deterministic for the same input.

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
        How much each patch's error counts.
    scaled_by : array of float64, shape (n,), optional
        How much each patch counts in the scaler's mean and variance; by default all alike.
    """
    svc = LinearSVC(
        C=choice.penalty,
        class_weight=choice.class_weight,
        random_state=settings.seed,
        dual=not settings.scale,
        max_iter=5000,
    )
    steps = [("scaler", StandardScaler())] if settings.scale else []
    pipeline = Pipeline([*steps, ("svc", svc)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        of_scaler = (
            {} if scaled_by is None or not settings.scale else {"scaler__sample_weight": scaled_by}
        )
        pipeline.fit(np.asarray(features), targets, svc__sample_weight=weights, **of_scaler)
    return pipeline


def converged(pipeline: Pipeline) -> bool:
    """Whether the solver stopped before its iteration limit."""
    svc = pipeline.named_steps["svc"]
    return bool(np.max(svc.n_iter_) < svc.max_iter)


def decision_values(pipeline: Pipeline, features: F64) -> F64:
    """The pipeline's decision function as (n, n_outputs)."""
    values = np.asarray(pipeline.decision_function(np.asarray(features)), np.float64)
    return values.reshape(len(features), -1)


def linear_model(
    pipeline: Pipeline, classes: tuple[str, ...], obstacle: tuple[bool, ...]
) -> LinearModel:
    """The same model with the scaler folded in and thresholds of 0."""
    outputs = len(pipeline.named_steps["svc"].coef_)
    return LinearModel.from_pipeline(pipeline, np.zeros(outputs), classes, obstacle)
