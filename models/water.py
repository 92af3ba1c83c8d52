"""The state of the water: a boundary between water and obstacle that moves with a run's frames.

In a water that a model never saw the order of its decision values holds better than their zero. The
values of the last frames show where water lies and where obstacles do: a mixture of two normal
distributions is fitted to them (EM), held by a prior, and the boundary goes where both are as
likely. It moves by little, and never above all patches of a view that an obstacle fills.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F64, Bools
from tokt.features.common.errors import ToktError
from tokt.features.extractors.water import SD_OF_MAD

FILLED = 0.5
"""Part of a frame's patches above 0 from which on the boundary does not rise above all of them."""
_STEP = 0.01
"""What the boundary is rounded to, so that last digits of a machine's logarithms do not show."""
_MOST_ROUNDS = 100  # in each frame: some 2 ms
_MIN_SD = 0.05
_MAX = 1e6


class _ScoreDistribution(NamedTuple):
    """A normal distribution of decision values."""

    mean: float
    sd: float


@dataclass(frozen=True)
class WaterPrior:
    """What is expected of decision values before a run's first frame, and how strongly.

    Raises ToktError if a value is not as said here.
    """

    water: float  # mean decision value of patches of water, less than that of obstacles
    obstacle: float
    water_sd: float  # their standard deviations
    obstacle_sd: float
    share: float  # of patches that are obstacles, between 0 and 1
    # Chosen with whole sites held out, for values that are logarithms of odds.
    limit: float = 2.0  # how far the boundary moves from 0 at most, 0.01 to 10
    frames: int = 5  # how many of the last frames it is found from, the newest among them
    weight: float = 0.5  # patches that the means and the share count as
    sd_weight: float = 100.0  # and the standard deviations
    rounds: int = 30  # of EM; it is slow where obstacles are faint
    # What is expected of frames without colour: obstacles stand out less there. None: the same.
    gray: WaterPrior | None = None

    def __post_init__(self) -> None:
        numbers = {each.name: getattr(self, each.name) for each in fields(self)}
        gray = numbers.pop("gray")
        if gray is not None and (type(gray) is not WaterPrior or gray.gray is not None):
            raise ToktError("a water's prior has one of gray frames, which has none")
        if gray is not None and (gray.limit, gray.frames) != (self.limit, self.frames):
            raise ToktError("a water's prior of gray frames has the same limit and frames")
        for name, value in numbers.items():
            known = (int,) if name in ("frames", "rounds") else (int, float)
            if type(value) not in known or not abs(value) <= _MAX:
                raise ToktError(f"{name} of a water's prior is {value!r}")
        sds = min(self.water_sd, self.obstacle_sd)
        bounded = 0.01 <= self.limit <= 10 and min(self.weight, self.sd_weight) > 0
        if not (self.water < self.obstacle and sds >= _MIN_SD and 0 < self.share < 1):
            raise ToktError("a water's prior tells two normal distributions apart")
        if not (bounded and 1 <= self.frames <= 60 and 1 <= self.rounds <= _MOST_ROUNDS):
            raise ToktError("a water's prior has positive bounds, 1 to 60 frames, 1 to 100 rounds")

    @classmethod
    def of(cls, scores: F64, obstacle: Bools, dive: NDArray[Any]) -> WaterPrior | None:
        """The prior that held-out patches give: medians, each dive counting the same.

        Parameters
        ----------
        scores : array of float64, shape (n,)
            Obstacle scores of patches that were held out.
        obstacle : array of bool, shape (n,)
        dive : array, shape (n,)

        Returns
        -------
        WaterPrior or None
            None where the patches do not tell water and obstacles apart.
        """
        found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
        shares = []
        for name in np.unique(dive):
            mine = dive == name
            shares.append(obstacle[mine].mean())
            for side, known in found.items():
                values = scores[mine & (obstacle == side)]
                if len(values):
                    middle = float(np.median(values))
                    spread = SD_OF_MAD * float(np.median(np.abs(values - middle)))
                    known.append((middle, spread))
        share = float(np.mean(shares))
        if not (found[False] and found[True] and 0 < share < 1):
            return None
        (water, water_sd), (other, other_sd) = (np.mean(found[side], axis=0) for side in found)
        if not water < other:
            return None
        sds = max(float(water_sd), _MIN_SD), max(float(other_sd), _MIN_SD)
        return cls(float(water), float(other), *sds, share)

    def boundary(self, scores: F64) -> float:
        """Where water ends, from -`limit` to `limit`.

        Parameters
        ----------
        scores : array of float64, shape (n,)
            Obstacle scores of all patches of some frames.

        References
        ----------
        Dempster, Laird, Rubin (1977), "Maximum likelihood from incomplete data via the EM
        algorithm", J. R. Statist. Soc. B 39.
        """
        water = expected_water = _ScoreDistribution(self.water, self.water_sd)
        obstacle = expected_obstacle = _ScoreDistribution(self.obstacle, self.obstacle_sd)
        share = self.share
        powers = _powers(np.clip(scores, -_MAX, _MAX))
        sums = powers.sum(axis=1)
        with np.errstate(over="ignore"):  # where the odds are beyond all numbers, the part is 0
            for _ in range(self.rounds):
                odds = np.exp(_log_odds(water, obstacle, share) @ powers)
                of_obstacles = powers @ (1 / (1 + odds))
                water = self._fitted(sums - of_obstacles, expected_water)
                obstacle = self._fitted(of_obstacles, expected_obstacle)
                count = float(of_obstacles[0]) + self.weight * self.share
                share = count / (len(scores) + self.weight)
        at, powers_at = _candidates(self.limit)
        # Below its mean water is water, even where the wider distribution is the likelier one.
        beyond = (_log_odds(water, obstacle, share) @ powers_at < 0) & (at >= water.mean)
        return float(at[np.argmax(beyond)] if beyond.any() else at[-1])

    def _fitted(self, sums: F64, expected: _ScoreDistribution) -> _ScoreDistribution:
        """The distribution of patches whose sums of score ** 0, 1 and 2 are known."""
        count, total, squares = sums.tolist()
        mean = (total + self.weight * expected.mean) / (count + self.weight)
        around = max(squares - 2 * mean * total + mean**2 * count, 0.0)
        variance = (around + self.sd_weight * expected.sd**2) / (count + self.sd_weight)
        return _ScoreDistribution(mean, math.sqrt(variance))

    def words(self) -> str:
        """For people."""
        gray = ""
        if self.gray is not None:
            gray = f" In gray frames: {self.gray.water:.2f} and {self.gray.obstacle:.2f}."
        return (
            f"The boundary between water and obstacles moves with the last {self.frames} frames' "
            f"decision values, by {self.limit:g} at most. At first water is expected at "
            f"{self.water:.2f} (sd {self.water_sd:.2f}), obstacles at {self.obstacle:.2f} (sd "
            f"{self.obstacle_sd:.2f}) in {100 * self.share:.0f} % of patches: what held-out dives "
            f"show.{gray}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain JSON form."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Any) -> WaterPrior:
        """Read back what `to_json` gave. Raises ToktError if it is none.

        Bundles up to format 5 say no rounds: there were 6. Those up to 6 say nothing of gray.
        """
        known = {each.name for each in fields(cls)}
        if not isinstance(value, Mapping) or not known - {"rounds", "gray"} <= set(value) <= known:
            raise ToktError("a water's prior has other entries")
        gray = value.get("gray")
        if isinstance(gray, Mapping) and set(gray) == known and gray["gray"] is None:
            gray = cls.from_json(gray)
        return cls(**{"rounds": 6, **value, "gray": gray})


@lru_cache(maxsize=4)
def _candidates(limit: float) -> tuple[F64, F64]:
    """The boundaries there can be, shape (n,), and their powers 0, 1 and 2, shape (3, n)."""
    steps = round(limit / _STEP)
    at = np.round(np.arange(-steps, steps + 1) * _STEP, 2)
    return at, _powers(at)


def _powers(scores: F64) -> F64:
    """Scores ** 0, 1 and 2, shape (3, n)."""
    return np.stack([np.ones_like(scores), scores, scores * scores])


def _log_odds(water: _ScoreDistribution, obstacle: _ScoreDistribution, share: float) -> F64:
    """Logarithm of how much likelier water is than an obstacle: factors of score ** 0, 1 and 2."""
    a, b = -0.5 / water.sd**2, -0.5 / obstacle.sd**2
    odds = (1 - share) * obstacle.sd / (share * water.sd)
    constant = a * water.mean**2 - b * obstacle.mean**2 + math.log(odds)
    return np.array([constant, 2 * (b * obstacle.mean - a * water.mean), a - b])


class WaterState:
    """The decision values of one run's last frames, and their boundary: 0 without a prior."""

    def __init__(self, prior: WaterPrior | None) -> None:
        self.prior = prior
        self._last: deque[F64] = deque(maxlen=prior.frames if prior else 1)
        self._gray: deque[bool] = deque(maxlen=self._last.maxlen)

    def begin(self, missed: int = 0) -> None:
        """The next frame, `missed` frames after the one before; not judged unless `judge` is."""
        begun = 1 + min(missed, self._last.maxlen or 0)
        self._last.extend([np.zeros(0)] * begun)
        self._gray.extend([False] * begun)

    def judge(self, scores: F64, *, gray: bool = False) -> float:
        """Find the boundary in the frame that was begun.

        Parameters
        ----------
        scores : array of float64, shape (n_patches,)
            Its obstacle scores with the boundary at 0.
        gray : bool
            Whether it has no colour.
        """
        self._last[-1], self._gray[-1] = scores, gray
        boundary = 0.0 if self.prior is None else self._boundary(self.prior, gray)
        # An even obstacle that fills the view looks like the water of another dive: not cleared.
        filled = (scores > 0).mean() >= FILLED and not (scores > boundary).any()
        return min(boundary, 0.0) if filled else boundary

    def _boundary(self, prior: WaterPrior, gray: bool) -> float:
        if prior.gray is None:
            return prior.boundary(np.concatenate(self._last))
        # Values of the other kind lie elsewhere: a camera may switch between colour and infrared.
        last = zip(self._last, self._gray, strict=True)
        same = [scores for scores, was_gray in last if was_gray == gray]
        return (prior.gray if gray else prior).boundary(np.concatenate(same))
