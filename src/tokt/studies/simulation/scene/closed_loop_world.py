"""The world of the closed loop: obstacles that stand in water, fish and dust that are none.

World axes are metres: x to the right (east), y down, z ahead (north); a tower's own coordinates
where it stands at the origin unturned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .fish_and_dust import DustCloud, School
from .surfaces import Surfaces
from .tower import Cuboid, Frustum, Stalk, Tower, panels, upright
from .water import Water

Float = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Placed:
    """Something solid at its place.

    Attributes
    ----------
    shape : Tower
        Solids, stalks and texture, already turned about the vertical through their origin.
    at : (3,) array
        Where that origin is at 0 s, in world coordinates.
    drift : (3,) array
        m/s; zero for what stands on the sea floor.
    """

    shape: Tower
    at: Float
    drift: Float

    @classmethod
    def put(
        cls, shape: Tower, at: Triple, turn_rad: float = 0.0, drift: Triple = (0.0, 0.0, 0.0)
    ) -> Placed:
        """`shape` at a place, turned clockwise seen from above."""
        return cls(turned(shape, turn_rad), np.array(at, np.float64), np.array(drift, np.float64))

    @cached_property
    def surfaces(self) -> Surfaces:
        """Its solids and what grows on them, in arrays."""
        return Surfaces.of([self.shape])

    def origin(self, t_s: float) -> Float:
        """Where the shape's origin is at a time."""
        return self.at + t_s * self.drift


@dataclass(frozen=True, eq=False)
class World:
    """Everything to see and to hit.

    Attributes
    ----------
    current : (3,) tuple
        m/s; carries the marine snow.
    seed : int
        Of snow, noise and the water's unevenness.
    """

    water: Water
    things: tuple[Placed, ...] = ()
    fish: School | None = None
    dust: tuple[DustCloud, ...] = ()
    seed: int = 0
    current: Triple = (0.0, 0.0, 0.0)

    def clearance_m(self, points: Float, t_s: float = 0.0) -> Float:
        """Distance of points from the nearest solid.

        Fish, dust and snow are no solids, nor is what grows on a tower (stalks under 0.1 m).

        Parameters
        ----------
        points : (n, 3) array
            World coordinates, metres.

        Returns
        -------
        numpy.ndarray
            float64, (n,): metres, exact; 0 on and in a solid, infinite in an empty world.
        """
        points = np.asarray(points, np.float64)
        nearest = np.full(len(points), np.inf)
        for thing in self.things:
            there = thing.surfaces.distance_m(points - thing.origin(t_s))
            np.minimum(nearest, there, out=nearest)
        return nearest


def one_tower(
    rng: np.random.Generator, at: Triple = (0.0, 0.0, 0.0), drift: Triple = (0.0, 0.0, 0.0)
) -> Placed:
    """A tower as those of simulated missions; `at` is its mast at the height of the collar."""
    return Placed.put(Tower.draw(rng), at, drift=drift)


def wall(
    rng: np.random.Generator,
    at: Triple,
    *,
    width_m: float = 3.0,
    height_m: float = 3.0,
    turn_rad: float = 0.0,
) -> Placed:
    """An upright panel centred at `at`, across the z axis where it is not turned."""
    return Placed.put(panels(rng, [(0.0, 0.0, 0.0, width_m)], height_m), at, turn_rad)


def trap(
    rng: np.random.Generator,
    at: Triple,
    *,
    width_m: float = 3.0,
    depth_m: float = 3.0,
    height_m: float = 3.0,
    turn_rad: float = 0.0,
) -> Placed:
    """Three panels round a dead end that opens towards -z; `at` is the centre of the back panel.

    The trap of the thesis's figure 6.2.
    """
    half = width_m / 2
    plan = [
        (0.0, 0.0, 0.0, width_m),
        (-half, -depth_m / 2, np.pi / 2, depth_m),
        (half, -depth_m / 2, np.pi / 2, depth_m),
    ]
    return Placed.put(panels(rng, plan, height_m), at, turn_rad)


def turned(shape: Tower, turn_rad: float) -> Tower:
    """A shape turned about the vertical through its origin, clockwise seen from above."""
    if turn_rad == 0:
        return shape
    turn = upright(-turn_rad)

    def solid(one: Frustum | Cuboid) -> Frustum | Cuboid:
        if isinstance(one, Frustum):
            return replace(one, start=turn @ one.start, end=turn @ one.end)
        return replace(one, centre=turn @ one.centre, axes=one.axes @ turn.T)

    def stalk(one: Stalk) -> Stalk:
        return replace(one, root=turn @ one.root, tip=turn @ one.tip)

    return replace(
        shape, solids=tuple(map(solid, shape.solids)), stalks=tuple(map(stalk, shape.stalks))
    )
