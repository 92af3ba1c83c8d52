"""Ray casting of the growth on solids: the lines that `raycast` draws, made for speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tokt.studies.simulation.scene.surfaces import STALK_MATERIAL, Stalks

from .fast_raycast import NEAREST_M, Hits
from .view_maps import ViewMaps

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]


def add_stalks(hits: Hits, stalks: Stalks, origins: Float) -> None:
    """Draw stalks, after the solids: lines from root to tip that taper to half their width."""
    maps = hits.maps
    ends = hits.standpoint.seen(stalks.ends + origins[stalks.thing][:, None])
    depth = ends[..., 2]
    use = np.flatnonzero((depth > 4 * NEAREST_M).all(axis=1))
    where = maps.project(ends[use])
    last = np.array([maps.width, maps.height]) - 1
    inside = ((where.max(axis=1) > -4) & (where.min(axis=1) < last + 4)).all(axis=1)
    use, where, depth = use[inside], where[inside], depth[use[inside]]
    # What is behind the tower with both ends is not drawn at all.
    column, row = np.rint(where.clip(0, last)).astype(np.int64).transpose(2, 0, 1)
    seen = (depth < hits.depth[row * maps.width + column] + 0.01).any(axis=1)
    use, where, depth = use[seen], where[seen], depth[seen]
    if not len(use):
        return
    place, t, which = _candidates(maps, where, depth, stalks.half_width[use])
    bright = stalks.brightness[use].astype(np.float32)
    # Each time the nearest so far or a nearer one is written: soon there is none left.
    while len(won := np.flatnonzero(t < hits.depth[place])):
        place, t, which = place[won], t[won], which[won]
        light = bright[which]
        hits.paint(place, t, STALK_MATERIAL, light, light, np.float32(np.nan))


def _candidates(
    maps: ViewMaps, where: Float, depth: Float, half_m: Float
) -> tuple[Index, Single, Index]:
    """Pixels on stalks, their depth, and which stalk each is of; a pixel may come up often."""
    order = np.argsort(-depth[:, 0])
    where, depth, half_m = where[order], depth[order], half_m[order]
    # Under a pixel's width a stalk would break up into dots.
    half = np.maximum(half_m * maps.matrix[0, 0] / depth[:, 0], 0.5)
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
        (column >= 0) & (column < maps.width) & (row >= 0) & (row < maps.height)
    )
    which, along = which.take(inside), along.take(inside)
    t = depth[:, 0].take(which) + along * (depth[:, 1] - depth[:, 0]).take(which)
    place = (row * maps.width + column).take(inside).astype(np.int64)
    return place, t.astype(np.float32), order.take(which)
