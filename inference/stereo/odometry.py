"""Odometry: where the left camera was at each frame, read from a file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.features.common.held_files import file_bytes

COLUMNS = ("frame", "t", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
UNIT_TOLERANCE = 1e-3
"""How far a quaternion's length may be from 1: three printed decimals."""
FARTHEST_M = 1e6
"""Metres. A position beyond is not one of a vehicle, and would overflow further on."""


@dataclass(frozen=True)
class Pose:
    """The left camera's pose in axes that do not move."""

    t: float  # seconds, of whatever clock the odometry has
    position_m: F64
    rotation: F64  # from the camera's axes (x right, y down, z forward) to the fixed ones


@dataclass(frozen=True)
class Motion:
    """The rigid motion of things that stand still, seen from a camera that moves.

    ``rotation @ point + translation_m`` takes a point from the axes of the camera before to those
    of the camera after.
    """

    rotation: F64
    translation_m: F64

    def of(self, points_m: F64) -> F64:
        """Points after the move, shape (n, 3) like those before it."""
        return np.asarray(points_m @ self.rotation.T + self.translation_m, np.float64)

    def last(self, part: float) -> Motion:
        """The last part, from 0 to 1, of the motion, as if turn and way had been even."""
        turn = cv2.Rodrigues(self.rotation)[0] * part
        return Motion(np.asarray(cv2.Rodrigues(turn)[0], np.float64), self.translation_m * part)


def motion_between(before: Pose, after: Pose) -> Motion:
    """The motion from one pose of the camera to another."""
    back = after.rotation.T
    return Motion(back @ before.rotation, back @ (before.position_m - after.position_m))


Odometry = Mapping[int, Pose]
"""The pose of each frame that has one, by frame number."""


def load_odometry(path: Path | str) -> Odometry:
    """Read an odometry file.

    It is CSV with the columns ``frame,t,x_m,y_m,z_m,qw,qx,qy,qz``: the pose of the left camera, x
    right, y down and z forward, in any frame that does not move. The quaternion turns the camera's
    axes into the fixed ones. Frames may be left out.

    Raises ToktError if the file cannot be read, a line is not nine finite numbers, a quaternion is
    not of length 1, or a frame comes twice.
    """
    try:
        with os_errors_as(f"cannot read odometry {path}"):
            text = file_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ToktError(f"odometry {path} is not a text file") from None
    return parse_odometry(text, str(path))


def parse_odometry(text: str, name: str) -> Odometry:
    """As `load_odometry`, from the file's text; `name` is what errors call it."""
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    header = ",".join(COLUMNS)
    if not lines or _fields(lines[0][1]) != list(COLUMNS):
        raise ToktError(f"odometry {name} does not begin with the line {header}")
    poses: dict[int, Pose] = {}
    for number, line in lines[1:]:
        try:
            frame, pose = _pose(line)
        except ValueError as error:
            raise ToktError(f"odometry {name}, line {number}: {error}") from None
        if frame in poses:
            raise ToktError(f"odometry {name}, line {number}: frame {frame} comes twice")
        poses[frame] = pose
    if not poses:
        raise ToktError(f"odometry {name} holds no pose")
    return poses


def _fields(line: str) -> list[str]:
    return [field.strip() for field in line.split(",")]


def _pose(line: str) -> tuple[int, Pose]:
    """One line; ValueError says what is wrong with it."""
    fields = _fields(line)
    if len(fields) != len(COLUMNS):
        raise ValueError(f"{len(fields)} values where {len(COLUMNS)} are needed")
    if not (fields[0].isascii() and fields[0].isdigit() and len(fields[0]) <= 18):
        raise ValueError("frame is not a whole number")
    values = [_number(name, field) for name, field in zip(COLUMNS[1:], fields[1:], strict=True)]
    position, quaternion = np.array(values[1:4]), np.array(values[4:])
    if np.abs(position).max() > FARTHEST_M:
        raise ValueError(f"a position is more than {FARTHEST_M:.0f} m away")
    length = math.hypot(*quaternion)
    if abs(length - 1) > UNIT_TOLERANCE:
        raise ValueError(f"the quaternion has length {length:.4g}, not 1")
    return int(fields[0]), Pose(values[0], position, _rotation(quaternion / length))


def _number(name: str, field: str) -> float:
    try:
        value = float(field)
    except ValueError:
        raise ValueError(f"{name} is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{name} is not finite")
    return value


def _rotation(quaternion: F64) -> F64:
    """The rotation matrix of a unit quaternion w, x, y, z."""
    w, axis = quaternion[0], quaternion[1:]
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray((w * w - axis @ axis) * np.eye(3) + 2 * (np.outer(axis, axis) + w * cross))
