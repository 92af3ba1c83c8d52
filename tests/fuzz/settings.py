"""Kinds of changed settings: calibrations in each form, odometry, search spaces, specs."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from tokt.features.extractors.extractor import extractor_named
from tokt.inference.stereo.calibration import check_calibration, read_calibration
from tokt.inference.stereo.odometry import load_odometry
from tokt.inference.stereo.rectify import Rectifier
from tokt.training.search.space import BUILT_IN, read_space

from .bundles import specs
from .case import Files, Kind
from .changes import chance, changed_bytes, changed_text

_YAML = b"""%YAML 1.0
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
_CAMERA = {"fx": 80, "fy": 81, "cx": 31.5, "cy": 23.5, "skew": 0}
_PRINTED = {
    "left": {**_CAMERA, "k": [0.25, 0.5, 0, 0, 0], "p": [0]},
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
).encode()


@cache
def _opencv_forms() -> tuple[tuple[str, bytes], ...]:
    """The same calibration, by file name, as a person writes it and as OpenCV itself does."""
    storage = cv2.FileStorage(_YAML.decode(), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    arrays: dict[str, Any] = {"image_width": 64, "image_height": 48, "T_unit": "mm"}
    arrays |= {name: storage.getNode(name).mat() for name in ("K1", "K2", "D1")}
    arrays |= {"D2": arrays["D1"], "R": np.eye(3), "T": np.array([[-305.5], [1.5], [2.0]])}
    forms = [("c.yml", _YAML)]
    for suffix in (".yml", ".json", ".xml"):
        out = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        for name, value in arrays.items():
            out.write(name, value)
        forms.append((f"c{suffix}", out.releaseAndGetString().encode()))
    return tuple(forms)


@cache
def _matlab_forms() -> tuple[bytes, ...]:
    """MATLAB's binary files, of both toolboxes, as they are and packed."""
    from scipy.io import savemat

    sides: dict[str, Any] = {"om": [[0.01], [-0.02], [0.03]], "T": [[-300.0], [2.0], [3.0]]}
    sides |= {"nx": 64.0, "ny": 48.0}
    for side in ("left", "right"):
        sides |= {f"fc_{side}": [[80.0], [81.0]], f"cc_{side}": [[31.5], [23.5]]}
        sides |= {f"alpha_c_{side}": 0.0, f"kc_{side}": [[0.1], [0.2], [0.01], [0.02], [0.3]]}
    camera = {
        "IntrinsicMatrix": np.array([[80.0, 0, 0], [0, 81, 0], [32, 24, 1]]),
        "RadialDistortion": np.array([[0.1, 0.2]]),
        "TangentialDistortion": np.array([[0.0, 0.0]]),
        "ImageSize": np.array([[48.0, 64.0]]),
        "WorldUnits": "millimeters",
    }
    pair = {"CameraParameters1": camera, "CameraParameters2": camera}
    pair |= {"RotationOfCamera2": np.eye(3), "TranslationOfCamera2": np.array([[-300.0, 2, 3]])}
    forms = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "c.mat"
        for content in (sides, {"stereoParams": pair}):
            for packed in (False, True):
                savemat(file, content, do_compression=packed)
                forms.append(file.read_bytes())
    return tuple(forms)


def sound_calibrations() -> list[Files]:
    """What the changes start from, but for MATLAB's."""
    texts = {"c.txt": _BOUGUET.encode(), "c.json": json.dumps(_PRINTED).encode()}
    return [{name: data} for name, data in (*_opencv_forms(), *texts.items())]


def _opencv(rng: Random) -> Files:
    name, data = rng.choice(_opencv_forms())
    return {name: changed_bytes(data, rng, [form for _, form in _opencv_forms()])}


def _bouguet(rng: Random) -> Files:
    data = _BOUGUET.encode(rng.choice(("utf-8", "cp1252")))
    return {"c.txt": changed_bytes(data, rng, [data, _YAML])}


def _printed(rng: Random) -> Files:
    if chance(rng, 60):
        return {"c.json": changed_text(_PRINTED, rng)}
    text = json.dumps(_PRINTED).encode()
    return {"c.json": changed_bytes(text, rng, [text, *(form for _, form in _opencv_forms())])}


def _odometry(rng: Random) -> Files:
    return {"o.csv": changed_bytes(_POSES, rng, [_POSES, _YAML])}


def _matlab(rng: Random) -> Files:
    return {"c.mat": changed_bytes(rng.choice(_matlab_forms()), rng, _matlab_forms())}


def read_rig(folder: Path) -> Rectifier:
    """Read a calibration and work out from it what the runtime does once."""
    (path,) = folder.iterdir()
    return Rectifier(read_calibration(path).usable())


def _read_matlab(folder: Path) -> object:
    """scipy reads it, in a process of its own."""
    from tokt.training.rig.calibrate.matlab_file import read_matlab_numbers

    return check_calibration(read_matlab_numbers(folder / "c.mat")).usable()


# --- the space of a search, an extractor's spec in a file ---

_SMALL = b"""format = 1
penalties = [0.1, 1.0]
class_weights = ["none", "balanced"]
changes = ["gain_0.5", "jpeg_60"]
change_weight = 0.05
[extractors]
plain = "haralick"
joined = "lbp_24_8+lbp_24_8_frame"
mine = "spec:mine.json"
[extractors.fine]
name = "moments"
version = 1
[extractors.fine.image]
resize = "area_deep"
gray = "bt601"
smooth = 1
gain = 2
levels = 16
flatten = { window = 3, by = "ratio" }
"""


def sound_space(text: bytes = _SMALL) -> Files:
    """A search space and the spec that it names."""
    return {"space.toml": text, "mine.json": json.dumps(specs()[0]).encode()}


def _space(rng: Random) -> Files:
    built_in = BUILT_IN.read_bytes()
    return sound_space(
        changed_bytes(rng.choice((_SMALL, _SMALL, built_in)), rng, [_SMALL, built_in])
    )


def read_search_space(folder: Path) -> object:
    return read_space(folder / "space.toml").to_json()


def _spec(rng: Random) -> Files:
    return {"spec.json": changed_text(rng.choice(specs()), rng)}


def _read_spec(folder: Path) -> object:
    found = extractor_named(f"spec:{folder / 'spec.json'}")
    assert len(found.names) == found.dim
    return found.spec


KINDS = [
    Kind("calibration.opencv", _opencv, read_rig, 18),
    Kind("calibration.bouguet", _bouguet, read_rig, 7),
    Kind("calibration.printed", _printed, read_rig, 7),
    Kind("calibration.mat", _matlab, _read_matlab, 0.2, few=1),
    Kind("odometry", _odometry, lambda folder: load_odometry(folder / "o.csv"), 7),
    Kind("search space", _space, read_search_space, 8),
    Kind("extractor spec", _spec, _read_spec, 8),
]
