"""The solids of a world, their materials and textures, in arrays: ready for a camera's rays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tokt.features.common.arrays import F32, F64, I64

from .fish_and_dust import FISH
from .tower import GROWTH, NO_STALKS, RIM_POINTS, TEXEL_M, Cuboid, Frustum, Material, Tower

Texture = tuple[F32, ...]
"""Levels of (size, size, 2) brightness and rust, each at half the detail of the one before."""

_LEVELS = 5
STALK_MATERIAL, FISH_MATERIAL = 0, 1


class Frusta:
    """Truncated cones; the axes' second row runs along the cone, from start to end.

    `thing` is the number of the placed thing whose origin the coordinates are about.
    """

    def __init__(self, solids: Sequence[Frustum], thing: I64, material_number: I64) -> None:
        self.start = np.array([solid.start for solid in solids]).reshape(-1, 3)
        self.axes = np.array([solid.frame() for solid in solids]).reshape(-1, 3, 3)
        self.length = np.array([solid.length for solid in solids])
        self.radius = np.array([solid.start_radius for solid in solids])
        self.end_radius = np.array([solid.end_radius for solid in solids])
        self.slope = (self.end_radius - self.radius) / self.length
        self.hull = np.array([solid.hull() for solid in solids]).reshape(-1, 2 * RIM_POINTS, 3)
        self.thing, self.material_number = thing, material_number

    def distances_m(self, points: F64) -> F64:
        """(n, m): from each of points (n, 3) to each cone; 0 in it.

        In the plane through the axis and the point a cone is a trapezium, half of it enough.
        """
        axis = self.axes[:, 1]
        from_start = points[:, None] - self.start
        along = np.einsum("nmi,mi->nm", from_start, axis)
        off_axis = np.linalg.norm(from_start - along[..., None] * axis, axis=2)
        where = np.stack([off_axis, along], axis=2)
        first = np.stack([self.radius, np.zeros_like(self.radius)], axis=1)
        last = np.stack([self.end_radius, self.length], axis=1)
        distance = _to_segments(where, first, last)
        for rim in (first, last):
            np.minimum(distance, _to_segments(where, rim * [0.0, 1.0], rim), out=distance)
        share = along / self.length
        widest = self.radius + share * (self.end_radius - self.radius)
        inside = (share >= 0) & (share <= 1) & (off_axis <= widest)
        return np.asarray(np.where(inside, 0.0, distance))


def _to_segments(points: F64, start: F64, end: F64) -> F64:
    """(n, m): from points (n, m, 2) to each one's segment, (m, 2) to (m, 2)."""
    step = end - start
    off = points - start
    length = np.maximum((step * step).sum(axis=1), 1e-18)
    share = ((off * step).sum(axis=2) / length).clip(0, 1)
    return np.asarray(np.linalg.norm(off - share[..., None] * step, axis=2))


class Boxes:
    """Cuboids: centre, orthonormal axes as rows, half sizes."""

    def __init__(self, solids: Sequence[Cuboid], thing: I64, material_number: I64) -> None:
        self.centre = np.array([solid.centre for solid in solids]).reshape(-1, 3)
        self.axes = np.array([solid.axes for solid in solids]).reshape(-1, 3, 3)
        self.half = np.array([solid.half for solid in solids]).reshape(-1, 3)
        self.thing, self.material_number = thing, material_number

    def distances_m(self, points: F64) -> F64:
        """(n, m): from each of points (n, 3) to each box; 0 in it."""
        off = points[:, None] - self.centre
        outside = np.abs(np.einsum("kij,nkj->nki", self.axes, off)) - self.half
        return np.asarray(np.linalg.norm(outside.clip(0), axis=2))


class Stalks:
    """Lines from root to tip (n, 2, 3), each with the number of the thing that it grows on."""

    def __init__(self, shapes: Sequence[Tower]) -> None:
        stalks = np.concatenate([NO_STALKS, *(shape.stalks for shape in shapes)])
        self.ends = stalks[:, :6].reshape(-1, 2, 3)
        self.half_width, self.brightness = stalks[:, 6:].T
        self.thing = np.repeat(np.arange(len(shapes)), [len(shape.stalks) for shape in shapes])


class Surfaces:
    """All that is solid to look at and stays in its place: solids and stalks of placed things."""

    def __init__(self, shapes: Sequence[Tower]) -> None:
        placed = [(solid, thing) for thing, shape in enumerate(shapes) for solid in shape.solids]
        own = [(solid.material, thing + 1) for solid, thing in placed]
        # By number, with the number of its texture: 0 is the fishes', then each thing's own.
        self.materials = list(dict.fromkeys([(GROWTH, 0), (FISH, 0), *own]))

        def numbered(kind: type) -> tuple[list[Any], I64, I64]:
            """Solids of a kind, each with the numbers of its thing and of its material."""
            chosen = [(solid, thing) for solid, thing in placed if isinstance(solid, kind)]
            things = np.array([thing for _, thing in chosen], np.int64)
            numbers = [self.materials.index((one.material, thing + 1)) for one, thing in chosen]
            return [solid for solid, _ in chosen], things, np.array(numbers, np.int64)

        self.frusta = Frusta(*numbered(Frustum))
        self.boxes = Boxes(*numbered(Cuboid))
        self.stalks = Stalks(shapes)

    def distance_m(self, points: F64) -> F64:
        """(n,): metres from points (n, 3) to the nearest solid; see `World.clearance_m`."""
        both = [self.frusta.distances_m(points), self.boxes.distances_m(points)]
        return np.asarray(np.concatenate(both, axis=1).min(axis=1, initial=np.inf), np.float64)


class Materials:
    """Materials with their textures' numbers, and the textures; material 0 has no texture."""

    def __init__(
        self, materials: Sequence[tuple[Material, int]], textures: Sequence[Texture]
    ) -> None:
        paint = np.array([material.paint for material, _ in materials], np.float64)
        rust = np.array([material.rust for material, _ in materials], np.float64)
        rusted = np.array([material.rusted for material, _ in materials], np.float64)
        levels = [level for texture in textures for level in texture]
        sizes = np.array([len(level) for level in levels], np.int64)
        # (3, materials): albedo of the paint, and what full rust adds to it.
        self.paint = np.ascontiguousarray(paint.T, np.float32)
        self.rust = np.ascontiguousarray(((rust - paint) * rusted[:, None]).T, np.float32)
        self.texture = np.array([texture for _, texture in materials], np.int64)
        # Every level of every texture, row by row; (textures, levels): a level's texels along
        # its side, and its first.
        self.texels = np.concatenate([level.reshape(-1, 2) for level in levels])
        self.size = sizes.reshape(-1, _LEVELS)
        self.first = (np.cumsum(sizes**2) - sizes**2).reshape(-1, _LEVELS)

    def look_up(
        self, material_number: I64, across: F32, along: F32, pixel_m: F32
    ) -> tuple[F32, F32]:
        """Brightness and rust at surface coordinates (m), read at the level of a pixel's size."""
        level = (np.frexp(pixel_m * np.float32(1 / TEXEL_M))[1] - 1).clip(0, _LEVELS - 1)
        texel = np.ldexp(np.float32(1 / TEXEL_M), -level)
        which = self.texture.take(material_number) * _LEVELS + level
        inside = self.size.take(which) - 1
        column = np.floor(across * texel).astype(np.int64) & inside
        row = np.floor(along * texel).astype(np.int64) & inside
        row *= inside + 1
        row += column
        row += self.first.take(which)
        found = self.texels.take(row, axis=0)
        return found[:, 0], found[:, 1].copy()
