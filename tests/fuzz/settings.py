"""Kinds of changed settings: calibrations in each form, odometry, search spaces, specs."""

import io
import json
import re
from dataclasses import asdict
from functools import cache
from pathlib import Path

import cv2
from scipy.io import savemat

from tests.training.calibration.test_calibration_files import BOUGUET_SCREEN, THESIS, VERSION_1
from tests.training.calibration.test_matlab_calibration import bouguet, stereo_params
from tokt.features.extractors.extractor import extractor_named
from tokt.inference.stereo.calibration import check_calibration
from tokt.inference.stereo.odometry import load_odometry
from tokt.inference.stereo.rectify import Rectifier
from tokt.training.calibration.any_form import describe_calibration_file
from tokt.training.calibration.matlab_file import read_matlab_numbers
from tokt.training.datasets.mission_list import named_missions
from tokt.training.search.space import BUILT_IN, read_space

from .bundles import specs
from .case import Files, Kind, alone, sound

_POSES = [f"{n},{n / 2},{n},0.5,-1e-3,1,0,0,0\n" for n in range(6)]
_HEAD, _LAST = "frame,t,x_m,y_m,z_m,qw,qx,qy,qz\n", "9,4.5,0,0,0,0.5,0.5,0.5,0.5\n"
_ODOMETRY = sound("o.csv", "".join([_HEAD, *_POSES, _LAST]))


@cache
def _opencv_forms() -> list[Files]:
    """The same calibration, by file name, as tokt, a person and OpenCV itself write it."""
    by_hand = re.sub(r"!!opencv.*?data: ", "", VERSION_1, flags=re.DOTALL)
    by_hand += 'provenance: { made: "by hand", from: "nothing" }\n'
    storage = cv2.FileStorage(VERSION_1, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    values = {name: storage.getNode(name).mat() for name in ("K1", "D1", "K2", "D2", "R")}
    values |= {"T": storage.getNode("T_mm").mat(), "T_unit": "mm"}
    forms = [{"c.yml": text.encode()} for text in (VERSION_1, by_hand)]
    for suffix in (".yml", ".json", ".xml"):
        out = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
        for name, value in {**values, "image_width": 1400, "image_height": 1040}.items():
            out.write(name, value)
        forms.append({f"c{suffix}": out.releaseAndGetString().encode()})
    return forms


_BOUGUET = f"{BOUGUET_SCREEN}nx = 640; ny = 480;\n"
_BOUGUETS = sound("c.txt", _BOUGUET.encode("utf-8"), _BOUGUET.encode("cp1252"))
_PRINTED = sound("c.json", json.dumps({**THESIS, "image_width": 1360, "image_height": 1024}))


@cache
def _matlab_forms() -> list[Files]:
    """MATLAB's binary files, of both toolboxes, as they are and packed."""
    forms = []
    for content in (bouguet(), {"stereoParams": stereo_params()}):
        for packed in (False, True):
            file = io.BytesIO()
            savemat(file, content, do_compression=packed)
            forms.append({"c.mat": file.getvalue()})
    return forms


def _read_rig(path: Path) -> Rectifier:
    """Read a calibration and work out from it what the runtime does once."""
    return Rectifier(describe_calibration_file(path).usable())


def _opencv_texts() -> list[bytes]:
    return [data for form in _opencv_forms() for data in form.values()]


def _read_matlab(path: Path) -> object:
    """scipy reads it, in a process of its own."""
    return check_calibration(read_matlab_numbers(path)).usable()


_OWN = b"""mine = "spec:mine.json"
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


def _spec_files() -> list[Files]:
    return [{"spec.json": json.dumps(spec).encode()} for spec in specs()]


def _spaces() -> list[Files]:
    built_in = BUILT_IN.read_bytes()
    own = built_in.partition(b"seabed")[0].replace(b'["none"]', b'["none", "balanced"]') + _OWN
    mine = _spec_files()[0]["spec.json"]
    return [{"space.toml": own, "mine.json": mine}, {"space.toml": built_in}]


def _read_spec(path: Path) -> object:
    found = extractor_named(f"spec:{path}")
    assert len(found.names) == found.dim
    return found.spec


_MISSIONS = sound(
    "missions.toml",
    """# dives
[[mission]]
name = "a"
dir = "a"
labels = ["l.csv", "m.csv"]
site = "fjord"
[[mission]]
name = "b"
dir = "b"
labels = "n.csv"
cameras = ["left", "right"]
date = 2016-04-20
""",
)


def _read_missions(folder: Path) -> object:
    """Read the list, and look for what it names."""
    return [path.is_dir() for one in named_missions(folder) for path in (one.path, *one.labels)]


KINDS = [
    Kind("calibration.opencv", _opencv_forms, alone(_read_rig), 18),
    Kind("calibration.bouguet", _BOUGUETS, alone(_read_rig), 7, splices=_opencv_texts),
    Kind("calibration.printed", _PRINTED, alone(_read_rig), 7, splices=_opencv_texts),
    Kind("calibration.mat", _matlab_forms, alone(_read_matlab), 0.2, few=1),
    Kind("odometry", _ODOMETRY, alone(load_odometry), 7, splices=_opencv_texts),
    Kind("search space", _spaces, lambda at: asdict(read_space(at / "space.toml")), 8),
    Kind("extractor spec", _spec_files, alone(_read_spec), 8),
    Kind("missions.toml", _MISSIONS, _read_missions, 8),
]
