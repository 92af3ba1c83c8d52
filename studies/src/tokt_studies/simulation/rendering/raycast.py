"""Ray casting: the nearest surface at every pixel of a camera, for missions and the closed loop.

Each solid is intersected analytically with the rays through the pixel centres inside the outline
of its projection, so that masks and depth follow from the geometry alone. Missions take it in
double precision (`View`); the closed loop, which renders some hundred thousand frames, in single
(`Hits`).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from tokt.features.common.arrays import F32, F64, I64
from tokt_studies.simulation.scene import surfaces as shapes
from tokt_studies.simulation.scene import tower as towers
from tokt_studies.simulation.scene.fish_and_dust import TEXTURE_M, School
from tokt_studies.simulation.scene.rig import Camera

Real = NDArray[Any]
"""Of the precision of the rays."""

_NEAREST_M = 0.05
"""What is nearer to the image plane is not seen."""
_OUTLINE_PX = 8000
"""Corners farther outside than this are cut off before the outline is drawn."""


class Side(NamedTuple):
    """Pixels at which the side or an end of a frustum is the nearest so far."""

    number: int  # of the frustum
    pixels: I64
    t: Real  # depth
    point: Real  # (3, n): where it is hit, along its own axes
    end: NDArray[np.int8]  # -1 on its first end, 1 on its last, 0 on its side
    lamp: F64  # (3,): where the lamp is, along its own axes


class Face(NamedTuple):
    """Pixels at which a face of a box is the nearest so far."""

    material_number: int
    pixels: I64
    t: Real  # depth
    across: Real  # where it is hit, m
    along: Real
    normal: F64  # (3,), outward, in world coordinates
    lamp_m: float  # how far the lamp is before it; below 0 behind it


class RayCaster:
    """The nearest surface at every pixel of one camera, flat over its ``height * width`` pixels.

    Sides, faces and stalks are found one after the other; who asks writes the depth of each before
    the next is looked for. The lamp's place is in the camera's coordinates.
    """

    def __init__(self, camera: Camera, lamp: F64, precision: type[np.floating[Any]]) -> None:
        self.camera, self._lamp = camera, lamp
        # Metres along the optical axis; infinite in open water.
        self.depth: Real = np.full(camera.width * camera.height, np.inf, precision)
        self._outline = np.zeros((camera.height, camera.width), np.uint8)

    @property
    def pixels(self) -> I64:
        """Pixels that show something."""
        return np.flatnonzero(np.isfinite(self.depth))

    def rays(self, pixels: I64) -> Real:
        """Directions (3, n) in the camera's coordinates, of length one along the optical axis."""
        return self.camera.rays(pixels)

    def sides(self, frusta: shapes.Frusta, origins: F64) -> Iterator[Side]:
        """Cast the rays at frusta; `origins` (things, 3) is where the things are."""
        shift = origins[frusta.thing]
        corners = self.camera.seen(frusta.hull + shift[:, None])
        turn = (frusta.axes @ self.camera.rotation.T).astype(self.depth.dtype)
        centre = np.einsum("nij,nj->ni", frusta.axes, self.camera.centre - frusta.start - shift)
        for i in self.in_view(corners):
            pixels = self.inside(corners[i])
            rays = turn[i] @ self.rays(pixels)
            t, end = _cast_at_frustum(frusta, i, centre[i], rays)
            won = np.flatnonzero(t < self.depth.take(pixels))
            if len(won):
                t, end = t[won], end[won]
                point = np.stack(
                    [o + t * d[won] for o, d in zip(centre[i].tolist(), rays, strict=True)]
                )
                yield Side(i, pixels[won], t, point, end, centre[i] + turn[i] @ self._lamp)

    def faces(self, boxes: shapes.Boxes, origins: F64) -> Iterator[Face]:
        """Cast the rays at boxes; see `sides`."""
        centres = boxes.centre + origins[boxes.thing]
        corners = centres[:, None] + (towers.CORNERS * boxes.half[:, None]) @ boxes.axes
        seen = self.camera.seen(corners)
        for i in self.in_view(seen):
            half, turn = boxes.half[i], (boxes.axes[i] @ self.camera.rotation.T)
            turn = turn.astype(self.depth.dtype)
            origin = boxes.axes[i] @ (self.camera.centre - centres[i])
            lamp = origin + turn @ self._lamp
            # Only faces that the camera is outside of.
            for axis in np.flatnonzero(np.abs(origin) > half).tolist():
                sign = float(np.sign(origin[axis]))
                pixels = self.inside(seen[i][towers.CORNERS[:, axis] == sign])
                rays = turn @ self.rays(pixels)
                first, second, o = (axis + 1) % 3, (axis + 2) % 3, origin.tolist()
                # A ray along a face never meets it: infinite, and no hit.
                with np.errstate(divide="ignore", invalid="ignore"):
                    t = float(sign * half[axis] - o[axis]) / rays[axis]
                    across, along = o[first] + t * rays[first], o[second] + t * rays[second]
                hit = (t > 0) & (t < self.depth.take(pixels))
                hit &= (np.abs(across) <= half[first]) & (np.abs(along) <= half[second])
                yield Face(
                    int(boxes.material_number[i]), pixels[hit], t[hit], across[hit], along[hit],
                    sign * boxes.axes[i, axis], float(sign * lamp[axis] - half[axis]),
                )  # fmt: skip

    def stalks(
        self, stalks: shapes.Stalks, origins: F64, from_m: float, rim_px: int, *, hidden: bool
    ) -> Iterator[tuple[I64, Real, F32]]:
        """Draw stalks, after the solids: lines from root to tip that taper to half their width.

        Yields pixels, their depth and their brightness. What is nearer to the image plane than
        `from_m`, or farther outside the picture than `rim_px`, is left out; so is what is behind
        the tower with both ends, unless `hidden`.
        """
        camera = self.camera
        ends = camera.seen(stalks.ends + origins[stalks.thing][:, None])
        depth = ends[..., 2]
        use = np.flatnonzero((depth > from_m).all(axis=1))
        where = camera.place(ends[use])
        last = np.array([camera.width, camera.height]) - 1
        drawn = ((where.max(axis=1) > -rim_px) & (where.min(axis=1) < last + rim_px)).all(axis=1)
        if not hidden:
            column, row = np.rint(where.clip(0, last)).astype(np.int64).transpose(2, 0, 1)
            nearest = self.depth[row * camera.width + column]
            drawn &= (depth[use] < nearest + 0.01).any(axis=1)
        use, where, depth = use[drawn], where[drawn], depth[use[drawn]]
        if not len(use):
            return
        place, t, which = _stalk_pixels(camera, where, depth, stalks.half_width[use])
        t = t.astype(self.depth.dtype)
        bright = stalks.brightness[use].astype(np.float32)
        # Each time the nearest so far or a nearer one is written: soon there is none left.
        while len(won := np.flatnonzero(t < self.depth[place])):
            place, t, which = place[won], t[won], which[won]
            yield place, t, bright[which]

    def in_view(self, corners: F64) -> list[int]:
        """Numbers of the solids, given by the corners (n, m, 3) of a hull, that may be in view."""
        camera, depth = self.camera, corners[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            where = camera.place(corners)
        low, high = where.min(axis=1), where.max(axis=1)
        outside = (high < -2) | (low > np.array([camera.width, camera.height]) + 1)
        ahead, some = (depth > _NEAREST_M).all(axis=1), (depth > _NEAREST_M).any(axis=1)
        found: list[int] = np.flatnonzero(some & ~(ahead & outside.any(axis=1))).tolist()
        return found

    def inside(self, corners: F64) -> I64:
        """Pixels in the outline of the hull of `corners` (m, 3), and a rim of one pixel."""
        camera = self.camera
        if corners[:, 2].min() <= _NEAREST_M:
            ahead = corners[:, 2] > _NEAREST_M
            if not ahead.any():
                return np.empty(0, np.int64)
            corners = _cut(corners[ahead], corners[~ahead])
        hull = cv2.convexHull(camera.place(corners).astype(np.float32))
        left, top, width, height = cv2.boundingRect(hull)
        if max(-left, -top, left + width, top + height) > _OUTLINE_PX:
            right, bottom = camera.width + 8, camera.height + 8
            frame = np.array([[-8, -8], [right, -8], [right, bottom], [-8, bottom]], np.float32)
            area, hull = cv2.intersectConvexConvex(hull, frame)
            if area <= 0:
                return np.empty(0, np.int64)
        outline = np.rint(hull).astype(np.int32)
        low, high = max(top - 3, 0), min(top + height + 3, camera.height)
        rows = self._outline[low:high]
        cv2.fillConvexPoly(self._outline, outline, 1)
        cv2.polylines(self._outline, [outline], True, 1, thickness=3)
        found = rows.view(np.bool_).ravel().nonzero()[0]
        found += low * camera.width
        rows[:] = 0
        return found


def _cast_at_frustum(
    frusta: shapes.Frusta, i: int, origin: F64, rays: Real
) -> tuple[Real, NDArray[np.int8]]:
    """Depth at each ray, along the frustum's axes, and on which end; infinite where it is missed.

    Solved through the rays' distance from the axis: single precision is enough for that.
    """
    ox, oy, oz = origin.tolist()
    dx, dy, dz = rays
    radius, slope, length = (float(v[i]) for v in (frusta.radius, frusta.slope, frusta.length))
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
    with np.errstate(divide="ignore", invalid="ignore"):
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
    return t, end


def _cut(ahead: F64, behind: F64) -> F64:
    """Corners of what is left of a hull in front of the nearest plane."""
    share = (_NEAREST_M - ahead[:, None, 2]) / (behind[None, :, 2] - ahead[:, None, 2])
    crossing = ahead[:, None] + share[..., None] * (behind[None] - ahead[:, None])
    return np.concatenate([ahead, crossing.reshape(-1, 3)])


def _stalk_pixels(camera: Camera, where: F64, depth: F64, half_m: F64) -> tuple[I64, F64, I64]:
    """Pixels on stalks, their depth, and which stalk each is of; a pixel may come up often."""
    order = np.argsort(-depth[:, 0])
    where, depth, half_m = where[order], depth[order], half_m[order]
    # Under a pixel's width a stalk would break up into dots.
    half = np.maximum(half_m * camera.matrix[0, 0] / depth[:, 0], 0.5)
    # Walk along the longer of rows and columns, and take the pixels on either side.
    step = where[:, 1] - where[:, 0]
    steep = np.abs(step[:, 1]) > np.abs(step[:, 0])
    where[steep], step[steep] = where[steep, :, ::-1], step[steep, ::-1]
    length = np.maximum(np.hypot(*step.T), 1e-6)
    slope = step[:, 1] / np.where(step[:, 0] == 0, 1.0, step[:, 0])
    reach = half * length / np.maximum(np.abs(step[:, 0]), 1e-6)
    first = np.ceil(where[..., 0].min(axis=1) - half)
    n_along = (np.floor(where[..., 0].max(axis=1) + half) - first).astype(np.int64) + 1
    n_across = np.floor(2 * reach).astype(np.int64) + 1
    count = n_along * n_across
    which = np.repeat(np.arange(len(step)), count)
    number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    ahead, aside = np.divmod(number, n_across.take(which))
    x = ahead + (first - where[:, 0, 0]).take(which)
    root = where[:, 0, 1].take(which)
    b = np.ceil(root + slope.take(which) * x - reach.take(which)) + aside
    y = b - root
    dx, dy = step[:, 0].take(which), step[:, 1].take(which)
    along = ((x * dx + y * dy) / (length * length).take(which)).clip(0, 1)
    off = (x - along * dx) ** 2 + (y - along * dy) ** 2
    inside = np.flatnonzero(off <= (half.take(which) * (1 - 0.5 * along)) ** 2)
    which, along, b = which.take(inside), along.take(inside), b.take(inside)
    a = ahead.take(inside) + first.take(which)
    turned = steep.take(which)
    column, row = np.where(turned, b, a), np.where(turned, a, b)
    inside = np.flatnonzero(
        (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    )
    which, along = which.take(inside), along.take(inside)
    t = depth[:, 0].take(which) + along * (depth[:, 1] - depth[:, 0]).take(which)
    place = (row * camera.width + column).take(inside).astype(np.int64)
    return place, t, order.take(which)


class View(RayCaster):
    """The tower in one frame of a mission."""

    def __init__(self, camera: Camera, tower: towers.Tower) -> None:
        super().__init__(camera, np.zeros(3), np.float64)
        self.albedo = np.zeros((len(self.depth), 3), np.float32)  # BGR, 0..1
        # Outward, in tower coordinates; zero on stalks, which have no side.
        self.normal = np.zeros((3, len(self.depth)), np.float32)
        self._textures = tower.textures
        surfaces, here = shapes.Surfaces([tower]), np.zeros((1, 3))
        for side in self.sides(surfaces.frusta, here):
            self._paint_side(surfaces, side)
        for face in self.faces(surfaces.boxes, here):
            material, _ = surfaces.materials[face.material_number]
            albedo = self._albedo(material, face.across, face.along)
            self._paint(face.pixels, face.t, albedo, face.normal[:, None])
        growth = np.array(towers.GROWTH.paint, np.float32)
        for pixels, t, bright in self.stalks(surfaces.stalks, here, _NEAREST_M, 9, hidden=True):
            self._paint(pixels, t, bright[:, None] * growth, np.zeros((3, 1)))

    def image(self, values: NDArray[Any]) -> NDArray[Any]:
        """Flat values as rows and columns."""
        return values.reshape(self.camera.height, self.camera.width, *values.shape[1:])

    def _paint_side(self, surfaces: shapes.Surfaces, side: Side) -> None:
        frusta, i = surfaces.frusta, side.number
        x, y, z = side.point
        radius = np.maximum(np.hypot(x, z), 1e-9)
        zero, flat = np.zeros_like(x), side.end != 0
        on_side = np.stack([x / radius, zero - frusta.slope[i], z / radius])
        normal = frusta.axes[i].T @ np.where(flat, np.stack([zero, side.end, zero]), on_side)
        across = np.where(flat, x, np.arctan2(z, x) * frusta.radius[i])
        material, _ = surfaces.materials[frusta.material_number[i]]
        albedo = self._albedo(material, across, np.where(flat, z, y))
        self._paint(side.pixels, side.t, albedo, normal)

    def _albedo(self, material: towers.Material, across: F64, along: F64) -> F32:
        """BGR albedo at surface coordinates in metres, from the texture level of a pixel's size."""
        pixel_m = float(np.linalg.norm(self.camera.centre)) / self.camera.matrix[0, 0]
        level = int(
            np.clip(np.log2(max(pixel_m / towers.TEXEL_M, 1.0)), 0, len(self._textures) - 1)
        )
        size, texel = towers.TEXTURE_SIZE >> level, towers.TEXEL_M * 2**level
        texels = self._textures[level][
            np.floor(along / texel).astype(np.int64) % size,
            np.floor(across / texel).astype(np.int64) % size,
        ]
        rust = texels[:, 1:] * np.float32(material.rusted)
        paint, rusty = np.array(material.paint, np.float32), np.array(material.rust, np.float32)
        shade = np.float32(0.35) + np.float32(1.1) * texels[:, :1]
        return np.asarray((paint + rust * (rusty - paint)) * shade, np.float32)

    def _paint(self, pixels: I64, depth: F64, albedo: F32, normal: F64) -> None:
        self.depth[pixels] = depth
        self.albedo[pixels] = albedo
        self.normal[:, pixels] = normal


class Hits(RayCaster):
    """The surfaces in one frame of the closed loop; `rays` are those of `Camera.rays`."""

    def __init__(self, camera: Camera, rays: F32, lamp: F64) -> None:
        super().__init__(camera, lamp, np.float32)
        self._all_rays = rays
        # All of this only where something was hit.
        self.material_number = np.zeros(len(self.depth), np.int64)
        # Surface coordinates, m (a stalk's `along` is its brightness); the outward normal times
        # the vector to the lamp, m (not a number on a stalk).
        self.across, self.along, self.facing = np.zeros((3, len(self.depth)), np.float32)

    def rays(self, pixels: I64) -> F32:
        """See `RayCaster.rays`."""
        return self._all_rays.take(pixels, axis=1)

    def add_solids(self, surfaces: shapes.Surfaces, origins: F64) -> None:
        """Cast the rays at all solids, and at what grows on them; see `RayCaster.sides`."""
        for side in self.sides(surfaces.frusta, origins):
            self._paint_side(surfaces.frusta, side)
        for face in self.faces(surfaces.boxes, origins):
            pixels, lamp_m = face.pixels, np.float32(face.lamp_m)
            self._paint(pixels, face.t, face.material_number, face.across, face.along, lamp_m)
        for pixels, t, bright in self.stalks(
            surfaces.stalks, origins, 4 * _NEAREST_M, 4, hidden=False
        ):
            self._paint(pixels, t, shapes.STALK_MATERIAL, bright, bright, np.float32(np.nan))

    def add_fish(self, school: School, t_s: float) -> None:
        """Cast the rays at a school where it is at a time: ellipsoids."""
        centres, axes, half = school.shapes(t_s)
        corners = self.camera.seen(centres[:, None] + (towers.CORNERS * half[:, None]) @ axes)
        for i in self.in_view(corners):
            pixels = self.inside(corners[i])
            if len(pixels):
                self._cast_ellipsoid(pixels, centres[i], axes[i], half[i])

    def _cast_ellipsoid(self, pixels: I64, centre: F64, axes: F64, half: F64) -> None:
        """In units of its half sizes: there it is the unit sphere."""
        turn = axes @ self.camera.rotation.T
        camera = axes @ (self.camera.centre - centre)
        lamp = camera + turn @ self._lamp
        rays = (turn / half[:, None]).astype(np.float32) @ self.rays(pixels)
        o = (camera / half).astype(np.float32)
        a = (rays * rays).sum(axis=0)
        cross = np.cross(o, rays, axisb=0)
        root = a - (cross * cross).sum(axis=1)
        t = (-(o @ rays) - np.sqrt(np.maximum(root, 0))) / a
        won = np.flatnonzero((root > 0) & (t > 0) & (t < self.depth.take(pixels)))
        t = t[won]
        x, y, z = o[:, None] + t * rays[:, won]
        hx, hy, hz = half.astype(np.float32)
        normal = np.stack([x / hx, y / hy, z / hz])
        normal /= np.sqrt((normal * normal).sum(axis=0))
        to_lamp = lamp.astype(np.float32)[:, None] - np.stack([x * hx, y * hy, z * hz])
        across, along = (np.float32(TEXTURE_M / 2) * (1 + v) for v in (-x, y))
        facing = (normal * to_lamp).sum(axis=0)
        self._paint(pixels[won], t, shapes.FISH_MATERIAL, across, along, facing)

    def _paint_side(self, frusta: shapes.Frusta, side: Side) -> None:
        i, end, lamp = side.number, side.end, side.lamp.tolist()
        x, y, z = side.point
        radius, slope = float(frusta.radius[i]), float(frusta.slope[i])
        facing = ((lamp[0] - x) * x + (lamp[2] - z) * z) / (radius + slope * y)
        facing -= slope * (lamp[1] - y)
        # The seam of the texture lies opposite the first axis: the angle is counted from there.
        around = (cv2.phase(-x, -z).ravel() - np.float32(np.pi)) * np.float32(radius)
        flat = np.flatnonzero(end)
        if len(flat):
            facing[flat] = end[flat] * (lamp[1] - y[flat])
            around[flat], y[flat] = x[flat], z[flat]
        self._paint(side.pixels, side.t, int(frusta.material_number[i]), around, y, facing)

    def _paint(self, pixels: I64, depth: F32, number: int, *surface: F32 | np.float32) -> None:
        self.depth[pixels], self.material_number[pixels] = depth, number
        for layer, values in zip((self.across, self.along, self.facing), surface, strict=True):
            layer[pixels] = values
