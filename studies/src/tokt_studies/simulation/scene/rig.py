"""Cameras without distortion, the stereo rig of a synthetic mission, and its calibration file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tokt.features.common.arrays import F64, I64

FULL_WIDTH = 1360
"""Frame width in pixels of the mission camera; every length in px is given at this width."""
FULL_HEIGHT = 1024
_CALIBRATION_KEYS = "K1", "D1", "K2", "D2", "R", "T_mm", "R1", "R2", "image_width", "image_height"
_FOCAL_PX = 2222.0
_BASELINE_M = 0.3055


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera at one moment: a world point p is seen at ``rotation @ (p - centre)``.

    Its own coordinates are x to the right, y down, z ahead.
    """

    matrix: F64
    rotation: F64
    centre: F64
    width: int
    height: int

    def seen(self, points: F64) -> F64:
        """World points (..., 3) in this camera's coordinates."""
        return np.asarray((points - self.centre) @ self.rotation.T)

    def place(self, seen: F64) -> F64:
        """Columns and rows (..., 2) of points (..., 3) in this camera's coordinates."""
        return np.asarray(seen[..., :2] / seen[..., 2:] * self.matrix[0, 0] + self.matrix[:2, 2])

    def rays(self, pixels: I64) -> F64:
        """Directions (3, n) in this camera's coordinates, of length one along the optical axis."""
        v, u = np.divmod(pixels, self.width)
        x = (u - self.matrix[0, 2]) / self.matrix[0, 0]
        y = (v - self.matrix[1, 2]) / self.matrix[1, 1]
        return np.stack([x, y, np.ones(len(pixels))])


class SyntheticRig:
    """A rig of the mission's proportions, turned by about a degree as a real one is.

    Two pinhole cameras without distortion; a right-camera point is ``R @ left + T``.
    """

    def __init__(self, rng: np.random.Generator, width: int) -> None:
        # Frame size in pixels, and how many of these are one pixel of the mission camera.
        self.width, self.scale = width, width / FULL_WIDTH
        self.height = round(FULL_HEIGHT * self.scale)
        turn = cv2.Rodrigues(rng.normal(0.0, [0.010, 0.010, 0.010]))[0]
        self.rotation = np.asarray(turn, np.float64)  # R
        direction = np.array([-1.0, *rng.normal(0.0, 0.01, 2)])
        self.translation_m = _BASELINE_M * direction / np.linalg.norm(direction)  # T
        # Camera matrices in pixels; pixel centres have whole-number coordinates.
        self.left = self._matrix(_FOCAL_PX)
        self.right = self._matrix(_FOCAL_PX * rng.uniform(0.997, 1.005))

    def _matrix(self, focal_px: float) -> F64:
        focal, x, y = focal_px * self.scale, (self.width - 1) / 2, (self.height - 1) / 2
        return np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])

    def cameras(self, rotation: F64, centre: F64) -> tuple[Camera, Camera]:
        """The left camera, turned and placed so in the world, and the right one beside it."""
        right = self.rotation @ rotation
        beside = centre - right.T @ self.translation_m
        return (
            Camera(self.left, rotation, centre, self.width, self.height),
            Camera(self.right, right, beside, self.width, self.height),
        )

    def write(self, path: Path) -> None:
        """Write an OpenCV FileStorage with K1 D1 K2 D2 R T_mm R1 R2 and the frames' size."""
        no_distortion = np.zeros(5)
        translation = self.translation_m.reshape(3, 1)
        size = (self.width, self.height)
        cameras = (self.left, no_distortion, self.right, no_distortion)
        turns = cv2.stereoRectify(*cameras, size, self.rotation, translation)[:2]
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        values: tuple[Any, ...] = (*cameras, self.rotation, translation * 1000.0, *turns, *size)
        for key, value in zip(_CALIBRATION_KEYS, values, strict=True):
            storage.write(key, value)
        storage.release()
