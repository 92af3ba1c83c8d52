"""Ray casting for the closed loop: `raycast`'s geometry, made for speed.

Only the pixels inside each solid's outline are looked at, in single precision; what a surface
looks like there is worked out once for all of them (`fast_lighting`).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.surfaces import Boxes, Frusta, Surfaces

from .view_maps import Standpoint, ViewMaps

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]

NEAREST_M = 0.05
"""What is nearer to the image plane is not seen."""
_OUTLINE_PX = 8000
"""Corners farther outside than this are cut off before the outline is drawn."""

CORNERS = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
"""Of a cuboid, in half sizes."""


class Hits:
    """The nearest surface at every pixel of one camera, flat.

    Attributes
    ----------
    depth : (pixels,) float32
        Metres along the optical axis; infinite in open water.
    material_number : (pixels,) int64
        Number of the surface's material; only where something was hit, as the following.
    across, along : (pixels,) float32
        Surface coordinates, m; a stalk's `along` is its brightness.
    facing : (pixels,) float32
        Outward normal times the vector to the lamp, m; not a number on a stalk.
    """

    def __init__(self, maps: ViewMaps, standpoint: Standpoint) -> None:
        self.maps, self.standpoint = maps, standpoint
        self.depth: Single = np.full(maps.pixels, np.inf, np.float32)
        self.any = False
        self._outline = np.zeros((maps.height, maps.width), np.uint8)

    def add_solids(self, surfaces: Surfaces, origins: Float) -> None:
        """Cast the rays at all solids; `origins` (things, 3) is where the things are."""
        # A ray along a face never meets it: infinite, and no hit.
        with np.errstate(divide="ignore", invalid="ignore"):
            self._add_frusta(surfaces.frusta, origins)
            boxes = surfaces.boxes
            self._add_boxes(boxes, boxes.centre + origins[boxes.thing])

    @property
    def pixels(self) -> Index:
        """Pixels that show something."""
        return np.flatnonzero(np.isfinite(self.depth))

    def _add_frusta(self, frusta: Frusta, origins: Float) -> None:
        shift = origins[frusta.thing]
        corners = self.standpoint.seen(frusta.hull + shift[:, None])
        turn = (frusta.axes @ self.standpoint.rotation.T).astype(np.float32)
        centre = np.einsum("nij,nj->ni", frusta.axes, self.standpoint.centre - frusta.start - shift)
        lamp = centre + np.einsum("nij,j->ni", turn, self.maps.lamp)
        for i in self.in_view(corners):
            pixels = self.inside(corners[i])
            if len(pixels):
                self._cast_frustum(frusta, i, pixels, turn[i], centre[i].tolist(), lamp[i].tolist())

    def _cast_frustum(
        self, frusta: Frusta, i: int, pixels: Index, turn: Single, o: list[float], lamp: list[float]
    ) -> None:
        """Solved through the rays' distance from the axis: single precision is enough for that."""
        ox, oy, oz = o
        radius, slope, length = (float(v[i]) for v in (frusta.radius, frusta.slope, frusta.length))
        dx, dy, dz = turn @ self.maps.rays.take(pixels, axis=1)
        reach = radius + slope * oy
        a = dx * dx + dz * dz
        along = ox * dx + oz * dz
        cross = ox * dz - oz * dx
        root = a * (reach * reach) - cross * cross
        if slope:
            tilt = slope * dy
            root += tilt * ((ox * ox + oz * oz) * tilt - (2 * reach) * along)
            a -= tilt * tilt
            along -= reach * tilt
        t = (-along - np.sqrt(np.maximum(root, 0))) / a
        height = oy + t * dy
        hit = (root > 0) & (t > 0) & (height >= 0) & (height <= length)
        t[~hit] = np.inf
        end = np.zeros(len(t), np.int8)
        for level, rim, sign in ((0.0, radius, -1), (length, float(frusta.end_radius[i]), 1)):
            if (oy - level) * sign > 0:
                cap = (level - oy) / dy
                on = (cap > 0) & (cap < t) & ((ox + cap * dx) ** 2 + (oz + cap * dz) ** 2 <= rim**2)
                t[on], end[on] = cap[on], sign
        won = np.flatnonzero(t < self.depth.take(pixels))
        if not len(won):
            return
        t, end = t[won], end[won]
        x, y, z = ox + t * dx[won], oy + t * dy[won], oz + t * dz[won]
        wide = radius + slope * y
        facing = ((lamp[0] - x) * x + (lamp[2] - z) * z) / wide - slope * (lamp[1] - y)
        # The seam of the texture lies opposite the first axis: the angle is counted from there.
        around = (cv2.phase(-x, -z).ravel() - np.float32(np.pi)) * np.float32(radius)
        flat = np.flatnonzero(end)
        if len(flat):
            facing[flat] = end[flat] * (lamp[1] - y[flat])
            around[flat], y[flat] = x[flat], z[flat]
        self.paint(pixels[won], t, int(frusta.material_number[i]), around, y, facing)

    def _add_boxes(self, boxes: Boxes, centres: Float) -> None:
        signs = CORNERS
        corners = centres[:, None] + (signs * boxes.half[:, None]) @ boxes.axes
        seen = self.standpoint.seen(corners)
        for i in self.in_view(seen):
            axes, half = boxes.axes[i], boxes.half[i]
            turn = (axes @ self.standpoint.rotation.T).astype(np.float32)
            centre = axes @ (self.standpoint.centre - centres[i])
            lamp = centre + turn @ self.maps.lamp
            for axis in np.flatnonzero(np.abs(centre) > half):
                side = float(np.sign(centre[axis]))
                face = seen[i][signs[:, axis] == side]
                pixels = self.inside(face)
                if len(pixels):
                    material_number = int(boxes.material_number[i])
                    self._cast_face(
                        pixels, turn, centre, half, int(axis), side, lamp, material_number
                    )

    def _cast_face(
        self,
        pixels: Index,
        turn: Single,
        o: Float,
        half: Float,
        axis: int,
        side: float,
        lamp: Float,
        material_number: int,
    ) -> None:
        """One face of a box that the camera is outside of."""
        first, second = (axis + 1) % 3, (axis + 2) % 3
        rays = turn @ self.maps.rays.take(pixels, axis=1)
        t = np.float32(side * half[axis] - o[axis]) / rays[axis]
        across = np.float32(o[first]) + t * rays[first]
        along = np.float32(o[second]) + t * rays[second]
        hit = (t > 0) & (t < self.depth.take(pixels))
        hit &= (np.abs(across) <= half[first]) & (np.abs(along) <= half[second])
        won = np.flatnonzero(hit)
        facing = np.full(len(won), side * lamp[axis] - half[axis], np.float32)
        self.paint(pixels[won], t[won], material_number, across[won], along[won], facing)

    def in_view(self, corners: Float) -> list[int]:
        """Numbers of the solids, given by the corners (n, m, 3) of a hull, that may be in view."""
        maps = self.maps
        depth = corners[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            where = maps.project(corners)
        low, high = where.min(axis=1), where.max(axis=1)
        outside = (high < -2) | (low > np.array([maps.width, maps.height]) + 1)
        ahead, some = (depth > NEAREST_M).all(axis=1), (depth > NEAREST_M).any(axis=1)
        found: list[int] = np.flatnonzero(some & ~(ahead & outside.any(axis=1))).tolist()
        return found

    def inside(self, corners: Float) -> Index:
        """Pixels in the outline of the hull of `corners` (m, 3), and a rim of one pixel."""
        maps = self.maps
        if corners[:, 2].min() <= NEAREST_M:
            ahead = corners[:, 2] > NEAREST_M
            if not ahead.any():
                return np.empty(0, np.int64)
            corners = _cut(corners[ahead], corners[~ahead])
        hull = cv2.convexHull(maps.project(corners).astype(np.float32))
        left, top, width, height = cv2.boundingRect(hull)
        if max(-left, -top, left + width, top + height) > _OUTLINE_PX:
            right, bottom = maps.width + 8, maps.height + 8
            frame = np.array([[-8, -8], [right, -8], [right, bottom], [-8, bottom]], np.float32)
            area, hull = cv2.intersectConvexConvex(hull, frame)
            if area <= 0:
                return np.empty(0, np.int64)
        outline = np.rint(hull).astype(np.int32)
        low, high = max(top - 3, 0), min(top + height + 3, maps.height)
        rows = self._outline[low:high]
        cv2.fillConvexPoly(self._outline, outline, 1)
        cv2.polylines(self._outline, [outline], True, 1, thickness=3)
        found = rows.view(np.bool_).ravel().nonzero()[0]
        found += low * maps.width
        rows[:] = 0
        return found

    def paint(
        self,
        pixels: Index,
        depth: Single,
        material_number: int,
        across: Single,
        along: Single,
        facing: Single | np.float32,
    ) -> None:
        """Say what is seen at `pixels`, where it is known to be the nearest so far."""
        if not len(pixels):
            return
        if not self.any:
            self.any = True
            size = self.maps.pixels
            self.material_number = np.zeros(size, np.int64)
            self.across, self.along, self.facing = np.zeros((3, size), np.float32)
        self.depth[pixels] = depth
        self.material_number[pixels] = material_number
        self.across[pixels] = across
        self.along[pixels] = along
        self.facing[pixels] = facing


def _cut(ahead: Float, behind: Float) -> Float:
    """Corners of what is left of a hull in front of the nearest plane."""
    share = (NEAREST_M - ahead[:, None, 2]) / (behind[None, :, 2] - ahead[:, None, 2])
    crossing = ahead[:, None] + share[..., None] * (behind[None] - ahead[:, None])
    return np.concatenate([ahead, crossing.reshape(-1, 3)])
