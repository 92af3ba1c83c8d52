"""A cloud of stirred-up sediment: it drifts, spreads and settles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Puffs:
    """A cloud at one moment: round puffs whose density falls off as a Gaussian.

    Attributes
    ----------
    centre : (n, 3) array
        World coordinates, m.
    size : (n,) array
        Standard deviation, m.
    density : (n,) array
        Attenuation in the middle, 1/m.
    """

    centre: Float
    size: Float
    density: Float


@dataclass(frozen=True, eq=False)
class DustCloud:
    """A cloud of puffs.

    Attributes
    ----------
    start : Puffs
        The cloud at 0 s.
    drift : (3,) array
        m/s.
    spreading : float
        m^2/s: how fast the square of a puff's size grows; its sediment is spread ever thinner.
    settles_s : float
        Time in which all but 1/e of the sediment has sunk out of sight.
    """

    start: Puffs
    drift: Float
    spreading: float
    settles_s: float

    @classmethod
    def draw(
        cls,
        rng: np.random.Generator,
        at: Triple,
        *,
        radius_m: float = 1.0,
        density: float = 1.0,
        drift: Triple = (0.0, 0.0, 0.0),
        spreading: float = 0.004,
        settles_s: float = 90.0,
        count: int = 20,
    ) -> DustCloud:
        """A cloud about a place at 0 s; `density` (1/m) is about that of its middle."""
        size = radius_m * rng.uniform(0.15, 0.5, count)
        centre = np.array(at) + radius_m * rng.normal(0.0, [0.6, 0.4, 0.6], (count, 3))
        puffs = Puffs(centre, size, density * rng.uniform(0.2, 0.8, count))
        return cls(puffs, np.array(drift, np.float64), spreading, settles_s)

    def at(self, t_s: float) -> Puffs:
        """The cloud at a time from 0 s on."""
        size = np.sqrt(self.start.size**2 + self.spreading * t_s)
        thinned = (self.start.size / size) ** 3 * np.exp(-t_s / self.settles_s)
        return Puffs(self.start.centre + t_s * self.drift, size, self.start.density * thinned)
