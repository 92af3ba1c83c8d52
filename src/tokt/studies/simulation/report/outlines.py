"""Outlines of the solids of a world, seen from above: for maps."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.closed_loop_world import World
from tokt.studies.simulation.scene.tower import Cuboid, Frustum

Float = NDArray[np.float64]

_POINTS = 24
_CORNERS = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], np.float64)


def outlines(world: World, t_s: float = 0.0) -> list[Float]:
    """The outline of each solid from above: its convex hull.

    Parameters
    ----------
    t_s : float
        When, in seconds.

    Returns
    -------
    list of numpy.ndarray
        float64, (n, 2): east and north in metres.
    """
    found = []
    for thing in world.things:
        for solid in thing.shape.solids:
            points = (thing.origin(t_s) + _corners(solid))[:, [0, 2]].astype(np.float32)
            found.append(np.asarray(cv2.convexHull(points)[:, 0], np.float64))
    return found


def _corners(solid: Frustum | Cuboid) -> Float:
    """Points whose convex hull is the solid's, but for the roundness of its rims."""
    if isinstance(solid, Cuboid):
        return np.asarray(solid.centre + (_CORNERS * solid.half) @ solid.axes, np.float64)
    side, _, other = solid.frame()
    angles = np.arange(_POINTS) * 2 * np.pi / _POINTS
    ring = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), other)
    ends = ((solid.start, solid.start_radius), (solid.end, solid.end_radius))
    return np.concatenate([centre + radius * ring for centre, radius in ends])
