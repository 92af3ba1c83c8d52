"""Kinds of changed label files, of every format, and of what stands beside them."""

import atexit
import json
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from functools import cache
from itertools import product
from pathlib import Path
from random import Random

import cv2
import numpy as np

from tests.labels.formats.examples import (
    BIIGLE,
    CORALNET,
    CVAT,
    DIVE,
    FRAMES,
    HEIGHT,
    WIDTH,
    foreign_coco,
    foreign_ifdo,
    foreign_label_studio,
    said,
)
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats import IFDO
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, read_audit, write_audit
from tokt.labels.formats.formats import FORMATS, format_to_read
from tokt.labels.formats.frame_metadata import read_ifdo
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

from .case import Files, Kind, alone, change_one, line_fault, sound
from .changes import chance, changed_text

_LABELS = Path(__file__).parents[2] / "labels"
_TAXONOMY = sound("taxonomy.toml", (_LABELS / "taxonomy.toml").read_bytes())
_TABLES = (b"[[classes]]\n", b"a.b.c = {}\n")
_KEPT = ExitStack()
atexit.register(_KEPT.close)


def write_mission(folder: Path) -> Path:
    for number, (side, frame) in enumerate(product(("Left", "Right"), FRAMES)):
        path = folder / "dive" / side / f"dive_{side[0]}_{frame}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(number).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        cv2.imwrite(str(path), pixels)
    return folder / "dive"


@cache
def _images() -> MissionImages:
    """Those of a mission that stays as long as this process."""
    # In the system's own place for such folders: that of a case is watched.
    kept = _KEPT.enter_context(tempfile.TemporaryDirectory(prefix="tokt-fuzz-", dir="/tmp"))
    return MissionImages(open_mission(write_mission(Path(kept))))


def _records() -> list[LabelRecord]:
    return [
        said("reef"),
        said("ocean", 1, 2, annotator="bo"),
        said("unsure", 2, 3),
        said("reef", 1, 2, annotator="c", source="settled"),
        said("sand", 1, 1, frame=7, source="model", model_version="m/1"),
    ]


@cache
def written(name: str) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        suffix = dict.fromkeys(("csv", "viame", "coralnet", "biigle"), ".csv").get(name, ".json")
        suffix = {"patches": "", "cvat": ".xml"}.get(name, suffix)
        target = Path(folder) / f"labels{suffix}"
        FORMATS[name].write(target, _records(), WriteOptions(Taxonomy.load(), _images(), full=True))
        paths = [target] if target.is_file() else [p for p in target.rglob("*") if p.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


_FOREIGN = {
    "csv": "mission,camera,frame,row,col,label\ndive,left,3,0,0,reef\ndive,left,3,0,1,ocean\n",
    "viame": DIVE,
    "coco": json.dumps(foreign_coco()),
    "labelstudio": json.dumps(foreign_label_studio()),
    "coralnet": CORALNET,
    "biigle": BIIGLE.replace("Cod, big", "fish").replace("Fine", "rock"),
    "cvat": CVAT,
    "ifdo": json.dumps(foreign_ifdo()),
}
"""As other tools would have written such a file, but for classes that are not ours."""


def _labels(name: str) -> Kind:
    def seeds() -> list[Files]:
        ((path, data),) = written(name).items()
        foreign = _FOREIGN[name].replace("fish", "reef").replace("rock", "sand")
        # JSON is YAML, too.
        more = [{"labels.yaml": foreign.encode()}] if name == "ifdo" else []
        return [{path: data}, {path: foreign.encode()}, *more]

    splices = [text.encode() for text in _FOREIGN.values()]
    return Kind(f"labels.{name}", seeds, alone(_import_labels), 4.5, splices=lambda: splices)


def _change_patches(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    manifest = next(path for path in files if path.endswith(".json"))
    changed = {**files, **change_one({manifest: files[manifest]}, rng, [b"{}"])}
    if chance(rng, 30):
        moved = rng.choice([path for path in files if path != manifest])
        name = rng.choice(("labels/kelp/x.png", "labels/ocean/y.png", "labels/sand/sub/z.png"))
        changed[name] = changed.pop(moved)
    return changed


def _import_labels(path: Path) -> object:
    """What `tokt labels import` does, up to the store."""
    options = ReadOptions(Taxonomy.load(), images=_images())
    kind = format_to_read(path)
    if kind == IFDO:
        read_ifdo(path, _images())
    read = FORMATS[kind].read(path, options)
    for line in read.lost:
        assert not line_fault(line), line_fault(line)
    with LabelStore(path.with_name("labels.db")) as store:
        return store.add_counted(read.records)


@cache
def _store_files() -> list[Files]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "labels.db"
        with LabelStore(path) as store:
            store.add(_records())
        return [{path.name: path.read_bytes()}]


def _change_database(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    data = bytearray(files["labels.db"])
    for _ in range(rng.choice((1, 4, 40))):
        # Pages that are in use, the header and the schema among them.
        at = rng.randrange(rng.choice((100, 4096, len(data))))
        data[at] = rng.choice((0, 0xFF, data[at] ^ (1 << rng.randrange(8)), rng.randrange(256)))
    return {"labels.db": bytes(data[: rng.randrange(len(data))] if chance(rng, 20) else data)}


def _read_database(path: Path) -> object:
    with LabelStore(path, create=False) as store:
        found = [*store.current(), *store.settled(), *store.stats(), *store.missions()]
        store.add(_records())
        return found


_TAXONOMY_JSON = sound("t.json", json.dumps(Taxonomy.load().to_json()))


def _change_taxonomy(files: Files, rng: Random, others: Sequence[bytes]) -> Files:
    return {"t.json": changed_text(json.loads(files["t.json"]), rng)}


def _read_taxonomy(path: Path) -> object:
    """As a dataset version embeds it; what is no JSON never gets there."""
    try:
        value = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return None
    return Taxonomy.from_json(value)


@cache
def _audits() -> list[Files]:
    patch = AuditedPatch("dive", "left", 3, 1, 2, "ocean", "reef", -1.25, "in words")
    with tempfile.TemporaryDirectory() as folder:
        audit = Audit("a", "dataset a@1", Grid(), "rule", (patch, patch))
        return [{"audits/a.json": write_audit(Path(folder), audit).read_bytes()}]


KINDS = [
    *map(_labels, _FOREIGN),
    Kind(
        "labels.patches",
        lambda: [written("patches")],
        alone(_import_labels),
        4,
        change=_change_patches,
    ),
    Kind("labels.store", _store_files, alone(_read_database), 2, change=_change_database),
    Kind("taxonomy.toml", _TAXONOMY, alone(Taxonomy.load), 8, splices=lambda: _TABLES),
    Kind("taxonomy.json", _TAXONOMY_JSON, alone(_read_taxonomy), 4, change=_change_taxonomy),
    Kind("audit", _audits, lambda at: read_audit(at / "audits" / "a.json"), 6),
]
