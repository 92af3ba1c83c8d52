"""A pipeline half buried in sand: its route, its faults, and a map of all that lies there.

World axes are metres: x right, y down from the floor, z ahead. The map lies unrolled along the
pipe: its rows run along the axis, its columns across, round the pipe and on over the floor.
"""

from typing import NamedTuple

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, U8, Bools

TEXEL_M, HALF_M = 0.004, 1.8
"""The map's detail, and how far it reaches to either side."""
SAND, PIPE, DAMAGE, GROWTH, NET, STONE = range(1, 7)
CLASSES = {SAND: "sand", PIPE: "pipe", DAMAGE: "damage", GROWTH: "growth", NET: "net"}
"""Classes of patches by material; stones are sand."""
_END_M = 5.0
"""Nothing is planted this near to the route's ends, where the camera looks up."""
_APART_M, _JOINT_M = 3.0, 12.2
"""Between two faults at least; one pipe's length."""
_ALBEDO = {SAND: (0.26, 0.50), PIPE: (0.24, 0.52), DAMAGE: (0.26, 0.55), GROWTH: (0.24, 0.52),
           STONE: (0.22, 0.45)}  # fmt: skip
"""Darkest and brightest; so near each other that brightness and colour alone say little."""


class PlantedFault(NamedTuple):
    """Something that an inspector looks for; its centre is at `along_m` of the pipe's axis."""

    kind: int
    along_m: float
    length_m: float
    across_m: float  # of the centre, round the pipe from its top
    width_m: float


def plan_faults(
    rng: np.random.Generator, length_m: float, n_faults: int, half_arc_m: float
) -> list[PlantedFault]:
    """Faults of all kinds in turn, each somewhere in its own part of the way."""
    part = (length_m - 2 * _END_M) / n_faults
    play = max(part - _APART_M, 0.0) / 2
    faults = []
    for number, kind in enumerate(rng.permutation(np.resize([DAMAGE, GROWTH, NET], n_faults))):
        along = _END_M + (number + 0.5) * part + rng.uniform(-play, play)
        length, across = rng.uniform(0.4, 0.8), rng.uniform(-0.3, 0.3) * half_arc_m
        width = 2 * half_arc_m + rng.uniform(0.1, 0.5) if kind == NET else rng.uniform(0.35, 0.55)
        faults.append(PlantedFault(int(kind), along, length, across, width))
    return faults


class Pipeline:
    """A route and its map, drawn at random: brightness, and material plus 8 times the class."""

    def __init__(self, rng: np.random.Generator, length_m: float, n_faults: int) -> None:
        self.radius_m = rng.uniform(0.2, 0.3)
        self.lift_m = -self.radius_m * rng.uniform(0.0, 0.3)  # of the axis over the floor
        self.half_arc_m = self.radius_m * np.arccos(-self.lift_m / self.radius_m)
        self.faults = plan_faults(rng, length_m, n_faults, self.half_arc_m)
        # (3, materials): blue, green and red. Cords are seen on the pipe, be they light or dark.
        self.paint = np.zeros((3, STONE + 1), np.float32)
        for material, span in _ALBEDO.items():
            self.paint[:, material] = rng.uniform(*span) * rng.uniform(0.8, 1.25, 3)
        self.paint[:, NET] = self.paint[:, PIPE] * rng.uniform(0.9, 1.15)
        # Place along the axis, x, z and heading, every centimetre.
        z = np.arange(-3.0, length_m + 30.0, 0.01)
        reach, turn = rng.uniform(0.3, 0.8), 2 * np.pi / rng.uniform(70.0, 100.0)
        phase = turn * z + rng.uniform(0.0, 2 * np.pi)
        slope = reach * turn * np.cos(phase)
        along = np.cumsum(np.sqrt(1 + slope**2)) * 0.01
        self._route = along - np.interp(0, z, along), reach * np.sin(phase), z, np.arctan(slope)
        self.bright, self.what = _Map(rng, length_m, self.half_arc_m).filled(self.faults)

    def axis(self, along_m: F64 | float) -> tuple[F64, F64]:
        """World points (..., 3) of the axis at places along it, and its headings there."""
        x, z, heading = (np.interp(along_m, self._route[0], each) for each in self._route[1:])
        points = np.stack([x, np.full_like(x, -self.lift_m), z], axis=-1)
        return points, np.asarray(heading, np.float64)

    @staticmethod
    def right(heading: F64) -> F64:
        """Directions (..., 3) to the right of headings."""
        return np.stack([np.cos(heading), np.zeros_like(heading), -np.sin(heading)], axis=-1)

    def place(self, fault: PlantedFault) -> F64:
        """World point of a fault's centre, on the pipe."""
        point, heading = self.axis(fault.along_m)
        angle = fault.across_m / self.radius_m
        outward = np.sin(angle) * self.right(heading) - np.array([0, np.cos(angle), 0])
        return np.asarray(point + self.radius_m * outward)


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


def _disc(
    image: F32 | U8, place: F64, size: float, value: float, flat: float = 1, turn: float = 0
) -> None:
    row, column = place
    cv2.ellipse(image, ((column, row), (2 * size, 2 * size * flat), turn), value, -1)


class _Map:
    """The map while it is drawn, in texels: brightness about 0.5, material, class."""

    def __init__(self, rng: np.random.Generator, length_m: float, half_arc_m: float) -> None:
        self.rng = rng
        self.size = (round(length_m / TEXEL_M), 2 * round(HALF_M / TEXEL_M))
        self.middle, self.half_arc = self.size[1] // 2, round(half_arc_m / TEXEL_M)
        self.bright = np.full(self.size, 0.5, np.float32)
        self.material = np.full(self.size, SAND, np.uint8)
        self.label = self.material.copy()

    def filled(self, faults: list[PlantedFault]) -> tuple[U8, U8]:
        """Sand, stones, the pipe, faults; a shadow after every fifth one."""
        self._ripples()
        self._stones()
        grain = self.rng.uniform(0.05, 0.10)
        self.bright += np.float32(grain) * noise(
            self.rng, self.size, 64, self.rng.uniform(0.15, 0.45)
        )
        self._pipe()
        for fault in faults:
            self._fault(fault)
        rim = np.linspace(-1.5, 1.5, 300, dtype=np.float32)[:, None]
        for before, after in zip(faults[::5], faults[1::5], strict=False):
            first = round((before.along_m + after.along_m) / 2 / TEXEL_M) - len(rim) // 2
            lit = self.bright[first : first + len(rim)]
            dark = np.exp(-((rim / np.float32(self.rng.uniform(0.4, 0.8))) ** 4))
            lit -= (lit + np.float32(0.3)) * dark * np.float32(0.45)
        np.clip(self.bright, 0, 1, out=self.bright)
        return (self.bright * 255).astype(np.uint8), self.material + 8 * self.label

    def _ripples(self) -> None:
        """Ripples that come and go, at half the detail."""
        rng, size = self.rng, (self.size[0] // 2, self.size[1] // 2)
        turn, long = rng.uniform(-0.6, 0.6), rng.uniform(0.10, 0.24) / TEXEL_M / 2
        few = size[0] // 16, size[1] // 16
        wide, warp = (
            cv2.resize(noise(rng, few, *kind), size[::-1]) for kind in ((32, 1.0), (16, 0.8))
        )
        rows, columns = (np.arange(n, dtype=np.float32) for n in size)
        phase = (rows * np.cos(turn))[:, None] + (columns * np.sin(turn))[None]
        phase *= np.float32(2 * np.pi / long)
        phase += 1.2 * warp
        wave = np.sin(phase) + np.float32(0.35) * np.sin(2 * phase)
        wave *= (0.4 + 0.7 * wide).clip(0, 1) * np.float32(rng.uniform(0.07, 0.14))
        self.bright += cv2.resize(wave + np.float32(0.03) * wide, self.size[::-1])

    def _stones(self) -> None:
        """Pebbles everywhere, and heaps of stones beside the pipe."""
        rng, (rows, columns) = self.rng, self.size
        count = round(rows * TEXEL_M * rng.uniform(15, 40))
        places = [*rng.uniform((0, 0), (rows, columns), (count, 2))]
        sizes = [*(0.012 * rng.lognormal(0.0, 0.5, count))]
        for row in rng.uniform(0, rows, round(rows * TEXEL_M / 12)):
            side = rng.choice([-1, 1]) * (self.half_arc + rng.uniform(0.05, 0.4) / TEXEL_M)
            places += [*rng.normal((row, self.middle + side), 0.15 / TEXEL_M, (6, 2))]
            sizes += [*rng.uniform(0.03, 0.09, 6)]
        for place, size in zip(places, np.array(sizes) / TEXEL_M, strict=True):
            shape, light = (rng.uniform(0.5, 1), rng.uniform(0, 180)), rng.uniform(0.3, 0.7)
            _disc(self.bright, place + 0.3 * size, size, 0.2, *shape)
            _disc(self.bright, place, size, light, *shape)
            _disc(self.bright, place - 0.2 * size, 0.6 * size, light + 0.12, *shape)
            _disc(self.material, place, size, STONE, *shape)

    def _pipe(self) -> None:
        """The coating, with stains and joints."""
        rng, size = self.rng, (self.size[0], 2 * self.half_arc)
        columns = slice(self.middle - self.half_arc, self.middle + self.half_arc)
        coat = 0.5 + rng.uniform(0.02, 0.045) * noise(rng, size, 4, rng.uniform(0.0, 0.5))
        stains = noise(rng, (size[0] // 16, size[1] // 8), 64, 0.9)
        coat += rng.uniform(0.03, 0.07) * cv2.resize(stains, size[::-1])
        joint = (np.arange(size[0]) * TEXEL_M + rng.uniform(0, _JOINT_M)) % _JOINT_M < 0.35
        coat[joint] = 0.15 + 0.5 * coat[joint]
        self.bright[:, columns] = coat
        self.material[:, columns] = self.label[:, columns] = PIPE

    def _fault(self, fault: PlantedFault) -> None:
        """Draw a fault in its window of the map; beside the pipe there are nets only."""
        rng, reach = self.rng, 1.35
        high, broad = (round(reach * m / 2 / TEXEL_M) for m in (fault.length_m, fault.width_m))
        row, column = round(fault.along_m / TEXEL_M), self.middle + round(fault.across_m / TEXEL_M)
        window = slice(row - high, row + high), slice(column - broad, column + broad)
        size = (2 * high, 2 * broad)
        y, x = (np.linspace(-reach, reach, n, dtype=np.float32) for n in size)
        ragged = cv2.GaussianBlur(noise(rng, size, 32, 0.8), (0, 0), 3)
        inside = (x * x)[None] + (y * y)[:, None] + np.float32(0.3) * ragged < 1
        if fault.kind != NET:
            inside &= self.label[window] == PIPE
        draw = {DAMAGE: self._damage, GROWTH: self._growth, NET: self._net}[fault.kind]
        covered, light = draw(size)
        covered &= inside
        self.bright[window][covered] = light[covered]
        self.material[window][covered] = fault.kind
        self.label[window][inside] = fault.kind

    def _damage(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """Broken coating: sharp-edged flakes and holes of 2 to 5 cm, rough all over."""
        rng = self.rng
        plates = cv2.GaussianBlur(noise(rng, size, 8, 0.4), (0, 0), rng.uniform(1.5, 3.0))
        steps = np.digitize(plates / plates.std(), rng.uniform(-0.6, 0.6, 2))
        light = (steps - steps.mean()) * rng.uniform(0.22, 0.34) + 0.09 * noise(rng, size, 2, 0.0)
        return np.ones(size, bool), np.asarray(0.5 + light, np.float32)

    def _growth(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """Marine growth: soft round heads of 3 to 8 cm on top of each other, dark between them."""
        rng, base = self.rng, self.rng.uniform(4.5, 7.5)
        light = np.full(size, 0.1, np.float32)
        for place in rng.uniform((0, 0), size, (round(size[0] * size[1] / base**2), 2)):
            radius, bright = base * rng.lognormal(0.0, 0.3), rng.uniform(0.6, 1.0)
            for part in (1.0, 0.8, 0.6, 0.4, 0.2):
                _disc(light, place, part * radius, bright * (1 - part**2) + 0.1)
        light = np.asarray(cv2.GaussianBlur(light, (0, 0), 1.0), np.float32)
        return np.ones(size, bool), light + np.float32(0.03) * noise(rng, size, 1, 0.0)

    def _net(self, size: tuple[int, int]) -> tuple[Bools, F32]:
        """An old net: crumpled meshes of 4 to 7 cm over what is under it."""
        rng, mesh = self.rng, np.zeros(size, bool)
        turn, spacing = rng.uniform(0, np.pi), rng.uniform(0.04, 0.07) / TEXEL_M
        row, column = np.indices(size, np.float32)
        for angle in (turn, turn + rng.uniform(1.1, 1.6)):
            across = row * np.cos(angle) + column * np.sin(angle)
            crumpled = cv2.GaussianBlur(noise(rng, size, 64, 1.0), (0, 0), 5)
            mesh |= (across + 0.4 * spacing * crumpled) % spacing < rng.uniform(2, 2.8)
        light = rng.choice([0.1, 1.0]) + 0.05 * noise(rng, size, 1, 0.0)
        return mesh, np.asarray(light, np.float32)
