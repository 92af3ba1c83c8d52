"""The tower of a synthetic mission and the walls of a dead end: solids, and what grows on them.

Tower coordinates are metres: x right, y down, z away from a vehicle that approaches along +z;
the origin is on the mast's axis at the height of the collar.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tokt.features.common.arrays import F32, F64

RIM_POINTS = 16
CORNERS = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
"""Of a cuboid, in half sizes."""
_UP = np.array([0.0, -1.0, 0.0])
_TOWARDS_VEHICLE = np.array([0.0, 0.0, -1.0])
_TOP_OF_LEGS_M, _FEET_M = 0.50, 2.30
_MAST_RADIUS_M = 0.075
_PANEL_THICKNESS_M = 0.12
_STALKS_PER_M2 = 25
TEXTURE_SIZE = 1024
"""Texels along a side of the surface texture, which repeats."""
TEXEL_M = 0.0015
NO_STALKS = np.zeros((0, 8))


@dataclass(frozen=True)
class Material:
    """A surface's material: BGR albedo of its paint and of its rust, 0..1."""

    paint: tuple[float, float, float]
    rust: tuple[float, float, float] = (0.20, 0.32, 0.42)
    rusted: float = 0.6


WHITE = Material((0.85, 0.84, 0.76))
GREY = Material((0.42, 0.42, 0.40))
YELLOW = Material((0.15, 0.65, 0.70), rusted=0.2)
PANEL = Material((0.50, 0.50, 0.46), rust=(0.16, 0.26, 0.34), rusted=0.8)
GROWTH = Material((0.25, 0.31, 0.31), rust=(0.10, 0.16, 0.20), rusted=0.9)


@dataclass(frozen=True)
class Frustum:
    """A closed cylinder or truncated cone between two points, radii in metres."""

    start: F64
    end: F64
    start_radius: float
    end_radius: float
    material: Material

    def frame(self) -> F64:
        """Orthonormal rows (side, along the axis, other side).

        The first side faces the vehicle where it can, which puts the seam of the texture, where
        it has run once around, on the far side.
        """
        along = (self.end - self.start) / self.length
        facing = _TOWARDS_VEHICLE if abs(along[2]) < 0.9 else _UP
        side = facing - (facing @ along) * along
        side /= np.linalg.norm(side)
        return np.stack([side, along, np.cross(side, along)])

    @property
    def length(self) -> float:
        """Length in metres."""
        return float(np.linalg.norm(self.end - self.start))

    def hull(self) -> F64:
        """(2 * `RIM_POINTS`, 3) Corners of polygons around the rims of its start and of its end."""
        angles = np.arange(RIM_POINTS) * 2 * np.pi / RIM_POINTS
        side, _, other = self.frame()
        ring = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), other)
        ring /= np.cos(np.pi / RIM_POINTS)
        ends = self.start + self.start_radius * ring, self.end + self.end_radius * ring
        return np.concatenate(ends)

    def on_surface(self, angle: float, along: float) -> tuple[F64, F64]:
        """A point of the side, at `angle` (rad) and fraction `along`, and its outward normal."""
        side, _, other = self.frame()
        normal = np.cos(angle) * side + np.sin(angle) * other
        radius = self.start_radius + along * (self.end_radius - self.start_radius)
        return self.start + along * (self.end - self.start) + radius * normal, normal


@dataclass(frozen=True)
class Cuboid:
    """A cuboid: centre, orthonormal axes as rows, half sizes in metres."""

    centre: F64
    axes: F64
    half: F64
    material: Material

    def hull(self) -> F64:
        """(8, 3) Its corners."""
        return np.asarray(self.centre + (CORNERS * self.half) @ self.axes)


Solid = Frustum | Cuboid


@dataclass(frozen=True)
class Tower:
    """All solids and stalks, and the texture that is fixed to the solids."""

    solids: tuple[Solid, ...]
    stalks: F64  # (n, 8): root and tip of thin lines that grow on it, half width, brightness
    # (TEXTURE_SIZE, TEXTURE_SIZE, 2): relative brightness and rust of a texel, both 0..1; then each
    # is the one before it at half the detail, for surfaces farther away.
    textures: tuple[F32, ...]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Tower:
        """A tower of the mission's size, turned about its mast as `rng` has it."""
        legs = _tripod(rng.uniform(0.0, 2 * np.pi))
        head = _head(rng)
        solids = (*head, *legs, *_braces(legs, rng))
        return cls(solids, _growth(head, legs, rng), surface_textures(rng))


def upright(turn_rad: float) -> F64:
    """Axes (as rows) of what stands upright, turned clockwise seen from above."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def _up(metres: float) -> F64:
    return _UP * metres


def _tripod(turn: float) -> list[Frustum]:
    legs = []
    for number in range(3):
        angle = turn + number * 2 * np.pi / 3
        outward = np.array([np.cos(angle), 0.0, np.sin(angle)])
        top, foot = _up(-_TOP_OF_LEGS_M) + 0.05 * outward, _up(-_FEET_M) + 0.78 * outward
        legs.append(Frustum(top, foot, 0.055, 0.075, WHITE if number == 0 else GREY))
    return legs


def _head(rng: np.random.Generator) -> list[Frustum]:
    """Mast, collar and lantern, from the legs up."""
    cylinders = (
        (-0.62, 0.0, _MAST_RADIUS_M, WHITE),
        (-0.06, 0.05, rng.uniform(0.17, 0.23), GROWTH),
        (0.05, 0.12, 0.055, YELLOW),
        (0.12, 0.15, 0.075, GREY),
        (0.36, 0.40, 0.07, GREY),
        (0.15, 0.30, 0.03, WHITE),
    )
    parts = [Frustum(_up(low), _up(high), radius, radius, m) for low, high, radius, m in cylinders]
    for number in range(4):
        angle = np.pi / 4 + number * np.pi / 2
        foot = 0.06 * np.array([np.cos(angle), 0.0, np.sin(angle)])
        parts.append(Frustum(_up(0.15) + foot, _up(0.36) + foot, 0.008, 0.008, GREY))
    return parts


def _braces(legs: list[Frustum], rng: np.random.Generator) -> list[Frustum | Cuboid]:
    """Bars between neighbouring legs, and one anode plate on each leg."""
    parts: list[Solid] = []
    for number, leg in enumerate(legs):
        following = legs[(number + 1) % len(legs)]
        for along in (0.45, 0.85):
            start, end = (one.start + along * (one.end - one.start) for one in (leg, following))
            parts.append(Frustum(start, end, 0.018, 0.018, GREY))
        axes = leg.frame()
        along = rng.uniform(0.18, 0.35)
        centre = leg.start + along * (leg.end - leg.start) + 0.09 * axes[0]
        parts.append(Cuboid(centre, axes, np.array([0.075, 0.10, 0.02]), GREY))
    return parts


def _growth(head: list[Frustum], legs: list[Frustum], rng: np.random.Generator) -> F64:
    """Stalks on the collar, the mast and the legs, denser and longer on the collar."""
    stalks = []
    overgrown = ((head[1], 320, 0.08), (head[0], 130, 0.06), *((leg, 90, 0.06) for leg in legs))
    for solid, count, longest_m in overgrown:
        for _ in range(count):
            root, normal = solid.on_surface(rng.uniform(0, 2 * np.pi), rng.uniform(0.02, 0.98))
            direction = normal + rng.normal(0.0, 0.35, 3)
            length = longest_m * rng.uniform(0.3, 1.0)
            tip = root + length * direction / np.linalg.norm(direction)
            stalks.append([*root, *tip, rng.uniform(0.0015, 0.005), rng.uniform(0.6, 1.7)])
    return np.array(stalks)


def panels(
    rng: np.random.Generator, plan: Iterable[tuple[float, float, float, float]], height_m: float
) -> Tower:
    """Upright panels of one height about y = 0, rusty and overgrown.

    The plan has of each the centre (x, z), its turn from lying across the z axis, and its width.
    """
    solids, stalks = [], []
    for x, z, turn, width in plan:
        half = np.array([width, height_m, _PANEL_THICKNESS_M]) / 2
        panel = Cuboid(np.array([x, 0.0, z]), upright(turn), half, PANEL)
        solids.append(panel)
        stalks.append(_growth_on_panel(rng, panel))
    return Tower(tuple(solids), np.concatenate(stalks), surface_textures(rng))


def bare(rng: np.random.Generator, solids: Iterable[Solid]) -> Tower:
    """Solids on which nothing grows."""
    return Tower(tuple(solids), NO_STALKS, surface_textures(rng))


def _growth_on_panel(rng: np.random.Generator, panel: Cuboid) -> F64:
    """Stalks on both faces of a panel."""
    count = int(2 * _STALKS_PER_M2 * 4 * panel.half[0] * panel.half[1])
    face = rng.choice([-1.0, 1.0], count)
    place = rng.uniform(-1.0, 1.0, (count, 2)) * panel.half[:2]
    roots = np.column_stack([place, face * panel.half[2]])
    directions = np.column_stack([np.zeros((count, 2)), face]) + rng.normal(0.0, 0.35, (count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tips = roots + 0.06 * rng.uniform(0.3, 1.0, (count, 1)) * directions
    width, bright = rng.uniform(0.0015, 0.005, count), rng.uniform(0.6, 1.7, count)
    ends = [panel.centre + points @ panel.axes for points in (roots, tips)]
    return np.column_stack([*ends, width, bright])


def surface_textures(rng: np.random.Generator) -> tuple[F32, ...]:
    """A texture drawn at random: the levels of `Tower.textures`."""
    fine = _periodic_noise(rng, slope=0.9)
    rust = _periodic_noise(rng, slope=1.5)
    levels = [np.stack([0.5 + 0.16 * fine, 0.4 + 0.4 * (rust - 0.4)], axis=-1).clip(0, 1)]
    for _ in range(4):
        last = levels[-1]
        pairs = (last + np.roll(last, -1, 0)) / 2
        halved = ((pairs + np.roll(pairs, -1, 1)) / 2)[::2, ::2]
        levels.append(halved)
    return tuple(level.astype(np.float32) for level in levels)


def _periodic_noise(rng: np.random.Generator, slope: float) -> F64:
    """Noise of zero mean and unit deviation whose amplitude falls as 1 / frequency ** slope."""
    spectrum = np.fft.rfft2(rng.standard_normal((TEXTURE_SIZE, TEXTURE_SIZE)))
    rows = np.fft.fftfreq(TEXTURE_SIZE)[:, None]
    cols = np.fft.rfftfreq(TEXTURE_SIZE)[None, :]
    # Waves longer than a fifth of the tile would make whole legs bright or dark.
    frequency = np.hypot(rows, cols).clip(5 / TEXTURE_SIZE)
    noise = np.fft.irfft2(spectrum / frequency**slope, s=(TEXTURE_SIZE, TEXTURE_SIZE))
    return np.asarray((noise - noise.mean()) / noise.std(), np.float64)
