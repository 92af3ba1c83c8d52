"""Kinds of changed label files, of every format, and of what stands beside them."""

from __future__ import annotations

import atexit
import csv
import io
import json
import tempfile
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np

from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, read_audit, write_audit
from tokt.labels.formats.formats import FORMATS, format_to_read
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.record import LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

from .case import Files, Kind, line_fault
from .changes import chance, changed_bytes, changed_text

_TIME = "2016-04-20T10:00:00Z"
_GRID = Grid(3, 4, 60)
_TAXONOMY = Path(__file__).parents[2] / "labels" / "taxonomy.toml"
_KEPT = ExitStack()
atexit.register(_KEPT.close)
FILES = ("csv", "viame", "coco", "labelstudio")
"""Formats of one file."""


def write_mission(folder: Path) -> Path:
    """A mission of two pairs of colour frames."""
    for number, side in enumerate(("Left", "Right") * 2):
        path = folder / "dive" / side / f"dive_{side[0]}_{3 if number < 2 else 7}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(number).integers(0, 255, (68, 90, 3), np.uint8)
        cv2.imwrite(str(path), pixels)
    return folder / "dive"


@cache
def _images() -> MissionImages:
    """Those of a mission that stays as long as this process."""
    # In the system's own place for such folders: that of a case is watched.
    kept = _KEPT.enter_context(tempfile.TemporaryDirectory(prefix="tokt-fuzz-", dir="/tmp"))
    return MissionImages(open_mission(write_mission(Path(kept))))


def _records() -> list[LabelRecord]:
    said = [(3, "reef", 0, 0, "ann", _TIME, "human"), (3, "ocean", 1, 2, "bo", _TIME, "human")]
    said += [(3, "unsure", 2, 3, "ann", _TIME, "human"), (3, "reef", 1, 2, "c", _TIME, "settled")]
    made = [
        LabelRecord("dive", "left", frame, _GRID, row, col, label, *by)
        for frame, label, row, col, *by in said
    ]
    by_model = ("sand", "m", _TIME, "model", "m/1")
    return [*made, LabelRecord("dive", "left", 7, _GRID, 1, 1, *by_model)]


@cache
def written(name: str) -> Files:
    """The records in a format, as tokt writes them."""
    with tempfile.TemporaryDirectory() as folder:
        suffix = {"csv": ".csv", "viame": ".csv", "patches": ""}.get(name, ".json")
        target = Path(folder) / f"labels{suffix}"
        FORMATS[name].write(target, _records(), WriteOptions(Taxonomy.load(), _images(), full=True))
        paths = [target] if target.is_file() else [p for p in target.rglob("*") if p.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@cache
def foreign(name: str) -> bytes:
    """The same file as another tool would have written it: without attributes of ours."""
    ((_, data),) = written(name).items()
    if name == "viame":
        rows = csv.reader(io.StringIO(data.decode()))
        text = io.StringIO()
        csv.writer(text).writerows([c for c in row if "(atr)" not in c] for row in rows)
        return text.getvalue().encode()
    if name == "csv":
        return b"mission,camera,frame,row,col,label\ndive,left,3,0,0,reef\ndive,left,3,0,1,ocean\n"
    return json.dumps(_without_ours(json.loads(data))).encode()


def _without_ours(value: Any) -> Any:
    if isinstance(value, dict):
        kept = {key: part for key, part in value.items() if key not in ("attributes", "meta")}
        return {key: _without_ours(part) for key, part in kept.items()}
    return [_without_ours(part) for part in value] if isinstance(value, list) else value


def _labels(name: str) -> Kind:
    def make(rng: Random) -> Files:
        ((path, data),) = written(name).items()
        seed = rng.choice((data, foreign(name)))
        if path.endswith(".json") and chance(rng, 70):
            return {path: changed_text(json.loads(seed), rng)}
        return {path: changed_bytes(seed, rng, [seed, *map(foreign, FILES)])}

    return Kind(f"labels.{name}", make, import_labels, 9)


def _patches(rng: Random) -> Files:
    """A folder of patches whose manifest, or whose folders, are not as they were."""
    files = dict(written("patches"))
    manifest = next(path for path in files if path.endswith(".json"))
    data = files[manifest]
    changed = changed_text(json.loads(data), rng)
    files[manifest] = changed_bytes(data, rng, [b"{}"]) if chance(rng, 20) else changed
    if chance(rng, 30):
        moved = rng.choice([path for path in files if path != manifest])
        name = rng.choice(("labels/kelp/x.png", "labels/ocean/y.png", "labels/sand/sub/z.png"))
        files[name] = files.pop(moved)
    return files


def import_labels(folder: Path) -> object:
    """What `tokt labels import` does, up to the store."""
    (path,) = folder.iterdir()
    options = ReadOptions(Taxonomy.load(), images=_images(), grid=_GRID)
    read = FORMATS[format_to_read(path)].read(path, options)
    for line in read.lost:
        assert not line_fault(line), line_fault(line)
    with LabelStore(folder / "labels.db") as store:
        return store.add_counted(read.records)


# --- the label store's own file ---


@cache
def _store_file() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        with LabelStore(Path(folder) / "labels.db") as store:
            store.add(_records())
        return (Path(folder) / "labels.db").read_bytes()


def _database(rng: Random) -> Files:
    data = bytearray(_store_file())
    for _ in range(rng.choice((1, 4, 40))):
        # Pages that are in use, the header and the schema among them.
        at = rng.randrange(rng.choice((100, 4096, len(data))))
        data[at] = rng.choice((0, 0xFF, data[at] ^ (1 << rng.randrange(8)), rng.randrange(256)))
    return {"labels.db": bytes(data[: rng.randrange(len(data))] if chance(rng, 20) else data)}


def _read_database(folder: Path) -> object:
    with LabelStore(folder / "labels.db", create=False) as store:
        found = [*store.current(), *store.settled(), *store.stats(), *store.missions()]
        store.add(_records())
        return found


# --- taxonomy, audit ---


def _taxonomy_toml(rng: Random) -> Files:
    text = _TAXONOMY.read_bytes()
    return {"taxonomy.toml": changed_bytes(text, rng, [text, b"[[classes]]\n", b"a.b.c = {}\n"])}


def _taxonomy_json(rng: Random) -> Files:
    return {"t.json": changed_text(Taxonomy.load().to_json(), rng)}


def _read_taxonomy_json(folder: Path) -> object:
    """As a dataset version embeds it; what is no JSON never gets there."""
    try:
        value = json.loads((folder / "t.json").read_bytes())
    except (ValueError, RecursionError):
        return None
    return Taxonomy.from_json(value)


@cache
def _audit_file() -> bytes:
    patch = AuditedPatch("dive", "left", 3, 1, 2, "ocean", "reef", -1.25, "in words")
    with tempfile.TemporaryDirectory() as folder:
        audit = Audit("a", "dataset a@1", Grid(), "rule", (patch, patch))
        return write_audit(Path(folder), audit).read_bytes()


def _audit(rng: Random) -> Files:
    text = changed_text(json.loads(_audit_file()), rng)
    bad = chance(rng, 30)
    return {"audits/a.json": changed_bytes(_audit_file(), rng, [b"{}"]) if bad else text}


KINDS = [
    *map(_labels, FILES),
    Kind("labels.patches", _patches, import_labels, 4),
    Kind("labels.store", _database, _read_database, 2),
    Kind("taxonomy.toml", _taxonomy_toml, lambda at: Taxonomy.load(at / "taxonomy.toml"), 8),
    Kind("taxonomy.json", _taxonomy_json, _read_taxonomy_json, 4),
    Kind("audit", _audit, lambda at: read_audit(at / "audits" / "a.json"), 6),
]
