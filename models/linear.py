"""The linear model: one matrix product from features to decision values, two with a map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, I64, Bools

from .nystroem import NystroemMap


@dataclass(frozen=True)
class LinearModel:
    """Weights with the scaler folded in, the thresholds, and which classes are obstacles.

    With two classes there is one output: the decision value of the second class against the
    first; if just one of them is an obstacle it is the second. With more classes there is one
    output a class (one against the rest).
    """

    weights: F64  # (n_outputs, dim); with a map (n_outputs, n_landmarks)
    bias: F64  # (n_outputs,)
    # (n_outputs,): a decision value must exceed its threshold for a patch to be of that class; with
    # several classes the largest excess wins.
    thresholds: F64
    classes: tuple[str, ...]  # two names for one output, otherwise one name an output
    obstacle: tuple[bool, ...]  # for each class whether a patch of it is an obstacle
    map: NystroemMap | None = None  # what the features go through first

    def __post_init__(self) -> None:
        outputs, dim = self.weights.shape if self.weights.ndim == 2 else (0, 0)
        expected = 2 if outputs == 1 else outputs
        if outputs < 1 or dim < 1 or len(self.classes) != expected:
            raise ValueError(f"{self.weights.shape} weights do not fit classes {self.classes}")
        if self.bias.shape != (outputs,) or self.thresholds.shape != (outputs,):
            raise ValueError("one bias and one threshold an output are needed")
        if len(self.obstacle) != len(self.classes) or len(set(self.classes)) != len(self.classes):
            raise ValueError("each class needs a name of its own and one obstacle flag")
        if outputs == 1 and self.obstacle == (True, False):
            raise ValueError("of two classes the obstacle comes second")
        if self.map is not None and dim != len(self.map.landmarks):
            raise ValueError(f"{dim} weights an output for {len(self.map.landmarks)} landmarks")
        for array in (self.weights, self.bias, self.thresholds):
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise ValueError("weights, bias and thresholds are finite float64")

    @classmethod
    def fold(
        cls,
        coef: F64,
        intercept: F64,
        mean: F64,
        scale: F64,
        thresholds: F64,
        classes: tuple[str, ...],
        obstacle: tuple[bool, ...],
    ) -> LinearModel:
        """Fold a scaler into a linear classifier: ``w / sigma`` and ``b - w . mu / sigma``.

        Parameters
        ----------
        coef, intercept
            Of the classifier on scaled features, shapes (n_outputs, dim) and (n_outputs,).
        mean, scale
            The scaler's mu and sigma, shape (dim,).
        thresholds, classes, obstacle
            As in `LinearModel`.
        """
        weights = np.asarray(coef / scale, np.float64)
        # Summed exactly: a library's product differs in its last bit from processor to processor,
        # and with it the hash of the bundle.
        bias = np.asarray(intercept - [math.fsum(row) for row in weights * mean], np.float64)
        return cls(weights, bias, np.asarray(thresholds, np.float64), classes, obstacle)

    @classmethod
    def from_pipeline(
        cls, pipeline: Any, thresholds: F64, classes: tuple[str, ...], obstacle: tuple[bool, ...]
    ) -> LinearModel:
        """A fitted scikit-learn pipeline, its scaler folded into its classifier.

        Parameters
        ----------
        pipeline : sklearn.pipeline.Pipeline
            With a step ``svc`` and, where features are scaled, a step ``scaler``; between the two
            there may be a Nystroem ``map``. Only its fitted arrays are read: scikit-learn need not
            be there.
        thresholds, classes, obstacle
            As in `LinearModel`.
        """
        svc, scaler = pipeline.named_steps["svc"], pipeline.named_steps.get("scaler")
        if (nystroem := pipeline.named_steps.get("map")) is not None:
            limit, landmarks = float(scaler.feature_range[1]), np.array(nystroem.components_)
            scaled = scaler.scale_, scaler.min_, limit
            mapped = NystroemMap(*scaled, landmarks, float(nystroem.gamma))
            weights = np.asarray(svc.coef_ @ nystroem.normalization_, np.float64)
            return cls(weights, svc.intercept_, thresholds, classes, obstacle, mapped)
        mean, scale = np.zeros(svc.coef_.shape[1]), np.ones(svc.coef_.shape[1])
        if scaler is not None:
            mean, scale = scaler.mean_, scaler.scale_
        return cls.fold(svc.coef_, svc.intercept_, mean, scale, thresholds, classes, obstacle)

    @property
    def dim(self) -> int:
        """Number of features a patch must have."""
        return int(self.weights.shape[1]) if self.map is None else self.map.dim

    @property
    def landmarks(self) -> int:
        """How many landmarks the map has; 0 without one."""
        return 0 if self.map is None else len(self.map.landmarks)

    def decision_values(self, features: F64) -> F64:
        """Signed distances, shape (n_patches, n_outputs), of features (n_patches, dim).

        Raises ValueError if a feature is not finite: such a patch cannot be judged, and must not be
        clear.
        """
        if self.map is not None:
            features = self.map.likeness(features)
        with np.errstate(over="ignore", invalid="ignore"):  # refused below, and not warned of
            values = np.asarray(features @ self.weights.T + self.bias, np.float64)
        if not np.isfinite(values).all():
            raise ValueError("a decision value is not finite")
        return values

    def predicted(self, values: F64) -> I64:
        """Index into `classes` for each row of decision values."""
        excess = values - self.thresholds
        if excess.shape[1] == 1:
            return (excess[:, 0] > 0).astype(np.int64)
        return np.asarray(excess.argmax(axis=1), np.int64)

    def obstacle_patches(self, values: F64) -> Bools:
        """For each row of decision values whether that patch is an obstacle."""
        return np.asarray(self.obstacle, bool)[self.predicted(values)]

    @property
    def named_classes(self) -> tuple[str, ...]:
        """The classes that are told by name, obstacles first; none of a model of two.

        The first class that is no obstacle, water, is left out.
        """
        if len(self.classes) < 3:
            return ()
        both = [*zip(self.classes, self.obstacle, strict=True)]
        clear = [name for name, obstacle in both if not obstacle]
        return (*(name for name, obstacle in both if obstacle), *clear[1:])

    def class_patches(self, values: F64) -> dict[str, tuple[int, ...]]:
        """For each of `named_classes` that a row of decision values is of, these rows' numbers.

        Classes that are obstacles come first, then those of the most rows.
        """
        predicted = self.predicted(values)
        rows = {
            name: tuple(np.flatnonzero(predicted == self.classes.index(name)).tolist())
            for name in self.named_classes
        }
        obstacle = dict(zip(self.classes, self.obstacle, strict=True))
        order = sorted(rows, key=lambda name: (not obstacle[name], -len(rows[name])))
        return {name: rows[name] for name in order if rows[name]}

    def obstacle_score(self, values: F64) -> F64:
        """How far each patch is on the obstacle side; above 0 exactly where it is one.

        A tie at 0 is decided as `predicted` decides it, by the order of the classes.
        """
        return obstacle_score(values - self.thresholds, self.obstacle)


def obstacle_score(excess: F64, obstacle: Sequence[bool]) -> F64:
    """With several classes the best obstacle class's excess over the best clear one's.

    Parameters
    ----------
    excess : array of float64, shape (n_patches, n_outputs)
        Decision values over their thresholds.
    obstacle : sequence of bool
        For each class whether it is an obstacle.
    """
    flags = np.asarray(obstacle, bool)
    if flags.all() or not flags.any():
        return np.full(len(excess), np.inf if flags.all() else -np.inf)
    if excess.shape[1] == 1:
        return excess[:, 0]
    return np.asarray(excess[:, flags].max(axis=1) - excess[:, ~flags].max(axis=1))


def moved(values: F64, boundary: F64 | float, obstacle: Sequence[bool]) -> F64:
    """Decision values whose obstacle score is less by `boundary`, shape (n_patches, n_outputs).

    Parameters
    ----------
    values : array of float64, shape (n_patches, n_outputs)
    boundary : float, or array of float64, shape (n_patches, 1)
    obstacle : sequence of bool
        For each class whether it is an obstacle.
    """
    sides = np.ones(1) if values.shape[1] == 1 else np.asarray(obstacle, np.float64)
    return np.asarray(values - boundary * sides)
