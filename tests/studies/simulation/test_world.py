"""The world of the closed loop: what is where, how far it is, and how it moves."""

import hashlib
from itertools import product

import numpy as np
import pytest

from tokt.studies.simulation.rendering.synthetic_mission import simulate_mission
from tokt.studies.simulation.scene.closed_loop_world import Placed, World
from tokt.studies.simulation.scene.fish_and_dust import DustCloud, School
from tokt.studies.simulation.scene.obstacles import one_tower, trap
from tokt.studies.simulation.scene.tower import GREY, Cuboid, Frustum, Tower, panels
from tokt.studies.simulation.scene.water import Water

pytestmark = pytest.mark.xdist_group("world")


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
    world = World(Water(), (Placed(Tower(parts, (), ()), at),))
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


def test_the_clearance_of_a_whole_tower_is_that_of_its_surface():
    tower = one_tower(np.random.default_rng(2), (0.4, 0.0, 1.0))
    rng = np.random.default_rng(3)
    picks = [rng.permutation(surface_points(solid, 0.03))[:150] for solid in tower.shape.solids]
    on_it = np.concatenate(picks) + np.array([0.4, 0.0, 1.0])
    world = World(Water(), (tower,))
    assert world.clearance_m(on_it) == pytest.approx(0, abs=1e-9)
    collar = tower.shape.solids[1]
    assert isinstance(collar, Frustum)
    ahead = np.array([[0.4, 0.0, -1.0]])  # straight before the collar, which is the widest part
    assert world.clearance_m(ahead)[0] == pytest.approx(2.0 - collar.start_radius)


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


def test_a_school_passes_its_point_on_time_and_holds_together():
    school = School(np.random.default_rng(5), (0.0, 0.3, -6.0), 10.0, (0.5, 0.0, 0.0), count=200)
    there = school.at(10.0)
    assert there.shape == (200, 3)
    assert np.array_equal(there, school.at(10.0))
    assert there.mean(axis=0) == pytest.approx([0.0, 0.3, -6.0], abs=0.25)
    later = school.at(14.0)
    assert (later - there).mean(axis=0) == pytest.approx([2.0, 0.0, 0.0], abs=0.1)
    assert np.abs(later - there - [2.0, 0.0, 0.0]).max() <= 0.3
    moved = (school.at(10.01) - there) / 0.01
    assert moved == pytest.approx(school.swimming(10.005), abs=1e-3)
    assert (school.length_m >= 0.2).all() and (school.length_m <= 0.5).all()
    centre, axes, half = school.shapes(10.0)
    assert np.allclose(axes @ axes.transpose(0, 2, 1), np.eye(3))
    swimming = school.swimming(10.0)
    assert np.allclose(axes[:200, 0] * np.linalg.norm(swimming, axis=1)[:, None], swimming)
    assert (half[:200, 0] <= 0.25).all() and len(centre) == 400


def test_dust_drifts_spreads_and_thins():
    cloud = DustCloud.draw(np.random.default_rng(5), (0.0, 0.0, 2.0), (0.1, 0.0, 0.0))
    start, later = cloud.at(0.0), cloud.at(30.0)
    assert np.allclose(later.centre - start.centre, [3.0, 0.0, 0.0])
    assert (later.size > start.size).all()
    mass = [(puffs.density * puffs.size**3).sum() for puffs in (start, later)]
    assert mass[1] / mass[0] == pytest.approx(np.exp(-30.0 / 90.0))
    assert (later.density < start.density * np.exp(-30.0 / 90.0)).all()
