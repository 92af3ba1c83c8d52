"""Ray casting of fish for the closed loop: ellipsoids, in the same frames as the solids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.fish import TEXTURE_M, School
from tokt.studies.simulation.scene.surfaces import FISH_MATERIAL

from .fast_raycast import CORNERS, Hits

Float = NDArray[np.float64]
Index = NDArray[np.int64]


def add_fish(hits: Hits, school: School, t_s: float) -> None:
    """Cast a camera's rays at a school where it is at a time."""
    centres, axes, half = school.shapes(t_s)
    corners = hits.standpoint.seen(centres[:, None] + (CORNERS * half[:, None]) @ axes)
    for i in hits.in_view(corners):
        pixels = hits.inside(corners[i])
        if len(pixels):
            _cast(hits, pixels, centres[i], axes[i], half[i])


def _cast(hits: Hits, pixels: Index, centre: Float, axes: Float, half: Float) -> None:
    """One ellipsoid, in units of its half sizes: there it is the unit sphere."""
    turn = axes @ hits.standpoint.rotation.T
    camera = axes @ (hits.standpoint.centre - centre)
    lamp = camera + turn @ hits.maps.lamp
    rays = (turn / half[:, None]).astype(np.float32) @ hits.maps.rays.take(pixels, axis=1)
    o = (camera / half).astype(np.float32)
    a = (rays * rays).sum(axis=0)
    cross = np.cross(o, rays, axisb=0)
    root = a - (cross * cross).sum(axis=1)
    t = (-(o @ rays) - np.sqrt(np.maximum(root, 0))) / a
    won = np.flatnonzero((root > 0) & (t > 0) & (t < hits.depth.take(pixels)))
    t = t[won]
    x, y, z = o[:, None] + t * rays[:, won]
    hx, hy, hz = half.astype(np.float32)
    normal = np.stack([x / hx, y / hy, z / hz])
    normal /= np.sqrt((normal * normal).sum(axis=0))
    to_lamp = lamp.astype(np.float32)[:, None] - np.stack([x * hx, y * hy, z * hz])
    across, along = (np.float32(TEXTURE_M / 2) * (1 + v) for v in (-x, y))
    facing = (normal * to_lamp).sum(axis=0)
    hits.paint(pixels[won], t, FISH_MATERIAL, across, along, facing)
