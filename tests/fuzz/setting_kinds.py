"""Kinds of changed settings: the space of a search, an extractor's spec in a file."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random

from tokt.features.extractor import extractor_named
from tokt.training.search.space import BUILT_IN, read_space

from .bundle_seeds import SPECS, whole_spec
from .bytes_changes import changed_bytes
from .case import Files, Kind, write_files
from .json_changes import changed_text

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


def _space(rng: Random) -> Files:
    data = rng.choice((_SMALL, _SMALL, BUILT_IN.read_bytes()))
    text = changed_bytes(data, rng, [_SMALL, BUILT_IN.read_bytes()])
    spec = json.dumps(whole_spec(SPECS[0])).encode()
    return {"space.toml": text, "mine.json": spec}


def _read_space(files: Files, folder: Path) -> object:
    write_files(files, folder)
    return read_space(folder / "space.toml").to_json()


def _spec(rng: Random) -> Files:
    return {"spec.json": changed_text(whole_spec(rng.choice(SPECS)), rng)}


def _read_spec(files: Files, folder: Path) -> object:
    write_files(files, folder)
    found = extractor_named(f"spec:{folder / 'spec.json'}")
    assert len(found.names) == found.dim
    return found.spec


KINDS = [
    Kind("search space", "files", 8, _space, _read_space),
    Kind("extractor spec", "files", 8, _spec, _read_spec),
]
