"""The stereo rig as a vector of named numbers, and what two cameras see through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.inference.stereo.calibration import StereoCalibration

POSE = ("rotation_x", "rotation_y", "rotation_z", "direction_y", "direction_z", "focal_ratio")
"""What is always estimated: R as a rotation vector (rad), T's direction as the ratios of its y
and z to its x, and the right focal length divided by the left one."""
DISTORTION = ("k1", "k2")
"""Added to both cameras' distortion: they are of one make, and look through equal ports.

On the 2016 mission the frames tell both: a rig fitted to points within 430 px of the centres of
the even frames has a vertical error of 0.41 px (median) beyond 480 px in the odd ones; with the
printed k1 and k2 it is 0.51 px, with k1 alone 0.61 px, without distortion 2.6 px."""
FOCAL = ("focal",)
PRINCIPAL = ("cx_left", "cy_left", "cx_right", "cy_right")
_T, _F, _C, _K = slice(3, 6), slice(6, 8), slice(8, 10), slice(10, 12)
"""Columns of the Jacobian of cv2.projectPoints; those of the rotation come first."""
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)


@dataclass(frozen=True)
class Rig:
    """Two cameras and how they stand to each other."""

    values: dict[str, float]  # all that is named above; `focal` in px, k1 and k2 of the left camera
    left_distortion: F64  # (5,): k1 k2 p1 p2 k3 where the adjustment starts
    right_distortion: F64  # (5,)
    baseline_mm: float  # length of T, which pictures alone can not tell
    size: tuple[int, int]  # width and height of the frames
    aspect: tuple[float, float] = (1.0, 1.0)  # fy / fx of the left and the right camera, kept

    @classmethod
    def plain(cls, focal_px: float, baseline_mm: float, size: tuple[int, int]) -> Rig:
        """Two equal cameras side by side that look the same way, without distortion."""
        centre = {f"c{axis}_{side}": (size[axis == "y"] - 1) / 2
                  for side in ("left", "right") for axis in "xy"}  # fmt: skip
        values = dict.fromkeys((*POSE, *DISTORTION), 0.0) | {"focal_ratio": 1.0}
        values |= {"focal": focal_px} | centre
        return cls(values, np.zeros(5), np.zeros(5), baseline_mm, size)

    @classmethod
    def from_cameras(
        cls, K: tuple[F64, F64], D: tuple[F64, F64], baseline_mm: float, size: tuple[int, int]
    ) -> Rig:
        """Cameras as a calibration has them, side by side: R and T are to be found."""
        rig = cls.plain(float(K[0][0, 0]), baseline_mm, size)
        left, right = (np.append(d, np.zeros(5))[:5] for d in D)
        values = rig.values | {
            "focal_ratio": float(K[1][0, 0] / K[0][0, 0]),
            "cx_left": float(K[0][0, 2]),
            "cy_left": float(K[0][1, 2]),
            "cx_right": float(K[1][0, 2]),
            "cy_right": float(K[1][1, 2]),
            "k1": float(left[0]),
            "k2": float(left[1]),
        }
        aspect = (float(K[0][1, 1] / K[0][0, 0]), float(K[1][1, 1] / K[1][0, 0]))
        return cls(values, left, right, baseline_mm, size, aspect)

    def vector(self, names: Sequence[str]) -> F64:
        """The named numbers."""
        return np.array([self.values[name] for name in names])

    def moved(self, names: Sequence[str], values: F64) -> Rig:
        """The rig with other values of the named numbers."""
        return replace(self, values=self.values | dict(zip(names, map(float, values), strict=True)))

    def distortions(self) -> tuple[F64, F64]:
        """k1 k2 p1 p2 k3 of the left and the right camera."""
        change = np.zeros(5)
        change[:2] = self.vector(DISTORTION) - self.left_distortion[:2]
        return self.left_distortion + change, self.right_distortion + change

    def matrices(self) -> tuple[F64, F64]:
        """Camera matrices of the left and the right camera."""
        left = self.values["focal"]
        right = left * self.values["focal_ratio"]
        return self._matrix("left", left, self.aspect[0]), self._matrix(
            "right", right, self.aspect[1]
        )

    def _matrix(self, side: str, focal: float, aspect: float) -> F64:
        centre = self.values[f"cx_{side}"], self.values[f"cy_{side}"]
        return np.array([[focal, 0, centre[0]], [0, focal * aspect, centre[1]], [0, 0, 1.0]])

    def rotation_vector(self) -> F64:
        """R as a rotation vector, in radians."""
        return self.vector(POSE[:3])

    def rotation(self) -> F64:
        """R, (3, 3)."""
        return np.asarray(cv2.Rodrigues(self.rotation_vector())[0], np.float64)

    def translation_m(self) -> F64:
        """T in metres, (3,)."""
        direction = np.array([1.0, self.values["direction_y"], self.values["direction_z"]])
        return -self.baseline_mm / 1000.0 * direction / np.linalg.norm(direction)

    def calibration(self) -> StereoCalibration:
        """The rig as the calibration the rest of the program uses."""
        (K1, K2), (D1, D2) = self.matrices(), self.distortions()
        T_mm = self.translation_m().reshape(3, 1) * 1000.0
        return StereoCalibration(K1, D1, K2, D2, self.rotation(), T_mm, self.size)

    def rays(self, left: F64, right: F64) -> tuple[F64, F64]:
        """Undistorted directions (x / z, y / z), (n, 2) each, of pixels of both frames."""
        a, b = (
            cv2.undistortPoints(points[:, None], K, D, criteria=_UNDISTORT)[:, 0]
            for points, K, D in zip((left, right), self.matrices(), self.distortions(), strict=True)
        )
        return np.asarray(a, np.float64), np.asarray(b, np.float64)

    def project(self, points_m: F64) -> F64:
        """Pixels (n, 4), left x y and right x y, of points (n, 3) in the left camera's axes."""
        (K1, K2), (D1, D2) = self.matrices(), self.distortions()
        still = np.zeros(3)
        left = cv2.projectPoints(points_m, still, still, K1, D1)[0]
        right = cv2.projectPoints(points_m, self.rotation_vector(), self.translation_m(), K2, D2)[0]
        return np.hstack([left.reshape(-1, 2), right.reshape(-1, 2)])

    def slopes(self, points_m: F64, names: Sequence[str]) -> tuple[F64, F64]:
        """Derivatives of `project` by the named numbers (n, 4, len(names)) and points (n, 4, 3)."""
        (K1, K2), (D1, D2) = self.matrices(), self.distortions()
        turn, shift, still = self.rotation_vector(), self.translation_m(), np.zeros(3)
        left = _projection_slopes(points_m, still, still, K1, D1)
        right = _projection_slopes(points_m, turn, shift, K2, D2)
        by_name = {
            name: np.concatenate(columns, axis=1)
            for name, columns in self._columns(left, right).items()
            if name in names
        }
        by_point = np.concatenate([left[..., _T], right[..., _T] @ self.rotation()], axis=1)
        by_rig = np.array([by_name[name] for name in names]).reshape(len(names), len(points_m), 4)
        return np.moveaxis(by_rig, 0, 2), by_point

    def _columns(self, left: F64, right: F64) -> dict[str, tuple[F64, F64]]:
        """By name, the derivative of the left and of the right pixels, (n, 2) each."""
        none = np.zeros(left.shape[:2])
        ratio, focal = self.values["focal_ratio"], self.values["focal"]
        by_focal = (left[..., _F] @ [1.0, self.aspect[0]], right[..., _F] @ [1.0, self.aspect[1]])
        columns = {f"rotation_{axis}": (none, right[..., i]) for i, axis in enumerate("xyz")}
        by_direction = right[..., _T] @ self._direction_slopes()
        columns |= {f"direction_{a}": (none, by_direction[..., i]) for i, a in enumerate("yz")}
        columns["focal_ratio"] = (none, by_focal[1] * focal)
        columns["focal"] = (by_focal[0], by_focal[1] * ratio)
        for i, axis in enumerate("xy"):
            columns[f"c{axis}_left"] = (left[..., _C][..., i], none)
            columns[f"c{axis}_right"] = (none, right[..., _C][..., i])
        for i, name in enumerate(DISTORTION):
            columns[name] = (left[..., _K][..., i], right[..., _K][..., i])
        return columns

    def _direction_slopes(self) -> F64:
        """Derivative (3, 2) of T in metres by the two numbers of its direction."""
        direction = np.array([1.0, self.values["direction_y"], self.values["direction_z"]])
        length = np.linalg.norm(direction)
        whole = np.eye(3) / length - np.outer(direction, direction) / length**3
        return np.asarray(-self.baseline_mm / 1000.0 * whole[:, 1:])


def _projection_slopes(points_m: F64, turn: F64, shift: F64, K: F64, D: F64) -> F64:
    """The Jacobian of cv2.projectPoints, (n, 2, 15), for its columns see the top."""
    slopes = cv2.projectPoints(points_m, turn, shift, K, D)[1]
    return np.asarray(slopes, np.float64).reshape(len(points_m), 2, -1)
