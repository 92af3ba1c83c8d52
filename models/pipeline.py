"""A fitted scikit-learn pipeline (optional scaler, LinearSVC) as a `LinearModel`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .linear import LinearModel


def linear_model_from(
    pipeline: Any,
    thresholds: NDArray[np.float64],
    classes: tuple[str, ...],
    obstacle: tuple[bool, ...],
) -> LinearModel:
    """Fold the pipeline's scaler into its classifier.

    Parameters
    ----------
    pipeline : sklearn.pipeline.Pipeline
        With a step ``svc`` and, where features are scaled, a step ``scaler``. Only its fitted
        arrays are read: scikit-learn need not be there.
    thresholds, classes, obstacle
        As in `LinearModel`.
    """
    svc, scaler = pipeline.named_steps["svc"], pipeline.named_steps.get("scaler")
    dim = svc.coef_.shape[1]
    return LinearModel.fold(
        svc.coef_,
        svc.intercept_,
        np.zeros(dim) if scaler is None else scaler.mean_,
        np.ones(dim) if scaler is None else scaler.scale_,
        thresholds,
        classes,
        obstacle,
    )
