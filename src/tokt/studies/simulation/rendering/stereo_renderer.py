"""The closed loop's renderer: a vehicle's two cameras in a world, fast enough to fly by.

A frame is made as those of a simulated mission are (`lighting`, `snow`, `sensor`), and goes through
the same JPEG: to a model trained on such missions it looks like theirs.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.closed_loop_world import World
from tokt.studies.simulation.scene.rig import SyntheticRig
from tokt.studies.simulation.scene.surfaces import Surfaces

from .drifting_snow import Snow, snow_light
from .dust_light import add_dust
from .fast_lighting import surface_light
from .fast_raycast import Hits
from .fast_raycast_fish import add_fish
from .fast_raycast_stalks import add_stalks
from .noise_bank import SensorNoise, cloud_bank
from .synthetic_mission import JPEG
from .view_maps import Standpoint, ViewMaps

Float = NDArray[np.float64]
Frame = NDArray[np.uint8]

_SNOW, _CLOUDS, _SENSOR, _MOMENT, _DEVELOP = range(10, 15)
"""Numbers of the random streams."""


class StereoRenderer:
    """The two cameras of a rig in a world.

    The same seed, time and pose give the same bytes, whatever was asked before.

    Parameters
    ----------
    seed : int
        Of the sensors' noise and the water's clouds; what is in the world has the world's.
    """

    def __init__(self, world: World, rig: SyntheticRig, seed: int) -> None:
        self._world, self._rig, self._seed = world, rig, seed
        self._surfaces = Surfaces.of(world)
        self._snow = Snow.draw(np.random.default_rng([world.seed, _SNOW]), world.water)
        clouds = np.random.default_rng([seed, _CLOUDS])
        self._clouds = cloud_bank(clouds, rig.height, rig.width)
        self._left = _CameraState(world, rig, seed, 0)
        self._seen = (b"", np.inf)

    @cached_property
    def _right(self) -> _CameraState:
        return _CameraState(self._world, self._rig, self._seed, 1)

    def left(self, t_s: float, position: Float, heading_rad: float, velocity: Float) -> Frame:
        """The left camera's frame.

        Parameters
        ----------
        t_s : float
            From 0 s on.
        position : (3,) array
            The left camera, world coordinates, m.
        heading_rad : float
            0 looks along +z, positive turns towards +x; the cameras are level.
        velocity : (3,) array
            m/s over ground, world axes: draws the marine snow out.

        Returns
        -------
        numpy.ndarray
            uint8, (height, width, 3), BGR.
        """
        return self._see(self._left, t_s, position, heading_rad, velocity)

    def pair(
        self, t_s: float, position: Float, heading_rad: float, velocity: Float
    ) -> tuple[Frame, Frame]:
        """Both cameras' frames of one moment; see `left`."""
        return (
            self._see(self._left, t_s, position, heading_rad, velocity),
            self._see(self._right, t_s, position, heading_rad, velocity),
        )

    def sees_solid(self, t_s: float, position: Float, heading_rad: float, within_m: float) -> bool:
        """Whether the left camera's frame shows something solid nearer than `within_m`, no fish.

        Parameters
        ----------
        t_s, position, heading_rad
            As of `left`.
        within_m : float
            Metres along the optical axis.
        """
        left = Standpoint.of(self._left.maps, np.asarray(position, np.float64), heading_rad)
        if self._seen[0] != _moment(t_s, left):
            self._solids(self._left, left, t_s)
        return self._seen[1] < within_m

    def _solids(self, camera: _CameraState, own: Standpoint, t_s: float) -> Hits:
        """Surfaces without fish; the left camera's nearest depth is kept for `sees_solid`."""
        hits = Hits(camera.maps, own)
        if self._world.things:
            origins = np.array([thing.origin(t_s) for thing in self._world.things])
            hits.add_solids(self._surfaces, origins)
            add_stalks(hits, self._surfaces.stalks, origins)
        if camera is self._left:
            self._seen = _moment(t_s, own), float(hits.depth.min())
        return hits

    def _see(
        self, camera: _CameraState, t_s: float, position: Float, heading_rad: float, velocity: Float
    ) -> Frame:
        world, maps = self._world, camera.maps
        micros = round(t_s * 1e6)
        left = Standpoint.of(self._left.maps, np.asarray(position, np.float64), heading_rad)
        own = Standpoint.of(maps, left.centre, heading_rad)
        hits = self._solids(camera, own, t_s)
        if world.fish is not None:
            add_fish(hits, world.fish, t_s)
        moment = np.random.default_rng([self._seed, _MOMENT, micros])
        light = self._clouds.cut(moment) * np.float32(moment.uniform(0.97, 1.03))
        light *= maps.open_water
        light += maps.floor
        if hits.any:
            light += surface_light(world.water, self._surfaces.materials, hits, light).reshape(
                light.shape
            )
        if world.dust:
            clouds = [cloud.at(t_s) for cloud in world.dust]
            add_dust(world.water, maps, own, clouds, light, hits.depth)
        current = np.array(world.current)
        snow = snow_light(
            self._snow, maps, left, own, t_s * current, velocity - current, hits.depth
        )
        cv2.accumulateProduct(cv2.merge([snow] * 3).reshape(light.shape), maps.snow_gain, light)
        noise = np.random.default_rng([self._seed, _DEVELOP, micros, camera.side])
        frame = camera.sensor.develop(light, noise)
        return np.asarray(
            cv2.imdecode(cv2.imencode(".jpg", frame, JPEG)[1], cv2.IMREAD_COLOR), np.uint8
        )


def _moment(t_s: float, standpoint: Standpoint) -> bytes:
    """The same bytes for the same time and pose only."""
    return np.array([t_s, *standpoint.centre, *standpoint.rotation.flat]).tobytes()


class _CameraState:
    """The parts of one camera that stay the same."""

    def __init__(self, world: World, rig: SyntheticRig, seed: int, side: int) -> None:
        self.side = side
        self.maps = ViewMaps.of(world.water, rig, side)
        rng = np.random.default_rng([seed, _SENSOR, side])
        self.sensor = SensorNoise.of(world.water, rng, rig.height, rig.width)
