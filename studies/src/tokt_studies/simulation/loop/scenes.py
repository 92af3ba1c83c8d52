"""The scenes of the closed loop: what is in the water, where the vehicle starts and has to go.

::

        z (north)         A seed draws the water, the tower, where it stands across the way, the
        ^    x goal       vehicle's depth, and what moves. The same seed gives the same scene,
        |    :            whatever method flies it.
        |   #:#  tower at about the origin
        |    :
        |    ^ start, heading north
        +--------> x (east)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tokt.features.common.arrays import F64
from tokt_studies.simulation.scene import obstacles
from tokt_studies.simulation.scene.closed_loop_world import Placed, World
from tokt_studies.simulation.scene.fish_and_dust import DustCloud, School
from tokt_studies.simulation.scene.rig import SyntheticRig
from tokt_studies.simulation.scene.water import Triple, Water

from .vehicle import CAMERA_AHEAD_M, State

Rng = np.random.Generator

START_M, GOAL_M = -11.0, 6.0
"""Along z: a tower is seen from some 8 to 10 m on, and is passed well before the goal."""
OFFSET_M = 0.6
"""A tower stands up to this far beside the straight way."""
DEPTH_M = (-0.5, 0.3)
"""The vehicle's depth below the collar of the tower: mast, collar or lantern are ahead of it."""
SECOND_M = 6.5
"""Along z: the second tower of two."""
CURRENT_M_S = 0.2
THICK_SNOW = 4
"""Times the snow of the mission."""
FLOOR_M = 2.3
"""The sea floor at the tower, below its collar: where its feet are."""
ALTITUDE_M = 2.0
"""Above the sea floor, to be held by the DVL (thesis, chapter 4)."""
STRUCTURE_M = 5.0
"""The mission at sea ended so near to the structure, on station (paper, part 1)."""
PILOT_S = 15.0
"""How long the pilot flies."""
STATION_M = 0.5
"""Who was never farther off station has kept it."""
SWINGS_S = np.geomspace(4.0, 300.0, 12)  # periods of a current that changes
ON_WAY_M_S = 0.6
"""About what the vehicle goes: who crosses its way straight on meets it."""


class Station(NamedTuple):
    """What the vehicle parks before, an upright rectangle that a person drew, and the current."""

    middle: F64  # (3,), world, m
    size_m: F64  # (2,): width, height
    distance_m: float  # of the camera where it is wanted
    current: F64  # (3,), its mean: east, down, north, m/s
    swings: F64  # (n, 3), m/s, of `SWINGS_S`
    phases: F64  # (n,), rad
    until_s: float = 600.0

    def current_at(self, t_s: float) -> Triple:
        """The water's velocity, m/s."""
        swing = np.sin(2 * np.pi / SWINGS_S * t_s + self.phases) @ self.swings
        east, down, north = (self.current + swing).tolist()
        return east, down, north


@dataclass(frozen=True)
class LoopScene:
    """One seed's scene."""

    name: str
    seed: int
    world: World
    rig: SyntheticRig
    start: State
    goal: F64  # (3,), world coordinates, m
    blind_s: tuple[float, float] | None = None  # between which the cameras give no picture
    pilot_s: tuple[float, float] | None = None  # between which a pilot flies
    altitude_m: float | None = None  # to be held above the sea floor; None: the goal's depth
    station: Station | None = None  # to be kept; then the goal is the vehicle's wanted place
    end_m: float | None = None  # so near to the goal it ends, on station; None: at the goal


class SceneKind(NamedTuple):
    """A kind of scene: its title in tables and maps, and what puts in what is special about it."""

    title: str
    make: Callable[[Rng, LoopScene], LoopScene]


def _with(scene: LoopScene, **changes: object) -> LoopScene:
    return replace(scene, world=replace(scene.world, **changes))  # type: ignore[arg-type]


def _offset(rng: Rng) -> float:
    return float(rng.uniform(-OFFSET_M, OFFSET_M))


def _tower(rng: Rng, scene: LoopScene) -> LoopScene:
    return _with(scene, things=(obstacles.one_tower(rng, (_offset(rng), 0.0, 0.0)),))


def _two(rng: Rng, scene: LoopScene) -> LoopScene:
    towers = [obstacles.one_tower(rng, (_offset(rng), 0.0, z)) for z in (0.0, SECOND_M)]
    goal = scene.goal + np.array([0.0, 0.0, SECOND_M])
    return replace(_with(scene, things=tuple(towers)), goal=goal)


def _trap(rng: Rng, scene: LoopScene) -> LoopScene:
    dead_end = obstacles.trap(rng, (_offset(rng), 0.0, 1.5), width_m=4.0, depth_m=3.0)
    return _with(scene, things=(dead_end,))


def _current(rng: Rng, scene: LoopScene) -> LoopScene:
    across = CURRENT_M_S * float(rng.choice([-1.0, 1.0])) * float(rng.uniform(0.5, 1.0))
    along = float(rng.uniform(-0.5, 0.5)) * CURRENT_M_S
    return _with(_tower(rng, scene), current=(across, 0.0, along))


def _blind(rng: Rng, scene: LoopScene) -> LoopScene:
    start = float(rng.uniform(3.0, 12.0))
    scene = _with(_tower(rng, scene), current=(float(rng.uniform(-0.1, 0.1)), 0.0, 0.0))
    return replace(scene, blind_s=(start, start + 6.0))


def _floor(rng: Rng, scene: LoopScene) -> LoopScene:
    floor, ground = obstacles.sea_floor(rng, FLOOR_M)
    scene = _tower(rng, scene)
    scene = _with(scene, floor=floor, things=(*scene.world.things, ground))
    start, goal = (
        place - np.array([0.0, ALTITUDE_M - floor.altitude_m(place), 0.0])
        for place in (scene.start.position, scene.goal)
    )
    start = replace(scene.start, position=start)
    return replace(scene, start=start, goal=goal, altitude_m=ALTITUDE_M)


def _structure(rng: Rng, scene: LoopScene) -> LoopScene:
    scene = _tower(rng, scene)
    east, _, north = scene.world.things[0].at
    return replace(scene, goal=np.array([east, scene.goal[1], north]), end_m=STRUCTURE_M)


def _pilot(rng: Rng, scene: LoopScene) -> LoopScene:
    start = float(rng.uniform(3.0, 14.0))
    return replace(_tower(rng, scene), pilot_s=(start, start + PILOT_S))


def _vehicle(rng: Rng, scene: LoopScene) -> LoopScene:
    """It crosses the way, or comes along it, and looks at nothing."""
    meets = float(rng.uniform(-6.0, 0.0))
    at_s = (meets - START_M) / ON_WAY_M_S
    # Half of them across, half towards us, and up to 20 degrees off that.
    heading = float(rng.choice([-0.5, 0.5, 1.0, 1.0])) * np.pi + float(rng.uniform(-0.35, 0.35))
    speed = float(rng.uniform(0.2, 0.5))
    velocity = (speed * float(np.sin(heading)), 0.0, speed * float(np.cos(heading)))
    at = (-at_s * velocity[0], scene.start.position[1], meets - at_s * velocity[2])
    return _with(scene, things=(obstacles.other_vehicle(rng, at, velocity, heading),))


def _across(make: Callable[[Rng, Triple], Placed], rng: Rng, scene: LoopScene) -> LoopScene:
    """Something about the origin, at the vehicle's depth."""
    return _with(scene, things=(make(rng, (_offset(rng), scene.start.position[1], 0.0)),))


def _fish(rng: Rng, scene: LoopScene) -> LoopScene:
    side = float(rng.choice([-1.0, 1.0]))
    through = (0.0, scene.start.position[1], float(rng.uniform(-4.0, 0.0)))
    at_s = float(rng.uniform(6.0, 12.0))
    return _with(scene, fish=School(rng, through, at_s, velocity=(0.8 * side, 0.0, 0.0)))


def _snow(rng: Rng, scene: LoopScene) -> LoopScene:
    water = scene.world.water
    return _with(scene, water=replace(water, snow_per_frame=THICK_SNOW * water.snow_per_frame))


def _dust(rng: Rng, scene: LoopScene) -> LoopScene:
    at = (_offset(rng), scene.start.position[1], float(rng.uniform(-5.0, -1.0)))
    drift = (float(rng.normal(0, 0.03)), 0.0, 0.0)
    return _with(scene, dust=(DustCloud.draw(rng, at, drift),))


def _anchor(rng: Rng, scene: LoopScene) -> LoopScene:
    """Parked before a tower, with another beside it."""
    east = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.9, 1.6))
    at = east, float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.5, 2.5))
    things = obstacles.one_tower(rng, (0.0, 0.0, 0.0)), obstacles.one_tower(rng, at)
    # As people draw it: about the head of the tower, from its lantern to its legs.
    middle = np.array([*rng.normal([0.0, 0.12], 0.02), 0.0])
    size_m = rng.uniform([0.5, 0.9], [0.6, 1.05])
    distance_m = float(rng.uniform(3.2, 4.5))
    way, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.2)
    current = np.array([speed * np.sin(way), rng.uniform(-0.02, 0.02), speed * np.cos(way)])
    swings = rng.normal(0.0, [0.02, 0.005, 0.02], (len(SWINGS_S), 3))
    phases = rng.uniform(0, 2 * np.pi, len(SWINGS_S))
    station = Station(middle, size_m, distance_m, current, swings, phases)
    goal = middle - np.array([0.0, 0.0, distance_m + CAMERA_AHEAD_M])
    start = State(goal + rng.normal(0.0, [0.1, 0.06, 0.0]), 0.0, np.zeros(3))
    scene = _with(scene, things=things, current=station.current_at(0.0))
    return replace(scene, goal=goal, start=start, station=station)


ANCHOR = "anchor"  # in which station is kept, and nothing is avoided
KINDS = {
    "tower": SceneKind("one tower", _tower),
    "two": SceneKind("two towers in succession (thesis, figure 5.9)", _two),
    "trap": SceneKind("a dead end (thesis, figure 6.2)", _trap),
    "current": SceneKind("one tower in a current", _current),
    "blind": SceneKind("one tower, no pictures for 6 s", _blind),
    "floor": SceneKind("one tower, altitude held over a sea floor that rises and falls", _floor),
    "structure": SceneKind("the goal is the tower: ends within 5 m of it", _structure),
    "pilot": SceneKind("one tower, the pilot takes over for 15 s", _pilot),
    "vehicle": SceneKind("another vehicle, which does not look", _vehicle),
    "cable": SceneKind("a cable across the way", partial(_across, obstacles.cable)),
    "net": SceneKind("a lost fishing net", partial(_across, obstacles.net)),
    "empty": SceneKind("empty water with marine snow", lambda rng, scene: scene),
    "snow": SceneKind(f"empty water, {THICK_SNOW} times the snow", _snow),
    "fish": SceneKind("a school of fish, nothing to hit", _fish),
    "dust": SceneKind("a cloud of sediment, nothing to hit", _dust),
    ANCHOR: SceneKind("ten minutes on station before a tower in a current", _anchor),
}
"""By name, in the order of tables."""


def draw_scene(name: str, seed: int, width: int) -> LoopScene:
    """The scene of a seed (0 or more), of `KINDS`, with frames of this width in pixels."""
    # Each part has a stream of its own, so that none shifts another.
    place, water, rig, special = (np.random.default_rng([seed, part]) for part in range(4))
    depth = float(place.uniform(*DEPTH_M))
    world = World(Water.draw(water), seed=seed)
    start = State(np.array([0.0, depth, START_M]), 0.0, np.zeros(3))
    goal = np.array([0.0, depth, GOAL_M])
    scene = LoopScene(name, seed, world, SyntheticRig(rig, width), start, goal)
    return KINDS[name].make(special, scene)
