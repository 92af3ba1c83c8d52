"""Memory of obstacles seen before: carried along with the camera until they are too old."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .odometry import Motion
from .rectify import Rectifier

_NEAREST_M = 0.1
"""Metres in front of the camera. What is nearer, or behind, is out of view."""
_GROWTH = 0.05
"""Part by which a thing may look larger than when it was seen before it is painted so."""


class ObstacleMemory:
    """Points of obstacles in the left camera's present axes, at most one for each cell of the view.

    Parameters
    ----------
    rectifier : Rectifier
    cell_px : int
        Width and height in pixels of the view's cells.
    oldest : int
        Age in frames up to which a point is kept.

    Attributes
    ----------
    points_m : array of float64, shape (n, 3)
        x right, y down, z forward.
    ages : array of int64, shape (n,)
        Frames since each point was seen.
    """

    def __init__(self, rectifier: Rectifier, cell_px: int, oldest: int) -> None:
        self._rectifier = rectifier
        self._cell_px = cell_px
        width, height = rectifier.size
        self._shape = (height // cell_px, width // cell_px)
        self._oldest = oldest
        self._rotation = rectifier.rotations[0]
        self._rays = self._cell_rays()
        self.points_m = np.empty((0, 3))
        self.ages = np.empty(0, np.int64)
        self._seen_at_m = np.empty(0)
        self._cells = np.empty(0, np.int64)

    def _cell_rays(self) -> NDArray[np.float64]:
        """Where the middle of each cell looks, at depth 1 along the view's axis: (n_cells, 3)."""
        rows, columns = np.indices(self._shape).reshape(2, -1)
        middle = np.column_stack([columns, rows]) * self._cell_px + (self._cell_px - 1) / 2
        flat = (middle - self._rectifier.principal) / self._rectifier.focal_px
        rays = np.column_stack([flat, np.ones(len(flat))]) @ self._rotation
        return np.asarray(rays, np.float64)

    def advance(self, frames: int, motion: Motion | None, moving: int = 1) -> None:
        """Let time pass, and move the camera.

        Parameters
        ----------
        frames : int
            How many frames later it is.
        motion : Motion, optional
            Of the camera; None where it is not known: the points stay in view where they are, at
            the distance they were seen at.
        moving : int
            How many frames the motion took. A point that is younger was seen on the way: it
            takes only the part of the motion that came after, as of an even one.
        """
        self.ages += frames
        self._keep(self.ages <= self._oldest)
        if motion is None or not len(self.ages):
            return
        after = self.ages.clip(max=moving)
        for age in np.unique(after):
            points = self.points_m[after == age]
            self.points_m[after == age] = motion.last(age / moving).of(points)
        self._keep(self.depths_m > _NEAREST_M)
        self._cells = self._cells_of(self.points_m)
        self._keep(self._cells >= 0)
        self._keep_nearest()

    def add(self, depth_m: NDArray[np.floating]) -> None:
        """Remember what is seen now, in place of what was there before.

        Parameters
        ----------
        depth_m : array of float, shape (rows, columns) of cells
            Along the view's axis, in metres; 0 where nothing is seen.
        """
        seen = np.flatnonzero(depth_m)
        depth = depth_m.ravel()[seen].astype(np.float64)
        new = np.zeros(self._rays.shape[0], bool)
        new[seen] = True
        self._keep(~new[self._cells])
        self.points_m = np.concatenate([self.points_m, self._rays[seen] * depth[:, None]])
        self.ages = np.concatenate([self.ages, np.zeros(len(seen), np.int64)])
        self._seen_at_m = np.concatenate([self._seen_at_m, depth])
        self._cells = np.concatenate([self._cells, seen])

    @property
    def depths_m(self) -> NDArray[np.float64]:
        """Of each point along the view's axis, in metres, shape (n,)."""
        return np.asarray(self.points_m @ self._rotation[2], np.float64)

    def mask(self) -> NDArray[np.uint8]:
        """The view with 255 where an obstacle is remembered, shape (height, width).

        A thing that has come nearer since it was seen is painted larger in proportion.
        """
        cells = np.zeros(self._shape, np.uint8)
        closer = self._seen_at_m / np.maximum(self.depths_m, _NEAREST_M)
        sizes = np.ceil(closer - _GROWTH).clip(1, max(self._shape)).astype(np.int64)
        for size in np.unique(sizes):
            own = np.zeros_like(cells)
            own.ravel()[self._cells[sizes == size]] = 255
            cells |= np.asarray(cv2.dilate(own, np.ones((size, size), np.uint8)), np.uint8)
        (width, height), side = self._rectifier.size, self._cell_px
        view = np.zeros((height, width), np.uint8)
        covered = view[: self._shape[0] * side, : self._shape[1] * side]
        covered[:] = cells.repeat(side, axis=0).repeat(side, axis=1)
        return view

    def _cells_of(self, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """The cell in which each point stands, shape (n,); -1 where it is out of view."""
        seen = points_m @ self._rotation.T
        pixels = seen[:, :2] / seen[:, 2:] * self._rectifier.focal_px + self._rectifier.principal
        place = np.floor((pixels + 0.5) / self._cell_px)
        rows, columns = self._shape
        inside = (place >= 0).all(axis=1) & (place < (columns, rows)).all(axis=1)
        place[~inside] = 0
        column, row = place.astype(np.int64).T
        return np.where(inside, row * columns + column, -1)

    def _keep(self, which: NDArray[np.bool_]) -> None:
        self.points_m, self.ages = self.points_m[which], self.ages[which]
        self._seen_at_m, self._cells = self._seen_at_m[which], self._cells[which]

    def _keep_nearest(self) -> None:
        """Of the points in one cell only the nearest."""
        order = np.argsort(-self.depths_m, kind="stable")
        owner = np.zeros(self._rays.shape[0], np.int64)
        owner[self._cells[order]] = order  # the last one written stays
        self._keep(owner[self._cells] == np.arange(len(self._cells)))
