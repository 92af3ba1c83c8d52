"""A stereo calibration as OpenCV stores it, checked before it is used."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..features.errors import ToktError

MISSION_FRAME_SIZE = (1360, 1024)
"""Width and height in pixels of the mission cameras (Prosilica GC1380C), which a calibration
without ``image_width`` and ``image_height`` is for."""

_NEEDED = ("K1", "D1", "K2", "D2", "R", "T_mm")
_SHAPES = {"K1": (3, 3), "K2": (3, 3), "R": (3, 3)}
_DISTORTION_SIZES = (4, 5, 8, 12, 14)
_ROTATION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras and how they stand to each other; all float64.

    Parameters
    ----------
    K1, K2 : array, shape (3, 3)
        Camera matrices of the left and the right camera, in pixels of `frame_size`.
    D1, D2 : array, shape (4..14,)
        Distortion coefficients in OpenCV's order (k1, k2, p1, p2, k3, ...).
    R : array, shape (3, 3)
        Rotation from left camera coordinates to right ones.
    T_mm : array, shape (3, 1)
        Translation from left camera coordinates to right ones, in millimetres.
    frame_size : (int, int)
        Width and height in pixels of the frames it is for.
    """

    K1: NDArray[np.float64]
    D1: NDArray[np.float64]
    K2: NDArray[np.float64]
    D2: NDArray[np.float64]
    R: NDArray[np.float64]
    T_mm: NDArray[np.float64]
    frame_size: tuple[int, int]


def load_calibration(path: Path | str) -> StereoCalibration:
    """Read and check a calibration file.

    Parameters
    ----------
    path : Path
        OpenCV FileStorage, YAML or JSON, with K1 D1 K2 D2 R T_mm and, if they are not
        1360x1024, the frames' ``image_width`` and ``image_height``. R1 and R2, where they are
        present, follow from R and T_mm: they are held against them, and computed anew.

    Raises
    ------
    ToktError
        If the file cannot be read, misses a part, or describes cameras that cannot be.
    """
    values = _read(Path(path))
    for name, shape in _SHAPES.items():
        if values[name].shape != shape:
            raise ToktError(f"calibration {path}: {name} must be {shape[0]}x{shape[1]}")
    for name in ("D1", "D2"):
        values[name] = values[name].ravel()
        if values[name].size not in _DISTORTION_SIZES:
            raise ToktError(f"calibration {path}: {name} must hold 4, 5, 8, 12 or 14 numbers")
    if values["T_mm"].size != 3:
        raise ToktError(f"calibration {path}: T_mm must hold 3 numbers")
    size = (int(values["image_width"].item()), int(values["image_height"].item()))
    calibration = StereoCalibration(
        **{name: values[name] for name in ("K1", "D1", "K2", "D2", "R")},
        T_mm=values["T_mm"].reshape(3, 1),
        frame_size=size,
    )
    _check_cameras(calibration, path)
    _check_rotations(calibration, values.get("R1"), values.get("R2"), path)
    return calibration


def _read(path: Path) -> dict[str, NDArray[np.float64]]:
    """Every known key of the file as a float64 array, frame size included."""
    if not path.is_file():
        raise ToktError(f"calibration {path} does not exist")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        try:
            values = _known_keys(storage)
        finally:
            storage.release()
    except (cv2.error, SystemError, UnicodeDecodeError):
        raise ToktError(f"calibration {path} is not an OpenCV YAML or JSON file") from None
    missing = [name for name in _NEEDED if values.get(name) is None]
    if missing:
        raise ToktError(f"calibration {path} has no {', '.join(missing)}")
    arrays = {name: np.asarray(value, np.float64) for name, value in values.items()}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ToktError(f"calibration {path}: {name} holds a number that is not finite")
    return arrays


def _known_keys(storage: cv2.FileStorage) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name in (*_NEEDED, "R1", "R2"):
        node = storage.getNode(name)
        if node.isMap():
            values[name] = node.mat()
    for name, usual in zip(("image_width", "image_height"), MISSION_FRAME_SIZE, strict=True):
        node = storage.getNode(name)
        values[name] = node.real() if node.isInt() or node.isReal() else usual
    return values


def _check_cameras(calibration: StereoCalibration, path: Path | str) -> None:
    """Focal lengths, principal points and the distance between the cameras make sense."""
    width, height = calibration.frame_size
    if width < 1 or height < 1:
        raise ToktError(f"calibration {path}: the frame size is {width}x{height}")
    for name, K in (("K1", calibration.K1), ("K2", calibration.K2)):
        if K[0, 0] <= 0 or K[1, 1] <= 0 or not np.allclose(K[2], [0, 0, 1]):
            raise ToktError(f"calibration {path}: {name} is not a camera matrix")
        if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
            raise ToktError(
                f"calibration {path}: the principal point of {name} lies outside "
                f"the {width}x{height} frame"
            )
    if abs(calibration.T_mm[0, 0]) <= np.abs(calibration.T_mm[1:]).max():
        raise ToktError(f"calibration {path}: T_mm is not that of two cameras side by side")
    if calibration.T_mm[0, 0] > 0:
        raise ToktError(f"calibration {path}: by T_mm the right camera is left of the left one")


def _check_rotations(
    calibration: StereoCalibration,
    R1: NDArray[np.float64] | None,
    R2: NDArray[np.float64] | None,
    path: Path | str,
) -> None:
    """R is a rotation, and R1 and R2 (where given) turn both cameras the same way."""
    R = calibration.R
    if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise ToktError(f"calibration {path}: R is not a rotation")
    if R1 is None and R2 is None:
        return
    if R1 is None or R2 is None or R1.shape != (3, 3) or R2.shape != (3, 3):
        raise ToktError(f"calibration {path}: R1 and R2 must both be 3x3, or both be left out")
    if np.abs(R2 @ R @ R1.T - np.eye(3)).max() > _ROTATION_TOLERANCE:
        raise ToktError(f"calibration {path}: R1 and R2 do not belong to its R")
