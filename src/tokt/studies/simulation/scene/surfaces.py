"""The solids of a world in arrays, ready for the rays of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .fish import FISH, fish_texture
from .materials import Materials, Texture
from .tower import GROWTH, Cuboid, Frustum, Material

if TYPE_CHECKING:
    from .closed_loop_world import World

Float = NDArray[np.float64]
Index = NDArray[np.int64]

_HULL_POINTS = 16
STALK_MATERIAL, FISH_MATERIAL = 0, 1


@dataclass(frozen=True, eq=False)
class Frusta:
    """Truncated cones; the axes' second row runs along the cone, from start to end.

    `thing` is the number of the placed thing whose origin the coordinates are about.
    """

    start: Float
    axes: Float
    length: Float
    radius: Float
    slope: Float
    end_radius: Float
    hull: Float
    thing: Index
    material_number: Index


@dataclass(frozen=True, eq=False)
class Boxes:
    """Cuboids, or the ellipsoids in them: centre, orthonormal axes as rows, half sizes."""

    centre: Float
    axes: Float
    half: Float
    thing: Index
    material_number: Index


@dataclass(frozen=True, eq=False)
class Stalks:
    """Lines from root to tip (n, 2, 3)."""

    ends: Float
    half_width: Float
    brightness: Float
    thing: Index


@dataclass(frozen=True, eq=False)
class Surfaces:
    """All that is solid to look at and stays in its place."""

    frusta: Frusta
    boxes: Boxes
    stalks: Stalks
    materials: Materials

    @classmethod
    def of(cls, world: World) -> Surfaces:
        """The things of a world; the materials are its fishes' too."""
        materials = _MaterialList(world)
        frusta: list[tuple[int, Frustum]] = []
        boxes: list[tuple[int, Cuboid]] = []
        for number, thing in enumerate(world.things):
            for solid in thing.shape.solids:
                if isinstance(solid, Frustum):
                    frusta.append((number, solid))
                else:
                    boxes.append((number, solid))
        stalks = [
            (number, stalk)
            for number, thing in enumerate(world.things)
            for stalk in thing.shape.stalks
        ]
        return cls(
            _frusta(frusta, materials),
            Boxes(
                _vectors([box.centre for _, box in boxes]),
                np.array([box.axes for _, box in boxes]).reshape(-1, 3, 3),
                _vectors([box.half for _, box in boxes]),
                _numbers([number for number, _ in boxes]),
                _numbers([materials.of(box.material, number) for number, box in boxes]),
            ),
            Stalks(
                np.array([(stalk.root, stalk.tip) for _, stalk in stalks]).reshape(-1, 2, 3),
                np.array([stalk.half_width for _, stalk in stalks]),
                np.array([stalk.brightness for _, stalk in stalks]),
                _numbers([number for number, _ in stalks]),
            ),
            Materials.of(materials.materials, materials.textures),
        )


class _MaterialList:
    """Numbers each material of each thing as it comes up."""

    def __init__(self, world: World) -> None:
        rng = np.random.default_rng([world.seed, 2])
        self.textures: list[Texture] = [fish_texture(rng)]
        self.textures += [thing.shape.textures for thing in world.things]
        self.materials: list[tuple[Material, int]] = [(GROWTH, 0), (FISH, 0)]

    def of(self, material: Material, thing: int) -> int:
        material_number = (material, thing + 1)
        if material_number not in self.materials:
            self.materials.append(material_number)
        return self.materials.index(material_number)


def _frusta(solids: list[tuple[int, Frustum]], materials: _MaterialList) -> Frusta:
    angles = np.arange(_HULL_POINTS) * 2 * np.pi / _HULL_POINTS
    hulls = []
    for _, solid in solids:
        side, _, other = solid.frame()
        ring = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), other)
        ring /= np.cos(np.pi / _HULL_POINTS)
        hulls.append([solid.start + solid.start_radius * ring, solid.end + solid.end_radius * ring])
    length = np.array([solid.length for _, solid in solids])
    start_radius = np.array([solid.start_radius for _, solid in solids])
    end_radius = np.array([solid.end_radius for _, solid in solids])
    return Frusta(
        _vectors([solid.start for _, solid in solids]),
        np.array([solid.frame() for _, solid in solids]).reshape(-1, 3, 3),
        length,
        start_radius,
        (end_radius - start_radius) / length,
        end_radius,
        np.array(hulls).reshape(-1, 2 * _HULL_POINTS, 3),
        _numbers([number for number, _ in solids]),
        _numbers([materials.of(solid.material, number) for number, solid in solids]),
    )


def _vectors(values: Sequence[Float]) -> Float:
    return np.array(values, np.float64).reshape(-1, 3)


def _numbers(values: Sequence[int]) -> Index:
    return np.array(values, np.int64)
