"""The pipe and the sea floor as a camera sees them."""

import cv2
import numpy as np

from tokt.features.common.arrays import F32, F64, I64
from tokt_studies.simulation.scene.pipeline import HALF_M, TEXEL_M, Pipeline
from tokt_studies.simulation.scene.rig import Camera
from tokt_studies.simulation.scene.surfaces import Materials
from tokt_studies.simulation.scene.tower import upright

from .raycast import Hits

_FARTHEST_M = 20.0
"""Beyond it the water hides everything."""


class FloorMaterials(Materials):
    """Paints alone: what `FloorHits` has found is the brightness already."""

    def __init__(self, paint: F32) -> None:
        self.paint, self.rust = paint, np.zeros_like(paint)

    def look_up(
        self, material_number: I64, across: F32, along: F32, pixel_m: F32
    ) -> tuple[F32, F32]:
        """See `Materials.look_up`; rust is nowhere."""
        return along, across


class FloorHits(Hits):
    """The pipe and the floor in one frame; both are straight about `along_m` of the route."""

    def __init__(
        self, camera: Camera, rays: F32, lamp: F64, pipeline: Pipeline, along_m: float
    ) -> None:
        super().__init__(camera, rays, lamp)
        point, heading = pipeline.axis(along_m)
        axes = upright(float(heading))
        turn = axes @ camera.rotation.T
        x, y, z = turn.astype(np.float32) @ rays
        origin = axes @ (camera.centre - point)
        ox, oy, oz = origin.tolist()
        lx, ly, _ = (origin + turn @ lamp).tolist()
        radius, floor = pipeline.radius_m, pipeline.lift_m
        with np.errstate(divide="ignore", invalid="ignore"):
            ground = np.where(y > 0, np.float32(floor - oy) / y, np.float32(np.inf))
            square, half = x * x + y * y, ox * x + oy * y
            root = half * half - square * np.float32(ox * ox + oy * oy - radius**2)
            pipe = (-half - np.sqrt(root)) / square
        on_pipe = (root > 0) & (pipe > 0) & (pipe < ground)
        t = np.where(on_pipe, pipe, ground)
        t[t > _FARTHEST_M] = np.inf
        self.depth = t
        t = np.minimum(t, np.float32(_FARTHEST_M))
        aside, down = np.float32(ox) + t * x, np.float32(oy) + t * y
        edge = pipeline.half_arc_m - np.sqrt(radius**2 - floor**2)
        across = aside + np.copysign(np.float32(edge), aside)
        won = np.flatnonzero(on_pipe)
        x, y = aside.take(won), down.take(won)
        across[won] = np.arctan2(x, -y) * np.float32(radius)
        self.facing[:] = floor - ly
        self.facing[won] = ((lx - x) * x + (ly - y) * y) / np.float32(radius)
        self._look_up(pipeline, across, np.float32(along_m + oz) + t * z)

    def _look_up(self, pipeline: Pipeline, across: F32, along: F32) -> None:
        """Read the map: what lies there, and its brightness."""
        # OpenCV reads in pictures of fewer than 32,768 rows: in what is in view.
        first, last = (np.clip(end / TEXEL_M, 0, None) for end in (along.min(), along.max()))
        rows = slice(max(min(int(first), len(pipeline.bright) - 8), 0), int(last) + 8)
        column = across * np.float32(1 / TEXEL_M) + np.float32(HALF_M / TEXEL_M - 0.5)
        row = along * np.float32(1 / TEXEL_M) - np.float32(rows.start + 0.5)
        shape, edge = (self.camera.height, self.camera.width), cv2.BORDER_REFLECT_101
        where = column.reshape(shape), row.reshape(shape)
        nearest = cv2.remap(pipeline.what[rows], *where, cv2.INTER_NEAREST, borderMode=edge)
        self.what = np.asarray(nearest, np.uint8)
        bright = cv2.remap(pipeline.bright[rows], *where, cv2.INTER_LINEAR, borderMode=edge)
        self.along = bright.ravel() * np.float32(1 / 255)
        self.material_number = (self.what & 7).ravel().astype(np.int64)
