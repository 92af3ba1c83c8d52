"""The world of the closed loop: obstacles that stand or move in water, fish and dust that are none.

World axes are metres: x to the right (east), y down, z ahead (north); a tower's own coordinates
where it stands at the origin.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tokt.features.common.arrays import F64

from .fish_and_dust import DustCloud, School
from .surfaces import Surfaces
from .tower import Tower
from .water import Triple, Water


@dataclass(frozen=True, eq=False)
class Placed:
    """Something solid: where its origin is at 0 s, and how it moves straight on."""

    shape: Tower
    at: Triple  # world, m
    velocity: Triple = (0.0, 0.0, 0.0)  # m/s

    def place(self, t_s: float) -> F64:
        """(3,) Where its origin is at a time, world coordinates in m."""
        return np.array(self.at) + t_s * np.array(self.velocity)

    @cached_property
    def surfaces(self) -> Surfaces:
        """Its solids and what grows on them, in arrays."""
        return Surfaces([self.shape])


@dataclass(frozen=True, eq=False)
class Floor:
    """The sea floor: even from east to west, bent along the way north."""

    north_m: tuple[float, ...]  # world z of the bends, ascending
    down_m: tuple[float, ...]  # world y of the ground there

    def altitude_m(self, position: F64) -> float:
        """How far the ground is straight below a world point, as a DVL measures it."""
        return float(np.interp(position[2], self.north_m, self.down_m) - position[1])


@dataclass(frozen=True, eq=False)
class World:
    """Everything to see and to hit."""

    water: Water
    things: tuple[Placed, ...] = ()
    fish: School | None = None
    dust: tuple[DustCloud, ...] = ()
    floor: Floor | None = None  # its ground is one of `things`
    seed: int = 0  # of snow, noise and the water's unevenness
    current: Triple = (0.0, 0.0, 0.0)  # m/s; carries the marine snow

    def clearance_m(self, points: F64, t_s: float = 0.0) -> F64:
        """(n,) exact metres from world points (n, 3) to the nearest solid; 0 on and in it.

        Fish, dust and snow are no solids, nor is what grows on a tower (stalks under 0.1 m).
        Infinite in an empty world.
        """
        nearest = np.full(len(points), np.inf)
        for thing in self.things:
            np.minimum(nearest, thing.surfaces.distance_m(points - thing.place(t_s)), out=nearest)
        return nearest
