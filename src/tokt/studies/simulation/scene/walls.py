"""Upright panels, rusty and overgrown: walls of a dead end."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from .tower import Cuboid, Material, Stalk, Tower, surface_textures

_THICKNESS_M = 0.12
_STALKS_PER_M2 = 25
PANEL = Material((0.50, 0.50, 0.46), rust=(0.16, 0.26, 0.34), rusted=0.8)


def panels(
    rng: np.random.Generator, plan: Iterable[tuple[float, float, float, float]], height_m: float
) -> Tower:
    """Panels of one height about y = 0.

    Parameters
    ----------
    plan : iterable of (x, z, turn_rad, width_m)
        Centre of each panel, and its turn from lying across the z axis.
    """
    solids, stalks = [], []
    for x, z, turn, width in plan:
        cos, sin = np.cos(turn), np.sin(turn)
        axes = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        half = np.array([width, height_m, _THICKNESS_M]) / 2
        panel = Cuboid(np.array([x, 0.0, z]), axes, half, PANEL)
        solids.append(panel)
        stalks += _growth(rng, panel)
    return Tower(tuple(solids), tuple(stalks), surface_textures(rng))


def _growth(rng: np.random.Generator, panel: Cuboid) -> list[Stalk]:
    """Stalks on both faces of a panel."""
    count = int(2 * _STALKS_PER_M2 * 4 * panel.half[0] * panel.half[1])
    face = rng.choice([-1.0, 1.0], count)
    place = rng.uniform(-1.0, 1.0, (count, 2)) * panel.half[:2]
    roots = np.column_stack([place, face * panel.half[2]])
    directions = np.column_stack([np.zeros((count, 2)), face]) + rng.normal(0.0, 0.35, (count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tips = roots + 0.06 * rng.uniform(0.3, 1.0, (count, 1)) * directions
    width, bright = rng.uniform(0.0015, 0.005, count), rng.uniform(0.6, 1.7, count)

    def world(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(panel.centre + points @ panel.axes)

    return [
        Stalk(root, tip, float(w), float(b))
        for root, tip, w, b in zip(world(roots), world(tips), width, bright, strict=True)
    ]
