"""Kinds of changed calibration and odometry files, in each form that is read."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
from tokt.inference.calibration import describe, read_calibration
from tokt.inference.odometry import load_odometry
from tokt.inference.rectify import Rectifier

from .bytes_changes import changed_bytes
from .case import Files, Kind, write_files
from .json_changes import changed_text

_YAML = """%YAML 1.0
---
format_version: 1
image_width: 64
image_height: 48
K1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 80.5, 0., 31.5, 0., 80.5, 23.5, 0., 0., 1. ]
D1: !!opencv-nd-matrix
   sizes: [ 5 ]
   dt: d
   data: [ 0.25, 0.5, 0., 0., 0.125 ]
K2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 81.25, 0., 31.5, 0., 81.25, 23.5, 0., 0., 1. ]
D2: [ 0.25, 0.5, 0., 0., 0. ]
R: [ [ 1., 0., 0. ], [ 0., 1., 0. ], [ 0., 0., 1. ] ]
T_mm: [ -305.5, 1.5, 2. ]
provenance: { made: "by hand", from: "nothing" }
"""
_BOUGUET = """Intrinsic parameters of left camera:
Focal Length:          fc_left = [ 53.00371   53.15260 ] ± [ 1.07629   1.10913 ]
Principal point:       cc_left = [ 34.58612   23.25940 ] ± [ 1.24041   1.33065 ]
Skew:             alpha_c_left = [ 0.00000 ] ± [ 0.00000  ]   => angle = 90.00000
Distortion:            kc_left = [ -0.28838   0.09714   0.00109  -0.00030  0.01 ] ± [ 0.1 ]
Focal Length:          fc_right = [ 53.98262   53.56938 ] ± [ 1.19786   1.15677 ]
Principal point:       cc_right = [ 32.47209   24.33257 ] ± [ 1.36588   1.34252 ]
Distortion:            kc_right = [ -0.28936   0.10677   -0.00078  0.00020  0.00000 ] ± [ 0.1 ]
Rotation vector:             om = [ 0.00669   0.00452  -0.00350 ] ± [ 0.00270   0.00308 ]
Translation vector:           T = [ -99.80198   1.12443   0.05041 ] ± [ 0.14200   0.11352 ]
nx = 64; ny = 48;
"""
_CAMERA = {
    "fx": 80,
    "fy": 81,
    "cx": 31.5,
    "cy": 23.5,
    "skew": 0,
    "k": [0.25, 0.5, 0, 0, 0],
    "p": [0],
}
_PRINTED = {
    "left": _CAMERA,
    "right": {**_CAMERA, "k": [0.25], "p": []},
    "rotation_vector_rad": [0.0, 0.02, 0.0],
    "translation_mm": [-303.5, 1, 2],
    "image_width": 64,
    "image_height": 48,
}
_POSES = "\n".join(
    ["frame,t,x_m,y_m,z_m,qw,qx,qy,qz"]
    + [f"{n},{n / 2},{n},0.5,-1e-3,1,0,0,0" for n in range(6)]
    + ["9,4.5,0,0,0,0.5,0.5,0.5,0.5", ""]
)


@cache
def _opencv_forms() -> dict[str, bytes]:
    """The same calibration as OpenCV itself writes it, and as a person does."""
    storage = cv2.FileStorage(_YAML, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    arrays = {name: storage.getNode(name).mat() for name in ("K1", "K2", "D1")}
    forms = {"c.yml": _YAML.encode()}
    for suffix in (".yml", ".json", ".xml"):
        writing = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
        out = cv2.FileStorage(suffix, writing)
        out.write("image_width", 64)
        out.write("image_height", 48)
        for name, array in {**arrays, "D2": arrays["D1"], "R": np.eye(3)}.items():
            out.write(name, array)
        out.write("T", np.array([[-305.5], [1.5], [2.0]]))
        out.write("T_unit", "mm")
        forms[f"opencv{suffix}"] = out.releaseAndGetString().encode()
    return forms


def _opencv(rng: Random) -> Files:
    forms = _opencv_forms()
    name = rng.choice(sorted(forms))
    return {f"c{Path(name).suffix}": changed_bytes(forms[name], rng, list(forms.values()))}


def _bouguet(rng: Random) -> Files:
    data = _BOUGUET.encode(rng.choice(("utf-8", "cp1252")))
    return {"c.txt": changed_bytes(data, rng, [data, _YAML.encode()])}


def _printed(rng: Random) -> Files:
    text = json.dumps(_PRINTED).encode()
    if rng.random() < 0.6:
        return {"c.json": changed_text(_PRINTED, rng)}
    return {"c.json": changed_bytes(text, rng, [text, *_opencv_forms().values()])}


def _odometry(rng: Random) -> Files:
    return {"o.csv": changed_bytes(_POSES.encode(), rng, [_POSES.encode(), _YAML.encode()])}


def _read(files: Files, folder: Path) -> object:
    """Read a calibration and work out from it what the runtime does once."""
    write_files(files, folder)
    (name,) = files
    return Rectifier(read_calibration(folder / name).usable())


def _read_odometry(files: Files, folder: Path) -> object:
    write_files(files, folder)
    return load_odometry(folder / "o.csv")


# --- MATLAB's binary files, which scipy reads, in a process of its own ---


@cache
def _matlab_forms() -> tuple[bytes, ...]:
    from scipy.io import savemat

    sides: dict[str, Any] = {}
    for side in ("left", "right"):
        sides |= {f"fc_{side}": [[80.0], [81.0]], f"cc_{side}": [[31.5], [23.5]]}
        sides |= {f"alpha_c_{side}": 0.0, f"kc_{side}": [[0.1], [0.2], [0.01], [0.02], [0.3]]}
    sides |= {
        "om": [[0.01], [-0.02], [0.03]],
        "T": [[-300.0], [2.0], [3.0]],
        "nx": 64.0,
        "ny": 48.0,
    }
    camera = {
        "IntrinsicMatrix": np.array([[80.0, 0, 0], [0, 81, 0], [32, 24, 1]]),
        "RadialDistortion": np.array([[0.1, 0.2]]),
        "TangentialDistortion": np.array([[0.0, 0.0]]),
        "ImageSize": np.array([[48.0, 64.0]]),
        "WorldUnits": "millimeters",
    }
    params = {
        "CameraParameters1": camera,
        "CameraParameters2": camera,
        "RotationOfCamera2": np.eye(3),
        "TranslationOfCamera2": np.array([[-300.0, 2, 3]]),
    }
    forms = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "c.mat"
        for content in (sides, {"stereoParams": params}):
            for packed in (False, True):
                savemat(file, content, do_compression=packed)
                forms.append(file.read_bytes())
    return tuple(forms)


def _matlab(rng: Random) -> Files:
    forms = _matlab_forms()
    return {"c.mat": changed_bytes(rng.choice(forms), rng, forms)}


def _read_matlab(files: Files, folder: Path) -> object:
    from tokt.training.stereo.matlab_file import read_matlab_numbers

    write_files(files, folder)
    return describe(read_matlab_numbers(folder / "c.mat")).usable()


KINDS = [
    Kind("calibration.opencv", "files", 20, _opencv, _read),
    Kind("calibration.bouguet", "files", 8, _bouguet, _read),
    Kind("calibration.printed", "files", 8, _printed, _read),
    Kind("calibration.mat", "files", 1, _matlab, _read_matlab, most=200),
    Kind("odometry", "files", 8, _odometry, _read_odometry),
]
