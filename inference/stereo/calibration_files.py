"""The numbers of a stereo calibration in OpenCV's FileStorage (YAML, JSON, XML).

Files of other tools are recognised, and read by `tokt calibrate` alone, which writes them in this
form. Whether the cameras described can be is not judged here.
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
from tokt.features.common.errors import ToktError, os_words
from tokt.features.common.held_files import file_bytes

FORMAT_VERSION = 1
"""Of the files that `calibration_writer` writes; those written before have no such key, and
perhaps no frame size."""
MISSION_FRAME_SIZE = (1360, 1024)
"""Width and height in pixels of the mission cameras (Prosilica GC1380C), which a calibration
that does not say its frames' size is for."""

_MAX_BYTES = 1 << 20
_MAX_BRACKETS = 5000  # OpenCV's parser needs memory with the square of the nesting depth
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
OPENCV, MATLAB = "OpenCV FileStorage", "a MATLAB file"
BOUGUET, PRINTED = "a Bouguet toolbox export", "a printed table"
"""The forms of a calibration file; all but the first are only converted."""


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


def read_numbers(*paths: Path) -> CalibrationNumbers:
    """Read a calibration of OpenCV's form, from one file or from several that share its parts.

    Raises ToktError if a file cannot be read or has another form, if a part is missing or stands
    in two files, or if a number is not finite.
    """
    name = Path(", ".join(map(str, paths)))  # for messages
    values: dict[str, ArrayLike | None] = {}
    size: ArrayLike | None = None
    remarks: list[str] = []
    for path in paths:
        form, text = read_form(path)
        if form != OPENCV:
            raise ToktError(
                f"calibration {path} is {form}: convert it first, with "
                f"`tokt calibrate {path} -o FILE.yml`"
            )
        parts, own_size = _read_opencv(path, text, remarks)
        twice = sorted(values.keys() & parts.keys())
        if twice:
            raise ToktError(f"calibration {name} has {', '.join(twice)} in two files")
        values |= parts
        size = size if own_size is None else own_size
    return checked_numbers(name, OPENCV, values, size, remarks)


def read_form(path: Path) -> tuple[str, str]:
    """Return which form a calibration file has, told apart by its content, and its text.

    The text of a MATLAB file is empty. Raises ToktError if the file cannot be read, is too large,
    or is no text.
    """
    if path.exists() and not path.is_file():
        raise ToktError(f"calibration {path} is no file")
    try:
        data = file_bytes(path, at_most=_MAX_BYTES + 1)
    except FileNotFoundError:
        raise ToktError(f"calibration {path} does not exist") from None
    except OSError as error:
        raise ToktError(f"calibration {path} cannot be read: {os_words(error)}") from None
    if data.startswith(_MATLAB_MAGIC) or path.suffix.lower() == ".mat":
        return MATLAB, ""
    if len(data) > _MAX_BYTES:
        raise ToktError(f"calibration {path} is no calibration: it is larger than 1 MB")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:  # Bouguet's plus-minus signs, as MATLAB on Windows exports them
        text = data.decode("latin-1")
    if "\0" in text or sum(map(text.count, "[{<")) > _MAX_BRACKETS:
        _unknown_form(path)
    if re.search(r"\bfc_(left|right)\s*=", text):
        return BOUGUET, text
    try:
        value = json.loads(text, parse_int=float)
    except (ValueError, RecursionError):
        return OPENCV, text
    is_table = isinstance(value, dict) and {"left", "right"} <= value.keys()
    return (PRINTED if is_table else OPENCV), text


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

    `values` are K1 D1 K2 D2 R T_mm, perhaps R1 R2; R may be a rotation vector in radians.
    `frame_size` is width and height, or None.

    Raises ToktError if a part is missing, has another shape, or holds a number that is not finite.
    """
    missing = [name for name in PARTS if values.get(name) is None]
    if missing:
        raise ToktError(f"calibration {path} has no {', '.join(missing)}")
    arrays = {
        name: finite_array(path, name, value) for name, value in values.items() if value is not None
    }
    if arrays["R"].size == 3:
        arrays["R"] = finite_array(path, "R", cv2.Rodrigues(arrays["R"].ravel())[0])
    for name, (sizes, shape, words) in _SHAPES.items():
        if arrays[name].size not in sizes:
            raise ToktError(f"calibration {path}: {name} must {words}")
        arrays[name] = arrays[name].reshape(shape)
    size, (width, height) = frame_size, MISSION_FRAME_SIZE
    if size is None:
        size = width, height
        remarks = [*remarks, f"it does not say its frames' size: taken for {width}x{height}"]
    sides = finite_array(path, "the frame size", size).ravel()
    if sides.size != 2 or (sides != sides.round()).any() or (abs(sides) > 1e6).any():
        words = "the frame size is not a width and a height in pixels"
        raise ToktError(f"calibration {path}: {words}")
    parts: dict[str, Any] = {**arrays, "frame_size": (int(sides[0]), int(sides[1]))}
    return CalibrationNumbers(**parts, path=path, form=form, remarks=remarks)


def finite_array(path: Path, name: str, value: ArrayLike) -> F64:
    """Return numbers of a file as an array; ToktError if they are none, not finite or absurd."""
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


def _read_opencv(
    path: Path, text: str, remarks: list[str]
) -> tuple[dict[str, ArrayLike | None], ArrayLike | None]:
    """Return the parts that a file holds, and the frame size that it names."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError):
        _unknown_form(path)
    try:
        version = storage.getNode("format_version")
        if version.isInt() and version.real() > FORMAT_VERSION:
            newer = f"is of format {version.real():.0f}: a newer tokt reads it"
            raise ToktError(f"calibration {path} {newer}")
        parts = {name: _first_array(storage, others) for name, others in _OPENCV_NAMES.items()}
        parts["T_mm"] = _opencv_shift(path, storage, remarks)
        held: dict[str, ArrayLike | None] = {}
        held |= {name: array for name, array in parts.items() if array is not None}
        return held, _opencv_size(storage)
    except (cv2.error, SystemError, UnicodeDecodeError):
        raise ToktError(f"calibration {path}: its matrices cannot be read") from None
    finally:
        storage.release()


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


_STEPS = 4000
_FARTHEST = 4.0  # how far the walk goes out, in distances of the farthest corner


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
