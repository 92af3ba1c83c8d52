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
from .water import Water

Triple = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Placed:
    """Something solid at its place.

    Attributes
    ----------
    shape : Tower
        Solids, stalks and texture.
    at : (3,) tuple
        Where their origin is in world coordinates.
    """

    shape: Tower
    at: Triple

    @cached_property
    def surfaces(self) -> Surfaces:
        """Its solids and what grows on them, in arrays."""
        return Surfaces([self.shape])


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

    def clearance_m(self, points: F64) -> F64:
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
            np.minimum(nearest, thing.surfaces.distance_m(points - thing.at), out=nearest)
        return nearest


def one_tower(rng: np.random.Generator, at: Triple = (0.0, 0.0, 0.0)) -> Placed:
    """A tower as those of simulated missions; `at` is its mast at the height of the collar."""
    return Placed(Tower.draw(rng), at)


def trap(
    rng: np.random.Generator,
    at: Triple,
    *,
    width_m: float = 3.0,
    depth_m: float = 3.0,
    height_m: float = 3.0,
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
