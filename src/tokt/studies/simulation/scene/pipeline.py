"""A pipeline half buried in sand: its route, its faults, and a map of all that lies there.

World axes are metres: x right, y down from the floor, z ahead. The map lies unrolled along the
pipe: its rows run along the axis, its columns across, round the pipe and on over the floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8, Bools

TEXEL_M = 0.004
HALF_M = 1.8
"""How far the map reaches to either side."""
SAND, PIPE, DAMAGE, GROWTH, NET, STONE = range(1, 7)
"""Materials; all but stones, which lie in the sand, are classes of patches too."""
CLASSES = {SAND: "sand", PIPE: "pipe", DAMAGE: "damage", GROWTH: "growth", NET: "net"}
_END_M = 5.0
"""Nothing is planted this near to the route's ends, where the camera looks up."""
_APART_M = 3.0
_JOINT_M = 12.2
"""One pipe's length."""


@dataclass(frozen=True)
class Fault:
    """Something that an inspector looks for; its centre is at `along_m` of the pipe's axis."""

    kind: int
    along_m: float
    length_m: float
    across_m: float  # of the centre, round the pipe from its top
    width_m: float


@dataclass(frozen=True, eq=False)
class Pipeline:
    """A route, and the map: brightness, 0..255, and material plus 8 times the class, by texel."""

    length_m: float
    radius_m: float
    lift_m: float  # of the axis over the floor; below 0 under it
    bend: tuple[float, float, float]  # reach in m, length in m and phase of the route's bends
    faults: tuple[Fault, ...]
    paint: F32  # (3, materials): albedo, blue, green and red
    bright: U8
    what: U8

    @classmethod
    def draw(cls, rng: np.random.Generator, length_m: float, n_faults: int) -> Pipeline:
        """Draw a pipeline and all that lies along it."""
        radius = rng.uniform(0.2, 0.3)
        lift = -radius * rng.uniform(0.0, 0.3)
        bend = (rng.uniform(0.3, 0.8), rng.uniform(70.0, 100.0), rng.uniform(0.0, 2 * np.pi))
        half_arc = radius * np.arccos(-lift / radius)
        faults = plan_faults(rng, length_m, n_faults, half_arc)
        bright, what = _Map(rng, length_m, half_arc).filled(faults)
        return cls(length_m, radius, lift, bend, faults, _paint(rng), bright, what)

    @property
    def half_arc_m(self) -> float:
        """From the pipe's top, round it, to the sand."""
        return float(self.radius_m * np.arccos(-self.lift_m / self.radius_m))

    @cached_property
    def _route(self) -> tuple[F64, F64, F64, F64]:
        """Place along the axis, x, z and heading, every centimetre from where it begins."""
        reach, period, phase = self.bend
        z = np.arange(-3.0, self.length_m + 30.0, 0.01)
        turn = 2 * np.pi / period
        slope = reach * turn * np.cos(turn * z + phase)
        along = np.cumsum(np.sqrt(1 + slope**2)) * 0.01
        return (
            along - np.interp(0.0, z, along),
            reach * np.sin(turn * z + phase),
            z,
            np.arctan(slope),
        )

    def axis(self, along_m: float) -> tuple[F64, float]:
        """World point of the axis at a place along it, and its heading there."""
        along, *rest = self._route
        x, z, heading = (float(np.interp(along_m, along, values)) for values in rest)
        return np.array([x, -self.lift_m, z]), heading

    def place(self, fault: Fault) -> F64:
        """World point of a fault's centre, on the pipe."""
        point, heading = self.axis(fault.along_m)
        angle = fault.across_m / self.radius_m
        aside = self.radius_m * np.sin(angle) * np.array([np.cos(heading), 0.0, -np.sin(heading)])
        return np.asarray(point + aside - [0.0, self.radius_m * np.cos(angle), 0.0])

    @cached_property
    def coarse(self) -> U8:
        """The brightness at a quarter of the detail."""
        return np.asarray(cv2.pyrDown(cv2.pyrDown(self.bright)), np.uint8)


def plan_faults(
    rng: np.random.Generator, length_m: float, n_faults: int, half_arc: float
) -> tuple[Fault, ...]:
    """Faults of all kinds in turn, each somewhere in its own part of the way."""
    part = (length_m - 2 * _END_M) / n_faults
    play = max(part - _APART_M, 0.0) / 2
    kinds = rng.permutation(np.resize([DAMAGE, GROWTH, NET], n_faults))
    faults = []
    for number, kind in enumerate(kinds.tolist()):
        along = _END_M + (number + 0.5) * part + rng.uniform(-play, play)
        length, width = rng.uniform(0.4, 0.8), rng.uniform(0.35, 0.55)
        if kind == NET:
            width = 2 * half_arc + rng.uniform(0.1, 0.5)
        across = rng.uniform(-0.3, 0.3) * half_arc
        faults.append(Fault(kind, along, length, across, width))
    return tuple(faults)


def _paint(rng: np.random.Generator) -> F32:
    """Each material's albedo: a day's own, and so near each other that colour alone says little."""
    gray = {SAND: (0.26, 0.50), PIPE: (0.24, 0.52), DAMAGE: (0.26, 0.55), GROWTH: (0.24, 0.52),
            STONE: (0.22, 0.45)}  # fmt: skip
    paint = np.zeros((3, max(gray) + 1))
    for material, (low, high) in gray.items():
        paint[:, material] = rng.uniform(low, high) * rng.uniform(0.8, 1.25, 3)
    paint[:, NET] = paint[:, PIPE] * rng.uniform(0.9, 1.15)  # cords are seen on it, light or dark
    return paint.astype(np.float32)


def noise(rng: np.random.Generator, size: tuple[int, int], coarsest: int, slope: float) -> F32:
    """Noise of zero mean and unit deviation; an octave of twice the size is 2**slope as strong."""
    field, step = np.zeros((1, 1), np.float32), coarsest
    while step:
        rows, columns = (-(-n // step) for n in size)
        field = np.asarray(cv2.resize(field, (columns, rows), interpolation=cv2.INTER_LINEAR))
        field += np.float32(step**slope) * rng.standard_normal((rows, columns), np.float32)
        step //= 2
    field -= field.mean()
    field /= field.std()
    return field


class _Map:
    """The map while it is drawn, in texels: brightness about 0.5, material, class."""

    def __init__(self, rng: np.random.Generator, length_m: float, half_arc: float) -> None:
        self.rng = rng
        self.size = (round(length_m / TEXEL_M), 2 * round(HALF_M / TEXEL_M))
        self.middle, self.half_arc = self.size[1] // 2, round(half_arc / TEXEL_M)
        self.bright = np.full(self.size, 0.5, np.float32)
        self.material = np.full(self.size, SAND, np.uint8)
        self.label = np.full(self.size, SAND, np.uint8)

    def filled(self, faults: tuple[Fault, ...]) -> tuple[U8, U8]:
        """Sand, stones and the pipe, shadows, then the faults."""
        rng = self.rng
        self._ripples()
        self._stones()
        grain = noise(rng, self.size, 64, rng.uniform(0.15, 0.45))
        self.bright += np.float32(rng.uniform(0.05, 0.10)) * grain
        self._pipe(grain)
        for fault in faults:
            self._fault(fault)
        self._shadows(faults)
        np.clip(self.bright, 0, 1, out=self.bright)
        return (self.bright * 255).astype(np.uint8), self.material + 8 * self.label

    def _ripples(self) -> None:
        """Ripples that come and go, at half the detail."""
        rng, size = self.rng, (self.size[0] // 2, self.size[1] // 2)
        turn, long = rng.uniform(-0.6, 0.6), rng.uniform(0.10, 0.24) / TEXEL_M / 2
        wide = cv2.resize(noise(rng, (size[0] // 16, size[1] // 16), 32, 1.0), size[::-1])
        height = (0.4 + 0.7 * wide).clip(0, 1)
        warp = cv2.resize(noise(rng, (size[0] // 16, size[1] // 16), 16, 0.8), size[::-1])
        rows, columns = (np.arange(n, dtype=np.float32) for n in size)
        phase = (rows * np.cos(turn))[:, None] + (columns * np.sin(turn))[None]
        phase *= np.float32(2 * np.pi / long)
        phase += 1.2 * warp
        wave = np.sin(phase) + np.float32(0.35) * np.sin(2 * phase)
        wave *= height * np.float32(rng.uniform(0.07, 0.14))
        wave += np.float32(0.03) * wide
        self.bright += cv2.resize(wave, self.size[::-1])

    def _stones(self) -> None:
        """Pebbles everywhere, and heaps of stones beside the pipe."""
        rng, (rows, columns) = self.rng, self.size
        count = round(rows * TEXEL_M * rng.uniform(15, 40))
        places = rng.uniform((0, 0), (rows, columns), (count, 2))
        sizes = 0.012 * rng.lognormal(0.0, 0.5, count)
        for row in rng.uniform(0, rows, round(rows * TEXEL_M / 12)):
            side = rng.choice([-1, 1]) * (self.half_arc + rng.uniform(0.05, 0.4) / TEXEL_M)
            heap = rng.normal((row, self.middle + side), 0.15 / TEXEL_M, (6, 2))
            places, sizes = np.vstack([places, heap]), np.append(sizes, rng.uniform(0.03, 0.09, 6))
        for (row, column), size in zip(places, sizes / TEXEL_M, strict=True):
            axes = (max(size, 1), max(size * rng.uniform(0.5, 1), 1))
            turn, light = rng.uniform(0, 180), rng.uniform(0.3, 0.7)
            self._ellipse(self.bright, row + 0.3 * size, column + 0.3 * size, axes, turn, 0.2)
            self._ellipse(self.bright, row, column, axes, turn, light)
            self._ellipse(self.material, row, column, axes, turn, STONE)
            top = (axes[0] * 0.6, axes[1] * 0.6)
            self._ellipse(
                self.bright, row - 0.2 * size, column - 0.2 * size, top, turn, light + 0.12
            )

    @staticmethod
    def _ellipse(
        image: F32 | U8, row: float, column: float, axes: tuple[float, float], turn: float,
        value: float,
    ) -> None:  # fmt: skip
        cv2.ellipse(image, ((column, row), (2 * axes[0], 2 * axes[1]), turn), value, -1)

    def _pipe(self, grain: F32) -> None:
        """The coating, with stains and joints, between banks of sand that drifted on to it."""
        rng, rows, half = self.rng, self.size[0], self.half_arc
        columns = slice(self.middle - half, self.middle + half)
        size = (rows, 2 * half)
        coat = 0.5 + rng.uniform(0.02, 0.045) * noise(rng, size, 4, rng.uniform(0.0, 0.5))
        stains = noise(rng, (rows // 16, half // 4), 64, 0.9)
        coat += rng.uniform(0.03, 0.07) * cv2.resize(stains, size[::-1])
        along = np.arange(rows, dtype=np.float32)[:, None]
        winding = along + np.arange(2 * half, dtype=np.float32) * np.float32(rng.uniform(-0.3, 0.3))
        winding *= np.float32(2 * np.pi * TEXEL_M / rng.uniform(0.15, 0.4))
        coat += np.float32(rng.uniform(0.0, 0.03)) * np.sin(winding)
        joint = (along * TEXEL_M + rng.uniform(0, _JOINT_M)) % _JOINT_M < 0.35
        coat = np.where(joint, 0.4 + 0.5 * (coat - 0.5), coat)
        around = np.abs(np.arange(-half, half, dtype=np.float32) + np.float32(0.5)) / half
        drift = cv2.resize(noise(rng, (rows // 8, 2), 64, 0.8), (2, rows))
        bank = np.where(np.arange(2 * half) < half, drift[:, :1], drift[:, 1:])
        bare = around + np.float32(0.02) * grain[:, columns] < np.minimum(0.86 + 0.06 * bank, 1)
        self.bright[:, columns] = np.where(bare, coat, self.bright[:, columns])
        for layer in (self.material, self.label):
            layer[:, columns][bare] = PIPE

    def _fault(self, fault: Fault) -> None:
        """Draw a fault in its window of the map; beside the pipe there are nets only."""
        rng, reach = self.rng, 1.35
        long, wide = fault.length_m / TEXEL_M, fault.width_m / TEXEL_M
        row, column = round(fault.along_m / TEXEL_M), self.middle + round(fault.across_m / TEXEL_M)
        high, broad = round(reach * long / 2), round(reach * wide / 2)
        window = slice(row - high, row + high), slice(column - broad, column + broad)
        size = (2 * high, 2 * broad)
        y = np.linspace(-reach, reach, size[0], dtype=np.float32)[:, None]
        x = np.linspace(-reach, reach, size[1], dtype=np.float32)
        ragged = cv2.GaussianBlur(noise(rng, size, 32, 0.8), (0, 0), 3)
        inside = x * x + y * y + np.float32(0.3) * ragged < 1
        if fault.kind != NET:
            inside &= self.label[window] == PIPE
        draw = {DAMAGE: self._damage, GROWTH: self._growth, NET: self._net}[fault.kind]
        covered, light = draw(size)
        covered &= inside
        self.bright[window] = np.where(covered, light, self.bright[window])
        self.material[window][covered] = fault.kind
        self.label[window][inside] = fault.kind

    def _damage(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """Broken coating: sharp-edged flakes and holes of 2 to 5 cm, rough all over."""
        rng = self.rng
        plates = cv2.GaussianBlur(noise(rng, size, 8, 0.4), (0, 0), rng.uniform(1.5, 3.0))
        plates /= plates.std()
        light = np.digitize(plates, rng.uniform(-0.6, 0.6, 2)) * np.float32(rng.uniform(0.22, 0.34))
        light += 0.5 - light.mean() + np.float32(0.09) * noise(rng, size, 2, 0.0)
        return np.ones(size, bool), np.asarray(light, np.float32)

    def _growth(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """Marine growth: soft round heads of 3 to 8 cm on top of each other, dark between them."""
        rng, base = self.rng, self.rng.uniform(4.5, 7.5)
        light = np.full(size, 0.1, np.float32)
        for _ in range(round(size[0] * size[1] / base**2)):
            row, column = rng.uniform((0, 0), size)
            radius, bright = base * rng.lognormal(0.0, 0.3), rng.uniform(0.6, 1.0)
            for part in np.arange(1.0, 0.0, -0.2).tolist():
                part_axes = (part * radius, part * radius)
                self._ellipse(light, row, column, part_axes, 0, bright * (1 - part**2) + 0.1)
        light = cv2.GaussianBlur(light, (0, 0), 1.0)
        return np.ones(size, bool), light + np.float32(0.03) * noise(rng, size, 1, 0.0)

    def _net(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """An old net: crumpled meshes of 4 to 7 cm over what is under it."""
        rng = self.rng
        mesh = np.zeros(size, bool)
        turn, spacing = rng.uniform(0, np.pi), rng.uniform(0.04, 0.07) / TEXEL_M
        row, column = np.indices(size, np.float32)
        for angle in (turn, turn + rng.uniform(1.1, 1.6)):
            across = row * np.cos(angle) + column * np.sin(angle)
            crumpled = cv2.GaussianBlur(noise(rng, size, 64, 1.0), (0, 0), 5)
            mesh |= (across + spacing * np.float32(0.4) * crumpled) % spacing < rng.uniform(2, 2.8)
        light = rng.choice([0.1, 1.0]) + np.float32(0.05) * noise(rng, size, 1, 0.0)
        return mesh, np.asarray(light, np.float32)

    def _shadows(self, faults: tuple[Fault, ...]) -> None:
        """Soft shadows across the whole map, where no fault is."""
        rim = np.linspace(-1.5, 1.5, 300, dtype=np.float32)[:, None]
        for before, after in zip(faults[::5], faults[1::5], strict=False):
            first = round((before.along_m + after.along_m) / 2 / TEXEL_M) - len(rim) // 2
            lit = self.bright[first : first + len(rim)]
            dark = np.exp(-((rim / np.float32(self.rng.uniform(0.4, 0.8))) ** 4))
            lit -= (lit + np.float32(0.3)) * dark * np.float32(0.45)
