"""The numbers in a stereo calibration file, whichever of the usual forms it has.

Three text forms are read: OpenCV's FileStorage (YAML, JSON, XML), what Bouguet's camera
calibration toolbox prints or exports, and a table as a thesis prints it. Whether the cameras
described can be is not judged here.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import cv2
import numpy as np
from numpy.typing import ArrayLike

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError, os_errors_as

FORMAT_VERSION = 1
"""Of the files that `calibration_writer` writes; those written before have no such key, and
perhaps no frame size."""
MISSION_FRAME_SIZE = (1360, 1024)
"""Width and height in pixels of the mission cameras (Prosilica GC1380C), which a calibration
that does not say its frames' size is for."""

_MAX_BYTES = 1 << 20
_MAX_BRACKETS = 5000
"""OpenCV's parser needs memory with the square of the nesting depth."""
_MAX_NUMBERS = 64
_MAX_NUMBER = 1e9
_MM_PER = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), 1.0),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), 10.0),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1000.0),
    **dict.fromkeys(("in", "inch", "inches"), 25.4),
}
_OPENCV_NAMES = {
    "K1": ("K1", "M1", "cameraMatrix1", "camera_matrix_1", "K_left", "mtxL"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "D_left", "distL"),
    "K2": ("K2", "M2", "cameraMatrix2", "camera_matrix_2", "K_right", "mtxR"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "D_right", "distR"),
    "R": ("R", "Rot"),
    "R1": ("R1",),
    "R2": ("R2",),
}
"""Our name, OpenCV's sample program's, its functions' parameters', and other usual ones."""
_OPENCV_SHIFTS = {"T_mm": "mm", "T_cm": "cm", "T_m": "m", "T": None, "Trns": None}
PARTS = ("K1", "D1", "K2", "D2", "R", "T_mm")
"""What every calibration has."""
_SHAPES: dict[str, tuple[tuple[int, ...], tuple[int, ...], str]] = {
    **dict.fromkeys(("K1", "K2", "R"), ((9,), (3, 3), "be 3x3")),
    # As many coefficients as OpenCV's models have.
    **dict.fromkeys(("D1", "D2"), ((4, 5, 8, 12, 14), (-1,), "hold 4, 5, 8, 12 or 14 numbers")),
    "T_mm": ((3,), (3, 1), "hold 3 numbers"),
}
_MATLAB_MAGIC = b"MATLAB "


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras and how they stand to each other; all float64.

    Parameters
    ----------
    K1, K2 : array, shape (3, 3)
        Camera matrices of the left and the right camera, in pixels of `frame_size`; the centre
        of the first pixel is at (0, 0).
    D1, D2 : array, shape (4..14,)
        Distortion coefficients in OpenCV's order: k1, k2, p1, p2, k3, ... A point at r from the
        axis (on the plane at distance 1) is seen at r * (1 + k1 r^2 + k2 r^4 + k3 r^6), its x
        moved by 2 p1 x y + p2 (r^2 + 2 x^2), its y by p1 (r^2 + 2 y^2) + 2 p2 x y.
    R : array, shape (3, 3)
        Rotation from left camera coordinates to right ones.
    T_mm : array, shape (3, 1)
        Translation from left camera coordinates to right ones, in millimetres: a point of the
        right camera is R @ left + T_mm.
    frame_size : (int, int)
        Width and height in pixels of the frames it is for.
    """

    K1: F64
    D1: F64
    K2: F64
    D2: F64
    R: F64
    T_mm: F64
    frame_size: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class CalibrationNumbers(StereoCalibration):
    """A calibration as a file has it, finite, and what else stands there."""

    path: Path
    form: str  # what kind of file it is, in words
    R1: F64 | None = None  # rectifying rotations, where the file has them
    R2: F64 | None = None
    remarks: Sequence[str] = ()  # what was assumed or left out in reading it


def read_numbers(path: Path | str) -> CalibrationNumbers:
    """Read a calibration file of any text form, told apart by its content.

    Raises ToktError if it cannot be read, is none of the forms, lacks a part, or holds a number
    that is not finite.
    """
    path = Path(path)
    text = _text(path)
    if re.search(r"\bfc_(left|right)\s*=", text):
        return _read_bouguet(path, text)
    printed = _printed_table(path, text)
    return _read_opencv(path, text) if printed is None else _read_printed(path, printed)


def _text(path: Path) -> str:
    if not path.is_file():
        raise ToktError(f"calibration {path} does not exist")
    with os_errors_as(f"calibration {path} cannot be read"), path.open("rb") as handle:
        data = handle.read(_MAX_BYTES + 1)
    if data.startswith(_MATLAB_MAGIC) or path.suffix.lower() == ".mat":
        words = "is a MATLAB file: only `tokt` commands read it, named .mat"
        raise ToktError(f"calibration {path} {words}")
    if len(data) > _MAX_BYTES:
        raise ToktError(f"calibration {path} is no calibration: it is larger than 1 MB")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:  # Bouguet's plus-minus signs, as MATLAB on Windows exports them
        text = data.decode("latin-1")
    if "\0" in text or sum(map(text.count, "[{<")) > _MAX_BRACKETS:
        _unknown_form(path)
    return text


def _unknown_form(path: Path) -> NoReturn:
    raise ToktError(
        f"calibration {path} is not an OpenCV YAML, JSON or XML file, "
        "nor a Bouguet toolbox export, nor a printed table"
    )


def checked_numbers(
    path: Path,
    form: str,
    values: Mapping[str, ArrayLike | None],
    frame_size: ArrayLike | None,
    remarks: Sequence[str] = (),
) -> CalibrationNumbers:
    """Put what was read into arrays of the right shape.

    Parameters
    ----------
    values : mapping
        K1 D1 K2 D2 R T_mm, perhaps R1 R2; R may be a rotation vector in radians.
    frame_size : two numbers, or None
        Width and height.

    Raises
    ------
    ToktError
        If a part is missing, has another shape, or holds a number that is not finite.
    """
    missing = [name for name in PARTS if values.get(name) is None]
    if missing:
        raise ToktError(f"calibration {path} has no {', '.join(missing)}")
    arrays = {
        name: _finite(path, name, value) for name, value in values.items() if value is not None
    }
    if arrays["R"].size == 3:
        arrays["R"] = _finite(path, "R", cv2.Rodrigues(arrays["R"].ravel())[0])
    for name, (sizes, shape, words) in _SHAPES.items():
        if arrays[name].size not in sizes:
            raise ToktError(f"calibration {path}: {name} must {words}")
        arrays[name] = arrays[name].reshape(shape)
    size, (width, height) = frame_size, MISSION_FRAME_SIZE
    if size is None:
        size = width, height
        remarks = [*remarks, f"it does not say its frames' size: taken for {width}x{height}"]
    sides = _finite(path, "the frame size", size).ravel()
    if sides.size != 2 or (sides != sides.round()).any() or (abs(sides) > 1e6).any():
        words = "the frame size is not a width and a height in pixels"
        raise ToktError(f"calibration {path}: {words}")
    parts: dict[str, Any] = {**arrays, "frame_size": (int(sides[0]), int(sides[1]))}
    return CalibrationNumbers(**parts, path=path, form=form, remarks=remarks)


def _finite(path: Path, name: str, value: ArrayLike) -> F64:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ToktError(f"calibration {path}: {name} is not a list of numbers") from None
    if not np.isfinite(array).all():
        raise ToktError(f"calibration {path}: {name} holds a number that is not finite")
    if (np.abs(array) > _MAX_NUMBER).any():
        raise ToktError(f"calibration {path}: {name} holds a number beyond {_MAX_NUMBER:g}")
    return array


def millimetres(shift: ArrayLike, unit: str | None, remarks: list[str]) -> F64:
    """A translation in millimetres; what is assumed of its unit is added to `remarks`."""
    factor = _MM_PER.get((unit or "").strip().lower())
    if factor is None:
        said = "has no unit" if not unit else f"has the unknown unit {unit[:20]!r}"
        remarks.append(f"the translation {said}: it is taken for millimetres")
    return np.asarray(shift, np.float64) * (factor or 1.0)


# --- OpenCV FileStorage ---


def _read_opencv(path: Path, text: str) -> CalibrationNumbers:
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError):
        _unknown_form(path)
    try:
        return _opencv_numbers(path, storage)
    except (cv2.error, SystemError, UnicodeDecodeError):
        raise ToktError(f"calibration {path}: its matrices cannot be read") from None
    finally:
        storage.release()


def _opencv_numbers(path: Path, storage: cv2.FileStorage) -> CalibrationNumbers:
    version = storage.getNode("format_version")
    if version.isInt() and version.real() > FORMAT_VERSION:
        newer = f"is of format {version.real():.0f}: a newer tokt reads it"
        raise ToktError(f"calibration {path} {newer}")
    remarks: list[str] = []
    values: dict[str, ArrayLike | None] = {
        name: _first_array(storage, others) for name, others in _OPENCV_NAMES.items()
    }
    values["T_mm"] = _opencv_shift(path, storage, remarks)
    return checked_numbers(path, "OpenCV FileStorage", values, _opencv_size(storage), remarks)


def _first_array(storage: cv2.FileStorage, names: Sequence[str]) -> F64 | None:
    arrays = (_node_array(storage.getNode(name)) for name in names)
    return next((array for array in arrays if array is not None), None)


def _node_array(node: cv2.FileNode) -> F64 | None:
    """A matrix, or a (nested) list of numbers; None for anything else.

    A matrix is put together here: OpenCV's own reader ends the process where one is damaged.
    """
    if node.isMap():
        sizes = [node.getNode(key) for key in ("sizes", "rows", "cols")]
        sides = [side for size in sizes for side in _listed(size)]
        numbers = _listed(node.getNode("data"))
        if not sides or any(side < 1 or side % 1 for side in sides):
            return None
        if math.prod(sides) != len(numbers):
            return None
        return np.array(numbers, np.float64).reshape([int(side) for side in sides])
    if node.isSeq():
        return np.array(_listed(node), np.float64)
    return None


def _listed(node: cv2.FileNode, depth: int = 2) -> list[float]:
    """The number, or the numbers of a list and of the lists in it."""
    if node.isInt() or node.isReal():
        return [float(node.real())]
    if not depth or not node.isSeq() or node.size() > _MAX_NUMBERS:
        return []
    items = map(node.at, range(node.size()))
    return [number for item in items for number in _listed(item, depth - 1)]


def _opencv_shift(path: Path, storage: cv2.FileStorage, remarks: list[str]) -> F64 | None:
    for name, unit in _OPENCV_SHIFTS.items():
        shift = _node_array(storage.getNode(name))
        if shift is not None:
            stated = (storage.getNode(key) for key in ("T_unit", "unit", "units"))
            words = [node.string() for node in stated if node.isString()]
            return millimetres(shift, unit or (words[0] if words else None), remarks)
    return None


def _opencv_size(storage: cv2.FileStorage) -> ArrayLike | None:
    for pair in (("image_width", "image_height"), ("width", "height")):
        sides = [storage.getNode(name) for name in pair]
        if all(side.isInt() or side.isReal() for side in sides):
            return [side.real() for side in sides]
    return _first_array(storage, ("image_size", "imageSize", "frame_size"))


# --- Bouguet's toolbox ---


def _read_bouguet(path: Path, text: str) -> CalibrationNumbers:
    """Read assignments such as ``fc_left = [ 533.0 533.2 ] ± [ 1.1 1.1 ]``.

    The uncertainties behind ± are not read. Of a name that stands there twice the later one
    counts: the toolbox prints its stereo parameters before and after optimisation.
    """
    plain = re.sub(r"\.\.\.[^\n]*\n", " ", re.sub(r"%[^\n]*", "", text))
    found = re.findall(r"\b([A-Za-z]\w*)\s*=\s*(?:\[([^\]]*)\]|([^\s;,\[]+))", plain)
    values = {name: (inside or alone) for name, inside, alone in found if name in BOUGUET_NAMES}
    words = {name: re.findall(r"[^\s,;]+", value) for name, value in values.items()}
    numbers = {name: _finite(path, name, each) for name, each in words.items()}
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

    Parameters
    ----------
    values : mapping
        fc_left, cc_left, kc_left, the same for right, om or R, T in millimetres; perhaps
        alpha_c_left and alpha_c_right (skew over the focal length), nx and ny.

    Raises
    ------
    ToktError
        As `checked_numbers`.
    """
    needed = [f"{part}_{side}" for side in ("left", "right") for part in ("fc", "cc", "kc")]
    missing = [name for name in (*needed, "T") if name not in values]
    missing += [] if "om" in values or "R" in values else ["om"]
    if missing:
        raise ToktError(f"calibration {path} has no {', '.join(missing)}")
    got = {name: _finite(path, name, value).ravel() for name, value in values.items()}
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


# --- as printed ---


def _printed_table(path: Path, text: str) -> dict[str, Any] | None:
    """The JSON object of a printed table; None where the text is none."""

    def refuse(constant: str) -> NoReturn:
        raise ToktError(f"calibration {path} holds {constant}, which is not a finite number")

    try:
        # As floats: a whole number of any length then at most becomes infinite.
        value = json.loads(text, parse_int=float, parse_constant=refuse)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) and {"left", "right"} <= value.keys() else None


def _read_printed(path: Path, table: dict[str, Any]) -> CalibrationNumbers:
    """Read ``left`` and ``right`` (fx fy cx cy skew k p), rotation vector and translation.

    Angles are in radians, lengths in millimetres; as in Bouguet's toolbox a point of the right
    camera is R @ left + T.
    """
    remarks: list[str] = []
    values: dict[str, ArrayLike | None] = {
        "R": table.get("rotation_vector_rad"),
        "T_mm": table.get("translation_mm"),
    }
    for number, side in _BOUGUET_SIDES.items():
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
    number = _finite(path, name, value)
    if number.size != 1:
        raise ToktError(f"calibration {path}: {name} is not one number")
    return float(number.item())


def _printed_distortion(
    path: Path, side: str, camera: Mapping[str, Any], remarks: list[str]
) -> F64:
    """OpenCV's k1 k2 p1 p2 k3 from k = k1 k2 k3 k4 ... and p = p1 p2 ...; says what is left out."""
    k = _finite(path, f"k of {side}", camera["k"]).ravel()
    p = _finite(path, f"p of {side}", camera.get("p", [])).ravel()
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


_STEPS = 4000
_FARTHEST = 4.0
"""How far the walk goes out, in distances of the farthest corner."""


def folds_back_at_px(K: F64, D: F64, frame_size: tuple[int, int]) -> float | None:
    """Where, inside the frame, radial distortion stops moving outwards; None where it does not.

    In pixels from the principal point. Beyond it nothing can be undistorted: two directions are
    seen at one place, and others nowhere. Of OpenCV's longer models the rational part (k4, k5, k6)
    is looked at; focal lengths are positive.
    """
    width, height = frame_size
    x = max(abs(K[0, 2]), abs(width - 1 - K[0, 2])) / K[0, 0]
    y = max(abs(K[1, 2]), abs(height - 1 - K[1, 2])) / K[1, 1]
    corner = float(np.hypot(x, y))  # the farthest one, on the plane at distance 1
    k1, k2, _, _, k3, k4, k5, k6 = np.pad(np.ravel(D), (0, 8))[:8]
    r = np.linspace(0.0, _FARTHEST * corner, _STEPS)
    r2 = r * r
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        outwards = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        seen = r * outwards / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        rising = np.diff(seen) > 0
    stops = len(rising) if rising.all() else int(np.argmin(rising))
    if seen[stops] >= corner:
        return None
    return float(seen[stops] * K[0, 0])
