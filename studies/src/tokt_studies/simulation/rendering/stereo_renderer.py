"""The closed loop's renderer: a vehicle's two cameras in a world, fast enough to fly by.

A frame is made as those of a simulated mission are (`lighting`, `snow`, `sensor`), and goes through
the same JPEG: to a model trained on such missions it looks like theirs.
"""

import cv2
import numpy as np

from tokt.features.common.arrays import F64, U8
from tokt_studies.simulation.scene.closed_loop_world import World
from tokt_studies.simulation.scene.fish_and_dust import fish_texture
from tokt_studies.simulation.scene.rig import Camera, SyntheticRig
from tokt_studies.simulation.scene.surfaces import Materials, Surfaces
from tokt_studies.simulation.scene.tower import upright

from .loop_lighting import ViewMaps, add_dust, surface_light
from .raycast import Hits
from .sensor import SensorNoise, cloud_bank, cut
from .snow import Snow, snow_light
from .synthetic_mission import JPEG

_SNOW, _CLOUDS, _SENSOR, _MOMENT, _DEVELOP = range(10, 15)
_FISH = 2
"""Numbers of the random streams; the last is of the world's, as the scene's are."""


class StereoRenderer:
    """The two cameras of a rig in a world.

    The same seed, time and pose give the same bytes, whatever was asked before. The seed is of the
    sensors' noise and the water's clouds; what is in the world has the world's.
    """

    def __init__(
        self, world: World, rig: SyntheticRig, seed: int, materials: Materials | None = None
    ) -> None:
        self._world, self._rig, self._seed = world, rig, seed
        self._surfaces = Surfaces([thing.shape for thing in world.things])
        textures = [fish_texture(np.random.default_rng([world.seed, _FISH]))]
        textures += [thing.shape.textures for thing in world.things]
        self._materials = materials or Materials(self._surfaces.materials, textures)
        self._snow = Snow(np.random.default_rng([world.seed, _SNOW]), world.water)
        clouds = np.random.default_rng([seed, _CLOUDS])
        self._clouds = cloud_bank(clouds, rig.height, rig.width)
        self._seen = ((0.0, b""), np.inf)
        self._kept: dict[int, tuple[ViewMaps, SensorNoise]] = {}

    def camera(self, side: int) -> tuple[ViewMaps, SensorNoise]:
        """The parts of the left camera (0) or the right one (1) that stay the same."""
        if side not in self._kept:
            water, rig = self._world.water, self._rig
            rng = np.random.default_rng([self._seed, _SENSOR, side])
            noise = SensorNoise(water, rng, rig.height, rig.width)
            self._kept[side] = ViewMaps(water, rig, side), noise
        return self._kept[side]

    def left(self, t_s: float, position: F64, heading_rad: float, velocity: F64) -> U8:
        """The left camera's frame, BGR, from where that is in the world at a time from 0 s on.

        Heading 0 looks along +z, positive turns towards +x; the cameras are level. The velocity
        (m/s over ground, world axes) draws the marine snow out.
        """
        return self._see(0, t_s, self._cameras(position, heading_rad), velocity)

    def pair(self, t_s: float, position: F64, heading_rad: float, velocity: F64) -> tuple[U8, U8]:
        """Both cameras' frames of one moment; see `left`."""
        cameras = self._cameras(position, heading_rad)
        return self._see(0, t_s, cameras, velocity), self._see(1, t_s, cameras, velocity)

    def sees_solid(self, t_s: float, position: F64, heading_rad: float, within_m: float) -> bool:
        """Whether the left camera's frame shows something solid nearer than `within_m`, no fish."""
        left, _ = self._cameras(position, heading_rad)
        if self._seen[0] != (t_s, _pose(left)):
            self._solids(0, t_s, left)
        return self._seen[1] < within_m

    def _cameras(self, position: F64, heading_rad: float) -> tuple[Camera, Camera]:
        """Both cameras, level, with the left one at `position`."""
        return self._rig.cameras(upright(heading_rad), np.asarray(position, np.float64))

    def hits(self, side: int, t_s: float, camera: Camera) -> Hits:
        """What the rays of the left camera (0) or the right one (1) meet: solids, and fish."""
        hits = self._solids(side, t_s, camera)
        if self._world.fish is not None:
            hits.add_fish(self._world.fish, t_s)
        return hits

    def _solids(self, side: int, t_s: float, camera: Camera) -> Hits:
        """Surfaces without fish; the left camera's nearest depth is kept for `sees_solid`."""
        maps, _ = self.camera(side)
        hits = Hits(camera, maps.rays, maps.lamp)
        if self._world.things:
            origins = np.stack([thing.place(t_s) for thing in self._world.things])
            hits.add_solids(self._surfaces, origins)
        if side == 0:
            self._seen = (t_s, _pose(camera)), float(hits.depth.min())
        return hits

    def _see(self, side: int, t_s: float, cameras: tuple[Camera, Camera], velocity: F64) -> U8:
        hits = self.hits(side, t_s, cameras[side])
        frame = self.picture(side, t_s, hits, cameras[0], velocity)
        return np.asarray(
            cv2.imdecode(cv2.imencode(".jpg", frame, JPEG)[1], cv2.IMREAD_COLOR), np.uint8
        )

    def picture(self, side: int, t_s: float, hits: Hits, left: Camera, velocity: F64) -> U8:
        """One camera's frame of what its rays hit, in the water of that time."""
        world, own = self._world, hits.camera
        maps, sensor = self.camera(side)
        micros = round(t_s * 1e6)
        moment = np.random.default_rng([self._seed, _MOMENT, micros])
        light = cut(self._clouds, moment) * np.float32(moment.uniform(0.97, 1.03))
        light *= maps.open_water
        light += maps.floor
        if len(hits.pixels):
            change = surface_light(world.water, self._materials, maps, hits, light)
            light += change.reshape(light.shape)
        if world.dust:
            clouds = [cloud.at(t_s) for cloud in world.dust]
            add_dust(world.water, maps, own, clouds, light, hits.depth)
        current = np.array(world.current)
        snow = snow_light(self._snow, left, own, t_s * current, velocity - current, hits.depth)
        cv2.accumulateProduct(cv2.merge([snow] * 3).reshape(light.shape), maps.snow_gain, light)
        noise = np.random.default_rng([self._seed, _DEVELOP, micros, side])
        return sensor.develop(light, noise)


def _pose(camera: Camera) -> bytes:
    """The same bytes for the same pose only."""
    return np.array([*camera.centre, *camera.rotation.flat]).tobytes()
