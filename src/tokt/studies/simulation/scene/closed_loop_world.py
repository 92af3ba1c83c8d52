"""The world of the closed loop: obstacles that stand in water, fish and dust that are none.

World axes are metres: x to the right (east), y down, z ahead (north); a tower's own coordinates
where it stands at the origin.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tokt.features.common.arrays import F64

from .fish_and_dust import DustCloud, School
from .surfaces import Surfaces
from .tower import Tower, panels
from .water import Triple, Water


@dataclass(frozen=True, eq=False)
class Placed:
    """Something solid at its place: where its origin is in world coordinates."""

    shape: Tower
    at: Triple

    @cached_property
    def surfaces(self) -> Surfaces:
        """Its solids and what grows on them, in arrays."""
        return Surfaces([self.shape])


@dataclass(frozen=True, eq=False)
class World:
    """Everything to see and to hit."""

    water: Water
    things: tuple[Placed, ...] = ()
    fish: School | None = None
    dust: tuple[DustCloud, ...] = ()
    seed: int = 0  # of snow, noise and the water's unevenness
    current: Triple = (0.0, 0.0, 0.0)  # m/s; carries the marine snow

    def clearance_m(self, points: F64) -> F64:
        """(n,) exact metres from world points (n, 3) to the nearest solid; 0 on and in it.

        Fish, dust and snow are no solids, nor is what grows on a tower (stalks under 0.1 m).
        Infinite in an empty world.
        """
        nearest = np.full(len(points), np.inf)
        for thing in self.things:
            np.minimum(nearest, thing.surfaces.distance_m(points - thing.at), out=nearest)
        return nearest


def one_tower(rng: np.random.Generator, at: Triple = (0.0, 0.0, 0.0)) -> Placed:
    """A tower as those of simulated missions; `at` is its mast at the height of the collar."""
    return Placed(Tower.draw(rng), at)


def trap(
    rng: np.random.Generator, at: Triple, width_m: float, depth_m: float, height_m: float = 3.0
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
    return Placed(panels(rng, plan, height_m), at)
