"""A geometric stand-in for the camera and the runtime: what the planner is tuned and tested on."""

import math
from collections import deque
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from tokt_studies.simulation.loop.autopilot import STEP_S, Autopilot
from tokt_studies.simulation.loop.planner import Planner
from tokt_studies.simulation.loop.track import Track
from tokt_studies.simulation.loop.vehicle import HULL_RADIUS_M, State, Vehicle

START_M, GOAL_M = -14.0, 12.0
FRAME_STEPS = 5
HALF_VIEW = math.radians(17.0)
COLUMNS = 10


def tower(east, north, radius=0.85):
    """Outline of a tower: a circle, as far as its feet reach."""
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    return np.stack([east + radius * np.sin(angle), north + radius * np.cos(angle)], axis=1)


def trap(east, north, thick=0.2):
    """Outline of a U, 3 m deep and 4 m wide inside, open to the south; `north` is its end wall."""
    inside, outside = 2.0, 2.0 + thick
    port = [(-outside, thick), (-outside, -3), (-inside, -3), (-inside, 0)]
    starboard = [(-x, y) for x, y in reversed(port)]
    return np.array(port + starboard, float) + np.array([east, north])


@dataclass(frozen=True)
class Sea:
    """What is there; `seen` are the outlines that the camera can see, `solid` what can be hit."""

    solid: tuple[np.ndarray, ...] = ()
    seen: tuple[np.ndarray, ...] = ()
    height: float = 0.5  # share of the frame's height that it covers
    farthest_m: float = 8.0
    false_alarms: float = 0.0
    current: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0  # of the whole transit
    version: int = 2
    stereo: bool = False
    fish: bool = False
    silent_s: tuple[float, float] = (0.0, 0.0)
    unknown_s: tuple[float, float] = (0.0, 0.0)
    name: str = "sea"


@lru_cache(maxsize=8)
def _joined(key):
    outlines = [np.frombuffer(data).reshape(-1, 2) for data in key]
    ends = [np.roll(outline, -1, axis=0) for outline in outlines]
    return np.concatenate(outlines), np.concatenate(ends)


def _segments(outlines):
    return _joined(tuple(outline.tobytes() for outline in outlines))


def clearance(outlines, place):
    """Metres to the nearest outline."""
    if not outlines:
        return math.inf
    starts, ends = _segments(outlines)
    way = ends - starts
    share = np.clip(((place - starts) * way).sum(1) / (way * way).sum(1), 0, 1)
    return float(np.hypot(*(starts + share[:, None] * way - place).T).min())


def ranges(outlines, place, bearings):
    """Metres to what rays of these bearings meet; infinite where they meet nothing."""
    if not outlines:
        return np.full(len(bearings), np.inf)
    starts, ends = _segments(outlines)
    ray = np.stack([np.sin(bearings), np.cos(bearings)], axis=1)[:, None]
    way, off = (ends - starts)[None], (starts - place)[None]
    cross = ray[..., 0] * way[..., 1] - ray[..., 1] * way[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (off[..., 0] * way[..., 1] - off[..., 1] * way[..., 0]) / cross
        share = (off[..., 0] * ray[..., 1] - off[..., 1] * ray[..., 0]) / cross
    hit = (far > 0) & (share >= 0) & (share <= 1)
    return np.where(hit, far, np.inf).min(axis=1)


@dataclass
class Camera:
    """The cone of view, how likely what is in it is seen, and a frame rule of 3 in 5."""

    sea: Sea
    rng: np.random.Generator
    hits: deque[bool] = field(default_factory=lambda: deque(maxlen=5))

    def datagram(self, state, t_s):
        """What the runtime would send of the frame taken now."""
        sea = self.sea
        if sea.silent_s[0] <= t_s < sea.silent_s[1]:
            return None
        if sea.unknown_s[0] <= t_s < sea.unknown_s[1]:
            return None if sea.version == 1 else self._fields(-1, None, None)
        rays = np.linspace(-HALF_VIEW, HALF_VIEW, 6 * COLUMNS + 1)[:-1] + HALF_VIEW / 6 / COLUMNS
        far = ranges(sea.seen, state.camera[[0, 2]], state.heading_rad + rays)
        # Surely seen in half of the range, and with less and less likelihood out to its end.
        likely = np.clip(2.0 * (1 - far / sea.farthest_m), 0.0, 0.95)
        white = (far < np.inf).reshape(COLUMNS, -1).any(axis=1)
        white &= self.rng.random(COLUMNS) < likely.reshape(COLUMNS, -1).max(axis=1)
        self.hits.append(bool(white.any()))
        if self.rng.random() < sea.false_alarms:
            white[self.rng.integers(COLUMNS)] = True
        elif sum(self.hits) < 3:
            white[:] = False
        if not white.any():
            return self._fields(0, None, None)
        seen = far.reshape(COLUMNS, -1)[white].min()
        return self._fields(1, np.flatnonzero(white), float(seen))

    def solid_in_view(self, state):
        """Whether the camera looks at something solid within 10 m."""
        rays = state.heading_rad + np.linspace(-HALF_VIEW, HALF_VIEW, 41)
        return bool((ranges(self.sea.solid, state.camera[[0, 2]], rays) < 10.0).any())

    def _fields(self, status, white, far):
        x, box, mean = (None, None, None) if status < 0 else (0, None, 0.0)
        if white is not None:
            x = -int(round((white.mean() + 0.5) * 36) - 180)
            box = [int(white[0]) * 36, 60, int(white[-1] - white[0] + 1) * 36, 150]
            mean = 255.0 * len(white) / COLUMNS * self.sea.height
        if self.sea.version == 1:
            return {"v": 1, "status": status, "x": x, "y": 0, "mean": mean}
        distance = far if self.sea.stereo and far is not None and far < 9 else None
        seen = {"v": 2, "status": status, "x": x, "y": x, "box": box, "mean": mean}
        return {**seen, "distance_m": distance, "contact_s": None}


def fly(sea, seed, deaf=False, most_s=240.0):
    """One transit from START_M to GOAL_M along the sea's heading."""
    rng = np.random.default_rng(seed)
    camera = Camera(sea, rng)
    ahead = np.array([math.sin(sea.heading), 0.0, math.cos(sea.heading)])
    vehicle = Vehicle(State(START_M * ahead, sea.heading, np.zeros(3)), sea.current)
    planner, autopilot = Planner(GOAL_M * ahead, deaf), Autopilot()
    steps, frames, waiting = [], [], None
    for step in range(int(most_s / STEP_S)):
        t_s, heard = step * STEP_S, None
        if step % FRAME_STEPS == 0:
            # What was seen in one frame is heard when the next is taken.
            heard, waiting = waiting, camera.datagram(vehicle.state, t_s)
            status = waiting["status"] if waiting else -1
            frames.append((t_s, status, camera.solid_in_view(vehicle.state)))
        target = planner.target(t_s, vehicle.state, heard)
        away = clearance(sea.solid, vehicle.state.position[[0, 2]])
        steps.append((t_s, vehicle.state, target.mode, away))
        if planner.reached or away < HULL_RADIUS_M:
            break
        vehicle.step(STEP_S, autopilot.forces(vehicle.state, target))
    said = (steps, frames, planner.avoidances, planner.reached)
    return Track.recorded("stand-in", sea.name, "stand-in", seed, *said)


def _turned(sea):
    """The same sea with everything turned about the origin to its heading."""
    sine, cosine = math.sin(sea.heading), math.cos(sea.heading)
    matrix = np.array([[cosine, -sine], [sine, cosine]])
    solid, seen = (tuple(one @ matrix for one in outlines) for outlines in (sea.solid, sea.seen))
    return replace(sea, solid=solid, seen=seen)


def draw_sea(kind, seed, **changes):
    """One of the scenes, drawn from a seed."""
    rng = np.random.default_rng([seed, 7])
    off, second, radius = rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(0.2, 0.85)
    solid, seen, height = (), (), 0.5
    if kind in ("tower", "current", "far"):
        solid, seen = (tower(off, 0.0),), (tower(off, 0.0, radius),)
    elif kind == "two":
        apart = rng.uniform(5.0, 8.0)
        solid = tower(off, -3.0), tower(second, apart - 3.0)
        seen = tower(off, -3.0, radius), tower(second, apart - 3.0, radius)
    elif kind == "trap":
        solid = seen = (trap(off, 2.0),)
        height = 1.0
    current = (float(rng.choice([-0.2, 0.2])), 0.0, 0.0) if kind == "current" else (0.0, 0.0, 0.0)
    sea = Sea(solid, seen, height, current=current, name=kind)
    return _turned(replace(sea, **changes))


@pytest.fixture(scope="session")
def stand_in():
    """The stand-in's functions and classes."""
    return SimpleNamespace(Sea=Sea, draw=draw_sea, fly=fly, tower=tower, trap=trap)
