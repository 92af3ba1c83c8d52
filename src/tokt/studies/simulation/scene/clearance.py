"""Distances from points to solids, exact for truncated cones and cuboids."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .tower import Cuboid, Frustum

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Solids:
    """Solids side by side in arrays: a control loop asks 20 times a second.

    Parameters
    ----------
    start, axis : (m, 3) arrays
        Of the truncated cones: where they begin, and their unit vectors.
    rims : (m, 2, 2) array
        Radius and place along the axis of their two rims, metres.
    centre, half : (k, 3) arrays
        Of the cuboids.
    turn : (k, 3, 3) array
        Their axes as rows.
    """

    start: Float
    axis: Float
    rims: Float
    centre: Float
    half: Float
    turn: Float

    @classmethod
    def of(cls, solids: Iterable[Frustum | Cuboid]) -> Solids:
        """These solids."""
        all_ = list(solids)
        cones = [solid for solid in all_ if isinstance(solid, Frustum)]
        boxes = [solid for solid in all_ if isinstance(solid, Cuboid)]
        rims = [((one.start_radius, 0.0), (one.end_radius, one.length)) for one in cones]
        return cls(
            np.array([one.start for one in cones]).reshape(-1, 3),
            np.array([one.frame()[1] for one in cones]).reshape(-1, 3),
            np.array(rims).reshape(-1, 2, 2),
            np.array([box.centre for box in boxes]).reshape(-1, 3),
            np.array([box.half for box in boxes]).reshape(-1, 3),
            np.array([box.axes for box in boxes]).reshape(-1, 3, 3),
        )

    def distance_m(self, points: Float) -> Float:
        """Distance of points from the nearest of the solids.

        Parameters
        ----------
        points : (n, 3) array
            In the solids' coordinates, metres.

        Returns
        -------
        numpy.ndarray
            float64, (n,): metres, exact; 0 on and in a solid, infinite where there is none.
        """
        both = np.concatenate([self._to_cones(points), self._to_boxes(points)], axis=1)
        return np.asarray(both.min(axis=1, initial=np.inf), np.float64)

    def _to_boxes(self, points: Float) -> Float:
        off = points[:, None] - self.centre
        outside = np.abs(np.einsum("kij,nkj->nki", self.turn, off)) - self.half
        return np.asarray(np.linalg.norm(outside.clip(0), axis=2))

    def _to_cones(self, points: Float) -> Float:
        """In the plane through the axis and the point a cone is a trapezium, half of it enough."""
        from_start = points[:, None] - self.start
        along = np.einsum("nmi,mi->nm", from_start, self.axis)
        radius = np.linalg.norm(from_start - along[..., None] * self.axis, axis=2)
        where = np.stack([radius, along], axis=2)
        first, last = self.rims[:, 0], self.rims[:, 1]
        on_axis = [rim * [0.0, 1.0] for rim in (first, last)]
        distance = _to_segments(where, first, last)
        for rim, middle in zip((first, last), on_axis, strict=True):
            np.minimum(distance, _to_segments(where, middle, rim), out=distance)
        share = along / last[:, 1]
        widest = first[:, 0] + share * (last[:, 0] - first[:, 0])
        inside = (share >= 0) & (share <= 1) & (radius <= widest)
        return np.asarray(np.where(inside, 0.0, distance))


def _to_segments(points: Float, start: Float, end: Float) -> Float:
    """(n, m): from points (n, m, 2) to each one's segment, (m, 2) to (m, 2)."""
    step = end - start
    off = points - start
    length = np.maximum((step * step).sum(axis=1), 1e-18)
    share = ((off * step).sum(axis=2) / length).clip(0, 1)
    return np.asarray(np.linalg.norm(off - share[..., None] * step, axis=2))
