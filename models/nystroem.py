"""Nystroem's map: features of a patch as its likeness to landmarks, before the linear model."""

from dataclasses import dataclass

import numpy as np

from tokt.features.common.arrays import F64

FAR = 6.0
"""Standard deviations beyond which a feature is as far off as can be."""


@dataclass(frozen=True)
class NystroemMap:
    """Scaled and limited features, compared with landmarks by a radial basis function.

    A feature x becomes ``z = clip(x * scale + offset, -limit, limit)``, and a patch its likeness
    ``exp(-gamma |z - landmark|^2)`` to each landmark. The square root of the landmarks' own kernel
    is folded into the linear model's weights.

    Williams, Seeger (2001), "Using the Nystroem method to speed up kernel machines", NIPS;
    `sklearn.kernel_approximation.Nystroem`.
    """

    scale: F64  # (dim,)
    offset: F64  # (dim,)
    limit: float  # in standard deviations: what lies farther out is as good as this far
    landmarks: F64  # (n_landmarks, dim), within the limit
    gamma: float

    def __post_init__(self) -> None:
        if self.landmarks.ndim != 2 or not self.landmarks.size:
            raise ValueError(f"landmarks of shape {self.landmarks.shape}")
        if not self.scale.shape == self.offset.shape == (self.dim,):
            raise ValueError("one scale and one offset a feature are needed")
        for array in (self.scale, self.offset, self.landmarks):
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise ValueError("scale, offset and landmarks are finite float64")
        if not 0 < self.limit < np.inf or not 0 < self.gamma < np.inf:
            raise ValueError(f"limit {self.limit!r}, gamma {self.gamma!r}")
        if np.abs(self.landmarks).max() > self.limit:
            raise ValueError("a landmark is beyond the limit")

    @property
    def dim(self) -> int:
        """Number of features a patch must have."""
        return int(self.landmarks.shape[1])

    def likeness(self, features: F64) -> F64:
        """Likeness to each landmark, 0 to 1, shape (n, n_landmarks), of features (n, dim).

        Raises ValueError if a feature is not finite: the limit would make a number of it.
        """
        if not np.isfinite(features).all():
            raise ValueError("a feature is not finite")
        squares = self._squares(self._scaled(features, self.limit))
        squares *= -self.gamma
        return np.asarray(np.exp(squares, out=squares))

    def distance(self, features: F64) -> F64:
        """How far each patch is from the nearest landmark, shape (n,), of features (n, dim).

        The root of the mean square over the features, in standard deviations; a feature counts
        up to `FAR` of them.
        """
        nearest = self._squares(self._scaled(features, max(FAR, self.limit))).min(axis=1)
        return np.asarray(np.sqrt(nearest / self.dim))

    def _scaled(self, features: F64, limit: float) -> F64:
        with np.errstate(over="ignore"):  # limited
            return np.asarray(np.clip(features * self.scale + self.offset, -limit, limit))

    def _squares(self, scaled: F64) -> F64:
        """Squared distance to each landmark."""
        squares = (scaled**2).sum(axis=1)[:, None] + (self.landmarks**2).sum(axis=1)
        squares -= 2 * (scaled @ self.landmarks.T)
        return np.asarray(np.maximum(squares, 0, out=squares))
