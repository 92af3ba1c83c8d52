"""Obstacles of the closed loop: towers, walls, a vehicle, cables, nets, the sea floor."""

from itertools import pairwise

import numpy as np

from .closed_loop_world import Floor, Placed
from .tower import GREY, YELLOW, Cuboid, Frustum, Material, Solid, Tower, bare, panels, upright
from .water import Triple

_GROUND = Material((0.30, 0.38, 0.40), rust=(0.16, 0.24, 0.28), rusted=0.7)
_ROPE = Material((0.30, 0.48, 0.42), rusted=0.5)
_FLOOR_M = 30.0
"""Of the sea floor from east to west."""
_GROUND_M = 0.5
"""Thickness of the sea floor's slabs."""
CABLE_M = (0.01, 0.03)
"""Radius of a cable."""
_NET_M, _MESH_M, _TWINE_M = (4.0, 3.0), 0.15, 0.003
"""Of a net: width and height, from knot to knot, and the radius of its twine."""


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


def other_vehicle(
    rng: np.random.Generator, at: Triple, velocity: Triple, heading_rad: float
) -> Placed:
    """Another ROV, of the size of ours, that moves straight on; `at` is its middle at 0 s."""
    axes = upright(heading_rad)
    solids: list[Solid] = [
        Cuboid(np.array([0.0, -0.22, 0.0]), axes, np.array([0.38, 0.16, 0.66]), YELLOW),
        Cuboid(np.array([0.0, 0.12, 0.0]), axes, np.array([0.30, 0.18, 0.55]), GREY),
    ]
    for side in (-0.38, 0.38):
        # A skid below, and the posts of the frame.
        bars = [((side, 0.40, -0.66), (side, 0.40, 0.66), 0.03)]
        bars += [((side, -0.1, along), (side, 0.40, along), 0.025) for along in (-0.6, 0.6)]
        for start, end, radius in bars:
            ends = np.array(start) @ axes, np.array(end) @ axes
            solids.append(Frustum(*ends, radius, radius, GREY))
    return Placed(bare(rng, solids), at, velocity)


def cable(rng: np.random.Generator, at: Triple) -> Placed:
    """A cable that hangs slanting through the water, from far above to far below."""
    foot = np.array([*rng.uniform(-1.5, 1.5, 1), 8.0, *rng.uniform(-0.5, 0.5, 1)])
    radius = rng.uniform(*CABLE_M)
    return Placed(bare(rng, [Frustum(foot, -foot, radius, radius, _ROPE)]), at)


def net(rng: np.random.Generator, at: Triple) -> Placed:
    """A lost fishing net that hangs upright across the way, between two ropes."""
    width_m, height_m = _NET_M
    across, down = np.array([width_m / 2, 0.0, 0.0]), np.array([0.0, height_m / 2, 0.0])
    lines = [
        (y, across, 0.02 if abs(y[1]) == height_m / 2 else _TWINE_M)
        for y in np.linspace(-down, down, round(height_m / _MESH_M) + 1)
    ]
    lines += [
        (x, down, _TWINE_M) for x in np.linspace(-across, across, round(width_m / _MESH_M) + 1)
    ]
    turn = upright(float(rng.uniform(-0.5, 0.5)))
    solids = [
        Frustum((middle - half) @ turn, (middle + half) @ turn, radius, radius, _ROPE)
        for middle, half, radius in lines
    ]
    return Placed(bare(rng, solids), at)


def sea_floor(rng: np.random.Generator, level_m: float) -> tuple[Floor, Placed]:
    """Ground that rises and falls along the way, `level_m` below the world's origin there."""
    north = np.array([-25.0, -13.0, -6.0, 0.0, 5.0, 12.0, 25.0])
    down = level_m + rng.normal(0.0, 0.3, len(north)).clip(-0.6, 0.6)
    down[3] = level_m
    slabs = []
    for (z0, y0), (z1, y1) in pairwise(zip(north, down, strict=True)):
        slope = np.arctan2(y1 - y0, z1 - z0)
        cos, sin = np.cos(slope), np.sin(slope)
        axes = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
        half = np.array([_FLOOR_M, _GROUND_M, np.hypot(z1 - z0, y1 - y0)]) / 2
        centre = np.array([0.0, (y0 + y1) / 2, (z0 + z1) / 2]) + half[1] * axes[1]
        slabs.append(Cuboid(centre, axes, half, _GROUND))
    floor = Floor(tuple(north.tolist()), tuple(down.tolist()))
    return floor, Placed(bare(rng, slabs), (0.0, 0.0, 0.0))
