"""One flight of the closed loop: vehicle, cameras, the real runtime, planner and autopilot.

::

    vehicle ── pose ──> renderer ── frames, TCP ──> tokt run ── UDP v2 ──> planner
       ^                                             (process)                │ target
       └──────────────── forces ── autopilot <───────────────────────────────┘

Time is simulated: no frame is rendered before the verdict on the one before has come, so that a
run is the same however busy the machine is. `fallback` goes by the wall clock where the model takes
more than `tokt.inference.policy.policy.MAX_TEXTURE_S`: such a run is flown again. What a verdict's
way takes at sea is put in as `LATENCY_S`.
"""

import math
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common import atomic
from tokt.features.common.arrays import F64, U8
from tokt.features.common.errors import ToktError
from tokt_studies.simulation.rendering.stereo_renderer import StereoRenderer
from tokt_studies.simulation.scene.tower import upright

from .anchor_planner import AnchorPlanner
from .autopilot import STEP_S, Autopilot, Setpoint
from .labview import AVOID_S, BEHIND_IT, BEHIND_OBSTACLE, LabviewPlanner
from .planner import Planner
from .runtime_process import LateVerdictError, RuntimeProcess
from .scenes import KINDS, STATION_M, LoopScene, Station
from .track import IN_VIEW_M, SaidOfFrame, Step, Track
from .vehicle import HULL_RADIUS_M, State, Vehicle

NONE = "none"
METHODS = ("texture", "disparity", "either", "fallback", NONE)
"""Policies of `tokt run`, and the control: a planner that hears nothing."""
_OF_PAIRS = ("disparity", "either", "fallback")

WIDTH = 360
"""Of the frames in pixels, where none is given: the grid's."""
STEPS_A_FRAME = 5
"""Control steps of `STEP_S` from one frame to the next: 4 frames a second."""
LATENCY_S = 0.1
"""From a frame to its verdict at the planner. Source: `tokt bench` on the mission's frames, 5 to
7 ms at the 99th percentile, and a camera's exposure and transfer, assumed."""
MAX_S = 240.0
"""A run that takes longer has not arrived; straight there takes under 30 s."""
TRIES = 5
PILOT_M = (2.0, 0.5)
"""How far back and up the pilot steers, from where he has taken over."""
STEREO_SCALE = "1.0"
"""Of the views matched: frames are rendered as wide as the grid's picture, and are not halved."""
EPOCH_S = 1_461_149_301.0
"""The simulated clock's time at the start, UTC: the sea trial's day."""


OURS = "tokt"
PLANNERS: dict[str, Callable[[LoopScene], Planner | LabviewPlanner]] = {
    OURS: lambda scene: Planner(scene.goal, end_m=scene.end_m),
    "labview": lambda scene: LabviewPlanner(scene.goal, None, scene.end_m),
    "labview-timed": lambda scene: LabviewPlanner(scene.goal, AVOID_S, scene.end_m),
    "sea-trial": lambda scene: LabviewPlanner(
        scene.goal, AVOID_S, scene.end_m, (BEHIND_IT, BEHIND_OBSTACLE)[scene.seed % 2]
    ),
}
"""Ours; the thesis's rule, till the obstacle is out of view or for a time; its fault at sea."""


def uses_model(method: str) -> bool:
    """Whether a method judges frames with a model."""
    return method not in ("disparity", NONE)


def fly(scene: LoopScene, method: str, model: Path | None = None, planner: str = OURS) -> Track:
    """Fly to the goal, into something, or until time is up, by one of `METHODS` and `PLANNERS`.

    A `ToktError` says that the runtime ended, hung or answered with anything but verdicts, or was
    late in each of `TRIES`.
    """
    for _ in range(TRIES):
        with suppress(LateVerdictError), _runtime(scene, method, model) as runtime:
            return _Run(scene, method, runtime, planner).fly()
    raise ToktError("the machine is too busy for verdicts in time: try fewer --jobs")


@contextmanager
def _runtime(scene: LoopScene, method: str, model: Path | None) -> Iterator[RuntimeProcess | None]:
    if method == NONE:
        yield None
        return
    options = ["--policy", method]
    if model is not None:
        options += ["--bundle", str(model)]
    with tempfile.TemporaryDirectory(prefix="tokt-closed-loop-") as folder:
        if scene.station is not None:
            options += ["--anchor-from", _named(scene, scene.station, Path(folder))]
        if method in _OF_PAIRS:
            calibration = Path(folder) / "calibration.yml"
            scene.rig.write(calibration)
            options += ["--calibration", str(calibration), "--stereo-scale", STEREO_SCALE]
        with RuntimeProcess(options) as runtime:
            yield runtime


def _named(scene: LoopScene, station: Station, folder: Path) -> str:
    """What the person names before the run: a picture from the start, and the box there."""
    start, file = scene.start, folder / "named.png"
    renderer = StereoRenderer(scene.world, scene.rig, scene.seed)
    picture = renderer.left(0.0, start.camera, start.heading_rad, start.velocity_world)
    atomic.write_bytes(file, cv2.imencode(".png", picture)[1].tobytes())
    (x, y), (wide, high) = _projected(scene, station, start)
    box = ",".join(f"{side:.0f}" for side in (x - wide / 2, y - high / 2, wide, high))
    return f"{file}:{box}"


def _projected(scene: LoopScene, station: Station, state: State) -> tuple[F64, F64]:
    """Where the object is in the left picture, and its size there, in pixels: x, y."""
    camera, _ = scene.rig.cameras(upright(state.heading_rad), state.camera)
    seen = camera.seen(station.middle)
    return camera.place(seen), camera.matrix[0, 0] / seen[2] * station.size_m


NOT_HELD, HELD_IT, HELD_ANOTHER = range(3)
"""What was said of the anchor in a frame, held against where the object is."""
TRUE_PART, TRUE_SIZE = 0.25, 0.3
"""The centre that was said may be this part of the object's size beside it, and ln of the size."""


def anchor_truth(scene: LoopScene, state: State, said: dict[str, Any]) -> int:
    """Whether a datagram speaks of the object that was named."""
    station = scene.station
    if station is None or said["anchor_size"] is None:
        return NOT_HELD
    middle, size = _projected(scene, station, state)
    told = np.array([said["anchor_x"] + 1, said["anchor_y"] + 1]) / 2
    told *= scene.rig.width, scene.rig.height
    beside = np.abs(told - middle) > TRUE_PART * size
    ratio = station.distance_m / float(station.middle[2] - state.camera[2])
    wrong = beside.any() or abs(said["anchor_size"] - math.log(ratio)) > TRUE_SIZE
    return HELD_ANOTHER if wrong else HELD_IT


class _Run:
    """The state of one run."""

    def __init__(
        self, scene: LoopScene, method: str, runtime: RuntimeProcess | None, planner: str
    ) -> None:
        self._scene, self._method, self._runtime = scene, method, runtime
        self._pairs = method in _OF_PAIRS
        self._renderer = StereoRenderer(scene.world, scene.rig, scene.seed)
        self._vehicle = Vehicle(scene.start, scene.world.current)
        self._autopilot = Autopilot()
        self._planner: Planner | LabviewPlanner | AnchorPlanner
        if scene.station is not None:
            self._planner = AnchorPlanner()
        elif runtime is None:
            self._planner = Planner(scene.goal, deaf=True, end_m=scene.end_m)
        else:
            self._planner = PLANNERS[planner](scene)
        self._piloted: F64 | None = None  # where the pilot steers to
        self._steps: list[Step] = []
        self._frames: list[SaidOfFrame] = []
        self._held: list[int] = []
        self._said: tuple[float, dict[str, Any]] | None = None

    def fly(self) -> Track:
        station = self._scene.station
        for step in range(round((MAX_S if station is None else station.until_s) / STEP_S)):
            t_s = step * STEP_S
            if step % STEPS_A_FRAME == 0:
                self._frame(step // STEPS_A_FRAME + 1, t_s)
            heard = None
            if self._said is not None and t_s >= self._said[0] + LATENCY_S - STEP_S / 2:
                heard, self._said = self._said[1], None
            if station is not None:
                self._vehicle.current = station.current_at(t_s)
            state = self._vehicle.state
            target = self._at_altitude(self._planner.target(t_s, state, heard, self._pilot(t_s)))
            clearance = float(self._scene.world.clearance_m(state.position[None], t_s)[0])
            self._steps.append((t_s, state, target.mode, clearance))
            if self._planner.reached or clearance < HULL_RADIUS_M:
                break
            # On station nothing tells it where it is, nor its speed over ground.
            nav = state if station is None else self._vehicle.through_water
            self._vehicle.step(STEP_S, self._autopilot.forces(nav, target))
        scene, planner = self._scene, self._planner
        return Track.recorded(
            KINDS[scene.name].title, scene.name, self._method, scene.seed, self._steps,
            self._frames, planner.avoidances, planner.reached or self._kept_station(),
            None if station is None else scene.goal, self._held,
        )  # fmt: skip

    def _kept_station(self) -> bool:
        """Whether it was near the wanted place until the end."""
        station = self._scene.station
        if station is None or self._steps[-1][0] < station.until_s - 2 * STEP_S:
            return False
        places = np.array([state.position for _, state, _, _ in self._steps])
        return bool(np.linalg.norm(places - self._scene.goal, axis=1).max() <= STATION_M)

    def _pilot(self, t_s: float) -> F64 | None:
        """Where the pilot steers to while he flies: back the way it came, and up."""
        flown = self._scene.pilot_s
        if flown is None or not flown[0] <= t_s < flown[1]:
            return None
        if self._piloted is None:
            state, (back, up) = self._vehicle.state, PILOT_M
            sine, cosine = math.sin(state.heading_rad), math.cos(state.heading_rad)
            self._piloted = state.position - np.array([back * sine, up, back * cosine])
        return self._piloted

    def _at_altitude(self, target: Setpoint) -> Setpoint:
        """The same at the altitude that is to be held, where one is."""
        floor, wanted_m = self._scene.world.floor, self._scene.altitude_m
        if floor is None or wanted_m is None:
            return target
        own = self._vehicle.state.position
        east, _, north = target.position
        down = own[1] + floor.altitude_m(own) - wanted_m
        return replace(target, position=np.array([east, down, north]))

    def _frame(self, number: int, t_s: float) -> None:
        """Take a frame, have it judged, and keep the verdict for when it arrives."""
        if self._runtime is None:
            return
        left, right = self._look(t_s)
        said = self._runtime.judge(number, EPOCH_S + t_s, left, right)
        self._said = (t_s, said)
        state = self._vehicle.state
        in_view = self._renderer.sees_solid(t_s, state.camera, state.heading_rad, IN_VIEW_M)
        self._frames.append((t_s, said["status"], in_view))
        self._held.append(anchor_truth(self._scene, state, said))

    def _look(self, t_s: float) -> tuple[U8 | None, U8 | None]:
        blind, state = self._scene.blind_s, self._vehicle.state
        if blind is not None and blind[0] <= t_s < blind[1]:
            return None, None
        pose = (t_s, state.camera, state.heading_rad, state.velocity_world)
        return self._renderer.pair(*pose) if self._pairs else (self._renderer.left(*pose), None)
