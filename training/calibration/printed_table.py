"""A stereo calibration as a thesis prints it, typed into a JSON object."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.inference.stereo.calibration_files import (
    CalibrationNumbers,
    checked_numbers,
    finite_array,
)


def read_printed(path: Path, text: str) -> CalibrationNumbers:
    """Read ``left`` and ``right`` (fx fy cx cy skew k p), rotation vector and translation.

    Angles are in radians, lengths in millimetres; as in Bouguet's toolbox a point of the right
    camera is R @ left + T. Raises ToktError as `checked_numbers`.
    """

    def refuse(constant: str) -> NoReturn:
        raise ToktError(f"calibration {path} holds {constant}, which is not a finite number")

    # As floats: a whole number of any length then at most becomes infinite.
    table = json.loads(text, parse_int=float, parse_constant=refuse)
    remarks: list[str] = []
    values: dict[str, ArrayLike | None] = {
        "R": table.get("rotation_vector_rad"),
        "T_mm": table.get("translation_mm"),
    }
    for number, side in (("1", "left"), ("2", "right")):
        camera = table[side]
        if not isinstance(camera, dict):
            raise ToktError(f"calibration {path}: {side} is not a camera's table")
        lacking = [name for name in ("fx", "fy", "cx", "cy", "k") if name not in camera]
        if lacking:
            raise ToktError(f"calibration {path}: {side} has no {', '.join(lacking)}")
        fx, fy, cx, cy, skew = (
            _one(path, f"{name} of {side}", camera.get(name, 0.0))
            for name in ("fx", "fy", "cx", "cy", "skew")
        )
        values[f"K{number}"] = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1]])
        values[f"D{number}"] = _printed_distortion(path, side, camera, remarks)
    names = [name for name in ("image_width", "image_height") if name in table]
    size = np.array([_one(path, name, table[name]) for name in names]) if names else None
    return checked_numbers(path, "printed table (JSON)", values, size, remarks)


def _one(path: Path, name: str, value: Any) -> float:
    number = finite_array(path, name, value)
    if number.size != 1:
        raise ToktError(f"calibration {path}: {name} is not one number")
    return float(number.item())


def _printed_distortion(
    path: Path, side: str, camera: Mapping[str, Any], remarks: list[str]
) -> F64:
    """OpenCV's k1 k2 p1 p2 k3 from k = k1 k2 k3 k4 ... and p = p1 p2 ...; says what is left out."""
    k = finite_array(path, f"k of {side}", camera["k"]).ravel()
    p = finite_array(path, f"p of {side}", camera.get("p", [])).ravel()
    beyond = [f"k{i} = {value:g}" for i, value in enumerate(k[3:], 4) if value]
    beyond += [f"p{i} = {value:g}" for i, value in enumerate(p[2:], 3) if value]
    if beyond:
        remarks.append(
            f"{side}: {', '.join(beyond)} has no place in OpenCV's k1 k2 p1 p2 k3 and is left out"
        )
    if k[2:4].any() and not p.any():
        remarks.append(
            f"{side}: all tangential numbers are 0. If the printed k is Bouguet's kc, its 3rd and "
            "4th number are p1 and p2, not k3 and k4"
        )
    k1, k2, k3 = np.pad(k, (0, 3))[:3]
    p1, p2 = np.pad(p, (0, 2))[:2]
    return np.array([k1, k2, p1, p2, k3], np.float64)
