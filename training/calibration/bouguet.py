"""Stereo calibrations of Bouguet's camera calibration toolbox, as it prints or exports them."""

import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.inference.stereo.calibration_files import (
    CalibrationNumbers,
    checked_numbers,
    finite_array,
)


def read_bouguet(path: Path, text: str) -> CalibrationNumbers:
    """Read assignments such as ``fc_left = [ 533.0 533.2 ] ± [ 1.1 1.1 ]``.

    The uncertainties behind ± are not read. Of a name that stands there twice the later one
    counts: the toolbox prints its stereo parameters before and after optimisation.
    """
    plain = re.sub(r"\.\.\.[^\n]*\n", " ", re.sub(r"%[^\n]*", "", text))
    found = re.findall(r"\b([A-Za-z]\w*)\s*=\s*(?:\[([^\]]*)\]|([^\s;,\[]+))", plain)
    values = {name: (inside or alone) for name, inside, alone in found if name in BOUGUET_NAMES}
    words = {name: re.findall(r"[^\s,;]+", value) for name, value in values.items()}
    numbers = {name: finite_array(path, name, each) for name, each in words.items()}
    return bouguet_numbers(path, "Bouguet toolbox text", numbers)


_BOUGUET_SIDES = {"1": "left", "2": "right"}
_BOUGUET_SIZES = {"fc": 2, "cc": 2, "alpha_c": 1}
BOUGUET_NAMES = (
    *(f"{part}_{side}" for part in ("fc", "cc", "alpha_c", "kc") for side in ("left", "right")),
    *("om", "R", "T", "nx", "ny"),
)


def bouguet_numbers(path: Path, form: str, values: Mapping[str, ArrayLike]) -> CalibrationNumbers:
    """Turn the toolbox's variables into OpenCV's.

    Both have the centre of the first pixel at (0, 0) (the toolbox subtracts MATLAB's 1 from the
    corners it finds), both order ``kc`` as k1, k2, p1, p2, k3, and in both a point of the right
    camera is R @ left + T, with R from the rotation vector ``om``.

    The variables are fc_left, cc_left, kc_left, the same for right, om or R, T in millimetres;
    perhaps alpha_c_left and alpha_c_right (skew over the focal length), nx and ny. Raises ToktError
    as `checked_numbers`.
    """
    needed = [f"{part}_{side}" for side in ("left", "right") for part in ("fc", "cc", "kc")]
    missing = [name for name in (*needed, "T") if name not in values]
    missing += [] if "om" in values or "R" in values else ["om"]
    if missing:
        raise ToktError(f"calibration {path} has no {', '.join(missing)}")
    got = {name: finite_array(path, name, value).ravel() for name, value in values.items()}
    remarks: list[str] = []
    parts: dict[str, ArrayLike | None] = {"T_mm": got["T"], "R": _bouguet_rotation(got, remarks)}
    for number, side in _BOUGUET_SIDES.items():
        (fx, fy), (cx, cy), (alpha,) = (
            _sized(path, got, f"{part}_{side}", size) for part, size in _BOUGUET_SIZES.items()
        )
        parts[f"K{number}"] = np.array([[fx, alpha * fx, cx], [0, fy, cy], [0, 0, 1]])
        kc = got[f"kc_{side}"]
        if kc.size not in (4, 5):
            raise ToktError(f"calibration {path}: kc_{side} must hold k1 k2 p1 p2 k3")
        parts[f"D{number}"] = np.pad(kc, (0, 5 - kc.size))
    size = np.append(got["nx"], got["ny"]) if "nx" in got and "ny" in got else None
    return checked_numbers(path, form, parts, size, remarks)


def _sized(path: Path, got: Mapping[str, F64], name: str, size: int) -> F64:
    array = got.get(name, np.zeros(1))
    if array.size != size:
        raise ToktError(f"calibration {path}: {name} must hold {size} number{'s' * (size > 1)}")
    return array


def _bouguet_rotation(got: Mapping[str, F64], remarks: list[str]) -> F64:
    if "om" not in got or got["om"].size != 3:
        return got.get("R", got.get("om", np.zeros(0)))
    R = np.asarray(cv2.Rodrigues(got["om"])[0], np.float64)
    if "R" in got and (got["R"].size != 9 or abs(got["R"].reshape(3, 3) - R).max() > 1e-3):
        remarks.append("om and R are not the same rotation: om is used")
    return R
