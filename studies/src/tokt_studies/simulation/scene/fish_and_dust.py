"""Schools of fish and clouds of dust, which pass through the view and are nothing to hit."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64

from .tower import TEXEL_M, Material
from .water import Triple

FISH = Material((0.45, 0.46, 0.42), rust=(0.10, 0.12, 0.12), rusted=0.9)
"""Silver flanks; the rust of a fish's texture is its dark back and bars."""
_TEXTURE_SIZE, _LEVELS = 256, 5
TEXTURE_M = _TEXTURE_SIZE * TEXEL_M
"""Side of the texture, stretched over a fish's flank: nose to tail, back to belly."""
_WANDER_M = 0.15
_BEAT_RAD_S = 12.0
_MIN_M, _MAX_M = 0.2, 0.5
_SPREAD_M = (1.0, 0.4, 0.8)
"""Of a school, along world axes."""
_PUFFS = 20


class School:
    """Fish that keep their places in a school that moves straight on, loosely; drawn at random.

    Its middle passes the world point `through` at `at_s`, with a velocity in m/s.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        through: Triple,
        at_s: float,
        velocity: Triple = (0.5, 0.0, 0.0),
        count: int = 30,
    ) -> None:
        self.through, self.at_s = np.array(through, np.float64), at_s
        self.velocity = np.array(velocity, np.float64)
        self.places = rng.normal(0.0, 1.0, (count, 3)) * _SPREAD_M  # from the middle
        self.length_m = rng.uniform(_MIN_M, _MAX_M, count)
        # Each fish's own wandering about its place along each axis: rad/s, and rad at `at_s`.
        self.rate = rng.uniform(0.4, 1.2, (count, 3))
        self.phase = rng.uniform(0.0, 2 * np.pi, (count, 3))

    def at(self, t_s: float) -> F64:
        """World positions (n, 3) of the fish's middles at a time, metres."""
        since = t_s - self.at_s
        middle = self.through + since * self.velocity
        return middle + self.places + _WANDER_M * np.sin(self.rate * since + self.phase)

    def swimming(self, t_s: float) -> F64:
        """Velocities (n, 3) of the fish at a time, m/s: the way they look."""
        since = t_s - self.at_s
        return self.velocity + _WANDER_M * self.rate * np.cos(self.rate * since + self.phase)

    def shapes(self, t_s: float) -> tuple[F64, F64, F64]:
        """The fish as ellipsoids: bodies, then tail fins that beat.

        World centres (2 n, 3), axes (2 n, 3, 3) in orthonormal rows (towards the nose, down,
        across), and half sizes (2 n, 3) along these, m.
        """
        ahead = self.swimming(t_s)
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        beat = 0.5 * np.sin(_BEAT_RAD_S * t_s + 7.0 * self.phase[:, 0])
        body, tail = _axes(ahead, np.zeros(len(ahead))), _axes(ahead, beat)
        middle, length = self.at(t_s), self.length_m[:, None]
        fin = middle - 0.40 * length * ahead - 0.08 * length * tail[:, 0]
        return (
            np.concatenate([middle, fin]),
            np.concatenate([body, tail]),
            np.concatenate([length * [0.42, 0.13, 0.07], length * [0.10, 0.12, 0.012]]),
        )


def _axes(ahead: F64, turn_rad: F64) -> F64:
    """Rows ahead, down, across of fish whose bodies look `ahead` (n, 3), turned to the side."""
    across = np.cross(ahead, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    ahead, across = cos * ahead + sin * across, cos * across - sin * ahead
    return np.stack([ahead, np.cross(across, ahead), across], axis=1)


def fish_texture(rng: np.random.Generator) -> tuple[F32, ...]:
    """Scales, bars and a dark back over a flank: the levels of a texture (see `Tower`)."""
    row, column = np.mgrid[:_TEXTURE_SIZE, :_TEXTURE_SIZE] / _TEXTURE_SIZE
    bars = np.sin(2 * np.pi * (7 * column + 0.3 * np.sin(9 * row)))
    dark = (0.9 - 1.6 * row + 0.35 * bars * (row < 0.6)).clip(0, 1)
    scales = 0.5 + 0.12 * rng.standard_normal((_TEXTURE_SIZE // 4, _TEXTURE_SIZE // 4))
    bright = cv2.resize(scales, row.shape, interpolation=cv2.INTER_LINEAR) + 0.15 * row
    level = np.stack([bright, dark], axis=-1).clip(0, 1).astype(np.float32)
    sizes = [_TEXTURE_SIZE >> halved for halved in range(_LEVELS)]
    return tuple(
        np.asarray(cv2.resize(level, (size, size), interpolation=cv2.INTER_AREA), np.float32)
        for size in sizes
    )


@dataclass(frozen=True)
class Puffs:
    """A cloud at one moment: round puffs whose density falls off as a Gaussian."""

    centre: F64  # (n, 3), world coordinates, m
    size: F64  # (n,), standard deviation, m
    density: F64  # (n,), attenuation in the middle, 1/m


@dataclass(frozen=True, eq=False)
class DustCloud:
    """A cloud of stirred-up sediment: it drifts, spreads and settles."""

    start: Puffs  # at 0 s
    drift: F64  # (3,), m/s
    spreading: float  # m^2/s of a puff's squared size: its sediment is spread ever thinner
    settles_s: float  # time in which all but 1/e of the sediment has sunk out of sight

    @classmethod
    def draw(cls, rng: np.random.Generator, at: Triple, drift: Triple) -> DustCloud:
        """A cloud of about a metre, and 1/m in its middle, about a place at 0 s."""
        size = rng.uniform(0.15, 0.5, _PUFFS)
        centre = np.array(at) + rng.normal(0.0, [0.6, 0.4, 0.6], (_PUFFS, 3))
        puffs = Puffs(centre, size, rng.uniform(0.2, 0.8, _PUFFS))
        return cls(puffs, np.array(drift, np.float64), spreading=0.004, settles_s=90.0)

    def at(self, t_s: float) -> Puffs:
        """The cloud at a time from 0 s on."""
        size = np.sqrt(self.start.size**2 + self.spreading * t_s)
        thinned = (self.start.size / size) ** 3 * np.exp(-t_s / self.settles_s)
        return Puffs(self.start.centre + t_s * self.drift, size, self.start.density * thinned)
