"""MATLAB's binary files with a stereo calibration: Bouguet's toolbox, Computer Vision Toolbox."""

import sys
import zlib
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError
from tokt.inference.stereo.calibration_files import CalibrationNumbers, checked_numbers, millimetres

from .bouguet import BOUGUET_NAMES, bouguet_numbers

BOUGUET_FORM = "Bouguet toolbox .mat"
STEREO_PARAMS_FORM = "MATLAB stereoParams .mat"

_MAGIC = b"MATLAB 5.0 MAT-file"
_MAGIC_73 = b"MATLAB 7.3 MAT-file"
_HDF5 = b"\x89HDF"
_MAX_BYTES = 64 << 20
_MAX_MEMORY = 4 << 30
"""Bytes of address space for reading one: compressed variables can unfold to far more."""
_DAMAGED = (
    *(ValueError, TypeError, KeyError, IndexError, ArithmeticError, EOFError, MemoryError),
    *(OSError, UnboundLocalError, NotImplementedError, zlib.error, MatReadError),
)
"""What scipy raises for files that are not as they should be."""


def read_matlab_numbers(path: Path | str) -> CalibrationNumbers:
    """`matlab_numbers` in a process of its own: scipy crashes on some files, a ToktError, too."""
    path = Path(path)
    context = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, initializer=_limit_memory) as child:
        try:
            return child.submit(matlab_numbers, path).result()
        except BrokenProcessPool:
            _damaged(path)


def _limit_memory() -> None:
    """For the process that reads; Windows has no such limit."""
    if sys.platform == "win32":
        return
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY or most > _MAX_MEMORY:
        resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY, most))


def _damaged(path: Path) -> NoReturn:
    raise ToktError(f"calibration {path} is damaged: its variables cannot be read")


def matlab_numbers(path: Path) -> CalibrationNumbers:
    """Read a calibration from a MATLAB version 5 file, which MATLAB saves by default.

    ``Calib_Results_stereo.mat`` of Bouguet's toolbox, or a file with the struct that
    ``toStruct(stereoParams)`` gives. Raises ToktError if it cannot be read, is of version 7.3 or 4,
    or holds no stereo calibration.
    """
    variables = _variables(path)
    if "fc_left" in variables or "fc_right" in variables:
        found = {name: variables[name] for name in BOUGUET_NAMES if name in variables}
        return bouguet_numbers(path, BOUGUET_FORM, found)
    params = _stereo_params(variables)
    if params is not None:
        return _from_stereo_params(path, params)
    if "__function_workspace__" in variables or "None" in variables:
        raise ToktError(
            f"calibration {path} holds a MATLAB object, which only MATLAB reads: "
            "save s = toStruct(stereoParams) instead"
        )
    raise ToktError(f"calibration {path} holds neither fc_left nor a stereoParams struct")


def _variables(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as handle:
            start = handle.read(len(_MAGIC))
        size = path.stat().st_size
    except FileNotFoundError:
        raise ToktError(f"calibration {path} does not exist") from None
    except OSError as error:
        raise ToktError(f"calibration {path} cannot be read: {error.strerror}") from None
    if start == _MAGIC_73 or start.startswith(_HDF5):
        raise ToktError(f"calibration {path} is of MATLAB 7.3: save it with -v7")
    if start != _MAGIC or size > _MAX_BYTES:
        raise ToktError(f"calibration {path} is not a MATLAB 5 or 7 file of at most 64 MB")
    try:
        variables: dict[str, Any] = loadmat(path, simplify_cells=True)
    except _DAMAGED:
        _damaged(path)
    return variables


def _stereo_params(values: Mapping[str, Any], depth: int = 2) -> dict[str, Any] | None:
    """The first struct with two cameras, at most `depth` structs deep."""
    for value in values.values():
        if not isinstance(value, dict):
            continue
        if {"CameraParameters1", "CameraParameters2"} <= value.keys():
            return value
        inner = _stereo_params(value, depth - 1) if depth else None
        if inner is not None:
            return inner
    return None


def _from_stereo_params(path: Path, params: Mapping[str, Any]) -> CalibrationNumbers:
    """Turn MATLAB's conventions into OpenCV's.

    MATLAB multiplies rows from the left, right = left * RotationOfCamera2 + TranslationOfCamera2,
    so that OpenCV's R is the transpose (and IntrinsicMatrix the transpose of K); it counts pixels
    from 1, so that OpenCV's principal point is one less; and ImageSize is rows, columns. Source:
    MathWorks, ``stereoParametersToOpenCV``, ``stereoParameters``, ``cameraParameters``.
    """
    remarks: list[str] = []
    values: dict[str, ArrayLike | None] = {}
    sizes = []
    for number in (1, 2):
        camera = params[f"CameraParameters{number}"]
        if not isinstance(camera, dict):
            raise ToktError(f"calibration {path}: CameraParameters{number} is not a struct")
        values[f"K{number}"] = _camera_matrix(path, camera)
        values[f"D{number}"] = _distortion(path, camera)
        sizes.append(_numbers(path, camera, "ImageSize"))
    rotation = _numbers(path, params, "RotationOfCamera2")
    shift = _numbers(path, params, "TranslationOfCamera2")
    if rotation is None or shift is None:
        raise ToktError(f"calibration {path} has no RotationOfCamera2 and TranslationOfCamera2")
    values["R"] = rotation.T
    unit = params["CameraParameters1"].get("WorldUnits")
    values["T_mm"] = millimetres(shift, unit if isinstance(unit, str) else None, remarks)
    rows_columns = sizes[0] if sizes[0] is not None else sizes[1]
    size = None if rows_columns is None else rows_columns.ravel()[::-1]
    return checked_numbers(path, STEREO_PARAMS_FORM, values, size, remarks)


def _camera_matrix(path: Path, camera: Mapping[str, Any]) -> F64:
    K, transposed = _numbers(path, camera, "K"), _numbers(path, camera, "IntrinsicMatrix")
    if K is None and transposed is not None:
        K = transposed.T
    if K is None or K.shape != (3, 3):
        raise ToktError(f"calibration {path}: a camera has no 3x3 IntrinsicMatrix or K")
    return K - [[0, 0, 1], [0, 0, 1], [0, 0, 0]]


def _distortion(path: Path, camera: Mapping[str, Any]) -> F64:
    radial = _numbers(path, camera, "RadialDistortion")
    tangential = _numbers(path, camera, "TangentialDistortion")
    if radial is None or radial.size not in (2, 3):
        raise ToktError(f"calibration {path}: RadialDistortion must hold k1 k2 or k1 k2 k3")
    if tangential is None or tangential.size != 2:
        raise ToktError(f"calibration {path}: TangentialDistortion must hold p1 p2")
    k1, k2, k3 = np.pad(radial.ravel(), (0, 1))[:3]
    return np.array([k1, k2, *tangential.ravel(), k3], np.float64)


def _numbers(path: Path, struct: Mapping[str, Any], name: str) -> F64 | None:
    """A field as numbers; None where it is missing or empty."""
    try:
        array = np.asarray(struct.get(name, ()), np.float64)
    except (TypeError, ValueError):
        raise ToktError(f"calibration {path}: {name} is not a list of numbers") from None
    return array if array.size else None
