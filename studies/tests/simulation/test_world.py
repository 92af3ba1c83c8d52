"""The world of the closed loop: what is where, how far it is, and how it moves."""

import hashlib
from itertools import product

import numpy as np
import pytest

from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt_studies.simulation.scene.closed_loop_world import Placed, World
from tokt_studies.simulation.scene.fish_and_dust import DustCloud
from tokt_studies.simulation.scene.obstacles import cable, net, sea_floor, trap
from tokt_studies.simulation.scene.tower import GREY, NO_STALKS, Cuboid, Frustum, Tower, panels
from tokt_studies.simulation.scene.water import Water


def test_missions_have_the_bytes_they_had_before_there_was_a_world(tmp_path):
    """The world's modules use parts of the missions' renderer: its output must stay as it was."""
    simulate_mission(tmp_path / "dive", seed=7, n_frames=5, width=160, jobs=1)
    digest = hashlib.sha256()
    for path in sorted((tmp_path / "dive").rglob("*")):
        if path.is_file():
            digest.update(path.relative_to(tmp_path / "dive").as_posix().encode())
            digest.update(path.read_bytes())
    before = "27fbf18295f5700d1526f758f4ed9c4f015450986f5344a3ccb156602b0ceb2c"
    assert digest.hexdigest() == before


def surface_points(solid, step_m=0.01):
    """Points (n, 3) on all of a solid's surface, at most about `step_m` apart."""
    if isinstance(solid, Cuboid):
        faces = []
        for axis, side in product(range(3), (-1, 1)):
            grid = [np.linspace(-half, half, int(2 * half / step_m) + 2) for half in solid.half]
            grid[axis] = np.array([side * solid.half[axis]])
            faces.append(np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, 3))
        return solid.centre + np.concatenate(faces) @ solid.axes
    widest = max(solid.start_radius, solid.end_radius)
    angles = np.arange(0, 2 * np.pi, step_m / widest)
    rims = {end: np.array([solid.on_surface(a, end)[0] for a in angles]) for end in (0.0, 1.0)}
    along = np.linspace(0, 1, int(solid.length / step_m) + 2)[:, None, None]
    parts = [rims[0.0] + along * (rims[1.0] - rims[0.0])]
    for middle, rim in ((solid.start, rims[0.0]), (solid.end, rims[1.0])):
        share = np.linspace(0, 1, int(widest / step_m) + 2)[:, None, None]
        parts.append(middle + share * (rim - middle))
    return np.concatenate([part.reshape(-1, 3) for part in parts])


def test_clearance_is_that_of_points_all_over_the_surfaces():
    rng = np.random.default_rng(2)
    up = np.array([0.1, -0.9, 0.2])
    parts = (
        Frustum(np.zeros(3), up, 0.30, 0.12, GREY),
        Frustum(np.array([0.5, 0.2, 0.1]), np.array([0.8, 0.3, 0.1]), 0.05, 0.05, GREY),
        Cuboid(np.array([-0.6, 0.1, 0.2]), np.eye(3), np.array([0.2, 0.1, 0.05]), GREY),
    )
    at = (1.0, 0.5, -2.0)
    world = World(Water(), (Placed(Tower(parts, NO_STALKS, ()), at),))
    surface = np.concatenate([surface_points(solid) for solid in parts]) + at
    points = surface.mean(axis=0) + rng.normal(0, 0.8, (150, 3))
    brute = np.array([np.linalg.norm(surface - point, axis=1).min() for point in points])
    exact = world.clearance_m(points)
    inside = exact == 0
    assert 0 < inside.sum() < 30
    assert (exact <= brute + 1e-9).all()
    # Between points 1 cm apart the nearest is at most 7 mm aside, on a bend of at least 5 cm.
    assert (brute[~inside] - exact[~inside] <= 1e-3).all()
    assert np.isinf(World(Water()).clearance_m(points)).all()


def test_a_trap_is_open_towards_the_vehicle_only():
    rng = np.random.default_rng(1)
    world = World(Water(), (trap(rng, (0.0, 0.0, 5.0), width_m=3.0, depth_m=2.0, height_m=2.0),))
    inside = np.array([[0.0, 0.0, 4.0], [0.0, 0.0, 3.0], [1.0, 0.0, 4.5], [0.0, 0.0, 0.0]])
    assert world.clearance_m(inside) == pytest.approx(
        [0.94, 1.44, 0.44, np.hypot(1.44, 3.0)], abs=1e-9
    )
    across = panels(rng, [(0.0, 0.0, np.pi / 2, 3.0)], 3.0)
    panel = World(Water(), (Placed(across, (0.0, 0.0, 5.0)),))
    assert panel.clearance_m(np.array([[2.0, 0.0, 5.0]]))[0] == pytest.approx(1.94)


def test_dust_drifts_spreads_and_thins():
    cloud = DustCloud.draw(np.random.default_rng(5), (0.0, 0.0, 2.0), (0.1, 0.0, 0.0))
    start, later = cloud.at(0.0), cloud.at(30.0)
    assert np.allclose(later.centre - start.centre, [3.0, 0.0, 0.0])
    assert (later.size > start.size).all()
    mass = [(puffs.density * puffs.size**3).sum() for puffs in (start, later)]
    assert mass[1] / mass[0] == pytest.approx(np.exp(-30.0 / 90.0))
    assert (later.density < start.density * np.exp(-30.0 / 90.0)).all()


def test_a_cable_hangs_right_through_the_water_and_a_net_has_meshes():
    rng = np.random.default_rng(5)
    for _ in range(5):
        line = World(Water(), (cable(rng, (0.3, -0.1, 2.0)),))
        assert line.clearance_m(np.array([[0.3, -0.1, 2.0]]))[0] == 0.0
        ends = line.clearance_m(np.array([[0.3, down, 2.0] for down in (-6.0, 6.0)]))
        assert (ends < 1.5).all()
    web = World(Water(), (net(rng, (0.0, 0.0, 2.0)),))
    rows = np.linspace(-1.2, 1.2, 200)
    away = web.clearance_m(np.array([[0.02, down, 2.0] for down in rows]))
    assert away.max() < 0.11 and (away > 0.03).any(), "through a mesh, never far from its twine"
    assert web.clearance_m(np.array([[0.0, 0.0, 5.0]]))[0] > 2.0


def test_the_altitude_is_down_to_the_ground_that_is_drawn():
    floor, ground = sea_floor(np.random.default_rng(6), 2.3)
    world = World(Water(), (ground,), floor=floor)
    assert floor.altitude_m(np.zeros(3)) == pytest.approx(2.3)
    for north in np.linspace(-20, 20, 41):
        above = np.array([1.0, 0.5, north])
        altitude = floor.altitude_m(above)
        just_over = above + np.array([0.0, altitude - 0.01, 0.0])
        under = above + np.array([0.0, altitude + 0.05, 0.0])
        assert 0 < world.clearance_m(just_over[None])[0] <= 0.0101
        assert world.clearance_m(under[None])[0] < 0.002, north
    assert np.ptp(floor.down_m) > 0.2, "it rises and falls"
