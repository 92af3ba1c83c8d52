"""Ray casting for simulated missions: depth, direction and albedo of every tower pixel.

Each solid is intersected analytically with the rays through the pixel centres inside the convex
hull of its projection, so that masks and depth follow from the geometry alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.tower import (
    GROWTH,
    TEXEL_M,
    TEXTURE_SIZE,
    Cuboid,
    Frustum,
    Material,
    Stalk,
    Tower,
)

from .boxes import pixels_of_boxes

Float = NDArray[np.float64]
Index = NDArray[np.int64]

_HULL_POINTS = 16
_NEAREST_M = 0.05
"""Solids with a corner nearer to the image plane than this are tested at every pixel."""


@dataclass(frozen=True)
class Camera:
    """One camera at one moment: a tower point p is seen at ``matrix @ rotation @ (p - centre)``."""

    matrix: Float
    rotation: Float
    centre: Float
    width: int
    height: int

    def project(self, points: Float) -> tuple[Float, Float]:
        """Pixels (n, 2) and depths in metres (n,) of tower points (n, 3)."""
        seen = (points - self.centre) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = seen[:, :2] / seen[:, 2:] * self.matrix[0, 0] + self.matrix[:2, 2]
        return pixels, seen[:, 2]

    def rays(self, pixels: Index) -> Float:
        """Directions (3, n) in tower coordinates, of length one along the optical axis."""
        v, u = np.divmod(pixels, self.width)
        x = (u - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (v - self.matrix[1, 2]) / self.matrix[1, 1]
        axes = self.rotation
        return np.stack([axes[0, i] * x + axes[1, i] * y + axes[2, i] for i in range(3)])


@dataclass
class View:
    """The tower in one frame, flat over its ``height * width`` pixels.

    Attributes
    ----------
    depth : (pixels,) float64
        Metres along the optical axis; infinite in open water.
    albedo : (pixels, 3) float32
        BGR, 0..1.
    normal : (3, pixels) float32
        Outward, in tower coordinates; zero on stalks, which have no side.
    """

    camera: Camera
    depth: Float
    albedo: NDArray[np.float32]
    normal: NDArray[np.float32]

    @property
    def tower(self) -> Index:
        """Pixels that show the tower."""
        return np.flatnonzero(np.isfinite(self.depth))

    def image(self, values: NDArray[Any]) -> NDArray[Any]:
        """Flat values as rows and columns."""
        return values.reshape(self.camera.height, self.camera.width, *values.shape[1:])


def cast_rays(tower: Tower, camera: Camera) -> View:
    """Cast the rays of `camera` at `tower`."""
    pixels = camera.height * camera.width
    view = View(
        camera,
        np.full(pixels, np.inf),
        np.zeros((pixels, 3), np.float32),
        np.zeros((3, pixels), np.float32),
    )
    for solid in tower.solids:
        if isinstance(solid, Frustum):
            _add_frustum(view, tower, solid)
        else:
            _add_box(view, tower, solid)
    _add_stalks(view, tower.stalks)
    return view


def _inside_hull(camera: Camera, points: Float) -> Index:
    """Pixels inside the projection of the convex hull of `points`, and a rim of one pixel."""
    where, depth = camera.project(points)
    if (depth < _NEAREST_M).all():
        return np.empty(0, np.int64)
    if (depth < _NEAREST_M).any():
        return np.arange(camera.height * camera.width)
    low = np.maximum(np.floor(where.min(axis=0)).astype(np.int64) - 2, 0)
    high = np.minimum(
        np.ceil(where.max(axis=0)).astype(np.int64) + 3, [camera.width, camera.height]
    )
    if (high <= low).any():
        return np.empty(0, np.int64)
    mask = np.zeros((high[1] - low[1], high[0] - low[0]), np.uint8)
    corners = np.rint(where - low).clip(-16000, 16000).astype(np.int32)
    hull = cv2.convexHull(corners)
    cv2.fillConvexPoly(mask, hull, 1)
    cv2.polylines(mask, [hull], True, 1, thickness=3)
    inside = np.flatnonzero(mask)
    row, col = np.divmod(inside, mask.shape[1])
    return np.asarray((row + low[1]) * camera.width + col + low[0])


def _add_frustum(view: View, tower: Tower, solid: Frustum) -> None:
    camera, axes, length = view.camera, solid.frame(), solid.length
    angles = np.arange(_HULL_POINTS) * 2 * np.pi / _HULL_POINTS
    ring = np.outer(np.cos(angles), axes[0]) + np.outer(np.sin(angles), axes[2])
    ring /= np.cos(np.pi / _HULL_POINTS)
    hull = np.concatenate(
        [solid.start + solid.start_radius * ring, solid.end + solid.end_radius * ring]
    )
    pixels = _inside_hull(camera, hull)
    if not len(pixels):
        return
    ox, oy, oz = axes @ (camera.centre - solid.start)
    dx, dy, dz = axes @ camera.rays(pixels)
    slope = (solid.end_radius - solid.start_radius) / length
    reach = solid.start_radius + slope * oy
    a = dx * dx + dz * dz - (slope * dy) ** 2
    b = ox * dx + oz * dz - slope * reach * dy
    root = b * b - a * (ox * ox + oz * oz - reach * reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = (-b - np.sqrt(root)) / a
        height = oy + side * dy
        side[~((root > 0) & (a > 0) & (side > 0) & (height >= 0) & (height <= length))] = np.inf
        nearest, cap_normal = side, np.zeros(len(side))
        for level, radius, sign in (
            (0.0, solid.start_radius, -1.0),
            (length, solid.end_radius, 1.0),
        ):
            if (oy - level) * sign <= 0:
                continue
            cap = (level - oy) / dy
            on_cap = (cap > 0) & ((ox + cap * dx) ** 2 + (oz + cap * dz) ** 2 <= radius * radius)
            on_cap &= cap < nearest
            nearest = np.where(on_cap, cap, nearest)
            cap_normal[on_cap] = sign
    won = nearest < view.depth[pixels]
    t, flat = nearest[won], cap_normal[won] != 0
    x, y, z = ox + t * dx[won], oy + t * dy[won], oz + t * dz[won]
    radius = np.maximum(np.hypot(x, z), 1e-9)
    zero = np.zeros_like(x)
    on_side = np.stack([x / radius, zero - slope, z / radius])
    normal = axes.T @ np.where(flat, np.stack([zero, cap_normal[won], zero]), on_side)
    across = np.where(flat, x, np.arctan2(z, x) * solid.start_radius)
    along = np.where(flat, z, y)
    albedo = _albedo(tower, solid.material, across, along, camera)
    _paint(view, pixels[won], t, albedo, normal)


def _add_box(view: View, tower: Tower, box: Cuboid) -> None:
    camera = view.camera
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    pixels = _inside_hull(camera, box.centre + (signs * box.half) @ box.axes)
    if not len(pixels):
        return
    origin = (box.axes @ (camera.centre - box.centre))[:, None]
    direction = box.axes @ camera.rays(pixels)
    half = box.half[:, None]
    with np.errstate(divide="ignore"):
        first, second = (-half - origin) / direction, (half - origin) / direction
    enter, leave = np.minimum(first, second), np.maximum(first, second)
    face = enter.argmax(axis=0)
    t = enter.max(axis=0)
    won = (t > 0) & (t <= leave.min(axis=0)) & (t < view.depth[pixels])
    t, face, direction = t[won], face[won], direction[:, won]
    point = origin + t * direction
    row = np.arange(len(t))
    facing = np.zeros((3, len(t)))
    facing[face, row] = -np.sign(direction[face, row])
    albedo = _albedo(
        tower, box.material, point[(face + 1) % 3, row], point[(face + 2) % 3, row], camera
    )
    _paint(view, pixels[won], t, albedo, box.axes.T @ facing)


def _albedo(
    tower: Tower, material: Material, across: Float, along: Float, camera: Camera
) -> NDArray[np.float32]:
    """BGR albedo at surface coordinates in metres, from the texture level of a pixel's size."""
    pixel_m = float(np.linalg.norm(camera.centre)) / camera.matrix[0, 0]
    level = int(np.clip(np.log2(max(pixel_m / TEXEL_M, 1.0)), 0, len(tower.textures) - 1))
    texture = tower.textures[level]
    size, texel = TEXTURE_SIZE >> level, TEXEL_M * 2**level
    texels = texture[
        np.floor(along / texel).astype(np.int64) % size,
        np.floor(across / texel).astype(np.int64) % size,
    ]
    rust = texels[:, 1:] * np.float32(material.rusted)
    paint, rusty = np.array(material.paint, np.float32), np.array(material.rust, np.float32)
    shade = np.float32(0.35) + np.float32(1.1) * texels[:, :1]
    return np.asarray((paint + rust * (rusty - paint)) * shade, np.float32)


def _add_stalks(view: View, stalks: tuple[Stalk, ...]) -> None:
    """Lines from root to tip, tapering to half their width, their depth read off along them."""
    camera = view.camera
    if not stalks:
        return
    ends = np.array([(stalk.root, stalk.tip) for stalk in stalks]).reshape(-1, 3)
    pixels, depth = camera.project(ends)
    pixels, depth = pixels.reshape(-1, 2, 2), depth.reshape(-1, 2)
    size = np.array([camera.width, camera.height])
    inside = (depth > _NEAREST_M).all(axis=1)
    inside &= ((pixels.max(axis=1) > -8) & (pixels.min(axis=1) < size + 8)).all(axis=1)
    pixels, depth = pixels[inside], depth[inside]
    width = np.array([stalk.half_width for stalk in stalks])[inside]
    # Under a pixel's width a stalk would break up into dots.
    half_px = np.maximum(width * camera.matrix[0, 0] / depth[:, 0], 0.5)
    bright = np.array([stalk.brightness for stalk in stalks], np.float32)[inside]
    albedo = bright[:, None] * np.array(GROWTH.paint, np.float32)
    reach = half_px[:, None] + 1
    low = np.maximum(np.floor(pixels.min(axis=1) - reach), 0).astype(np.int64)
    high = np.minimum(np.ceil(pixels.max(axis=1) + reach) + 1, size).astype(np.int64)
    root, step = pixels[:, 0], pixels[:, 1] - pixels[:, 0]
    length_squared = np.maximum((step * step).sum(axis=1), 1e-9)
    for which, column, row in pixels_of_boxes(low, high):
        x, y = column - root[which, 0], row - root[which, 1]
        across, down = step[which].T
        along = ((x * across + y * down) / length_squared[which]).clip(0, 1)
        distance_squared = (x - along * across) ** 2 + (y - along * down) ** 2
        hit = distance_squared <= (half_px[which] * (1 - 0.5 * along)) ** 2
        which, place = which[hit], row[hit] * camera.width + column[hit]
        t = depth[which, 0] + along[hit] * (depth[which, 1] - depth[which, 0])
        nearest = _nearest(place, t)
        won = nearest[t[nearest] < view.depth[place[nearest]]]
        _paint(view, place[won], t[won], albedo[which[won]], np.zeros((3, 1)))


def _nearest(place: Index, depth: Float) -> Index:
    """For each place that occurs, which of its depths is least: the first of these."""
    order = np.lexsort((depth, place))
    first = np.ones(len(order), bool)
    first[1:] = place[order][1:] != place[order][:-1]
    return order[first]


def _paint(
    view: View, pixels: Index, depth: Float, albedo: NDArray[np.float32], normal: Float
) -> None:
    view.depth[pixels] = depth
    view.albedo[pixels] = albedo
    view.normal[:, pixels] = normal
