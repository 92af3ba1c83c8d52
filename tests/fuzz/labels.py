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
from tokt.features.grid import Grid
from tokt.features.mission import open_mission
from tokt.labels.audit_file import Audit, AuditedPatch, read_audit, write_audit
from tokt.labels.formats.exchange import FORMATS, format_to_read
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.record import LabelRecord
from tokt.labels.store import LabelStore
from tokt.labels.taxonomy import Taxonomy

from .bytes_changes import changed_bytes
from .case import Files, Kind, line_fault, write_files
from .json_changes import changed_text

_TIME = "2016-04-20T10:00:00Z"
_KEPT = ExitStack()
atexit.register(_KEPT.close)
_AHEAD = ("csv", "viame", "coco", "labelstudio")


@cache
def _images() -> MissionImages:
    """A mission of two colour frames a camera, which stays as long as this process."""
    # In the system's own place for such folders: that of a case is watched.
    kept = _KEPT.enter_context(tempfile.TemporaryDirectory(prefix="tokt-fuzz-", dir="/tmp"))
    folder = Path(kept)
    for side in ("Left", "Right"):
        (folder / "dive" / side).mkdir(parents=True)
        for frame in (3, 7):
            pixels = np.random.default_rng(frame).integers(0, 255, (68, 90, 3), np.uint8)
            cv2.imwrite(str(folder / "dive" / side / f"dive_{side[0]}_{frame}.png"), pixels)
    return MissionImages(open_mission(folder / "dive"))


def _records() -> list[LabelRecord]:
    grid = Grid(3, 4, 60)
    said = [("reef", 0, 0, "ann", "human"), ("ocean", 1, 2, "bo", "human")]
    said += [
        ("unsure", 2, 3, "ann", "human"),
        ("sand", 1, 1, "m", "model"),
        ("reef", 1, 2, "c", "settled"),
    ]
    return [
        LabelRecord("dive", "left", 3, grid, row, col, label, who, _TIME, source)
        if source != "model"
        else LabelRecord("dive", "left", 7, grid, row, col, label, who, _TIME, source, "m/1")
        for label, row, col, who, source in said
    ]


@cache
def _written(name: str) -> dict[str, bytes]:
    """The records in a format, as tokt writes them."""
    with tempfile.TemporaryDirectory() as folder:
        suffix = {"csv": ".csv", "viame": ".csv", "patches": ""}.get(name, ".json")
        target = Path(folder) / f"labels{suffix}"
        FORMATS[name].write(target, _records(), WriteOptions(Taxonomy.load(), _images(), full=True))
        paths = [target] if target.is_file() else [p for p in target.rglob("*") if p.is_file()]
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@cache
def _foreign(name: str) -> bytes:
    """The same file as another tool would have written it: without attributes of ours."""
    ((_, data),) = _written(name).items()
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
        ((path, data),) = _written(name).items()
        seed = rng.choice((data, _foreign(name)))
        if path.endswith(".json") and rng.random() < 0.7:
            return {path: changed_text(json.loads(seed), rng)}
        others = [seed, *(_foreign(other) for other in _AHEAD)]
        return {path: changed_bytes(seed, rng, others)}

    return Kind(f"labels.{name}", "files", 10, make, _import)


def _patches(rng: Random) -> Files:
    """A folder of patches whose manifest, or whose folders, are not as they were."""
    files = dict(_written("patches"))
    manifest = next(path for path in files if path.endswith(".json"))
    if rng.random() < 0.8:
        value = json.loads(files[manifest])
        files[manifest] = changed_text(value, rng)
    else:
        files[manifest] = changed_bytes(files[manifest], rng, [b"{}"])
    if rng.random() < 0.3:
        moved = rng.choice([path for path in files if path != manifest])
        name = rng.choice(("labels/kelp/x.png", "labels/ocean/y.png", "labels/sand/sub/z.png"))
        files[name] = files.pop(moved)
    return files


def _import(files: Files, folder: Path) -> object:
    """What `tokt labels import` does, up to the store."""
    write_files(files, folder)
    names = {path.partition("/")[0] for path in files}
    path = folder / names.pop()
    options = ReadOptions(Taxonomy.load(), images=_images(), grid=Grid(3, 4, 60))
    read = FORMATS[format_to_read(path)].read(path, options)
    for line in read.lost:
        fault = line_fault(line)
        assert not fault, fault
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
        at = rng.choice((rng.randrange(100), rng.randrange(4096), rng.randrange(len(data))))
        data[at] = rng.choice((0, 0xFF, data[at] ^ (1 << rng.randrange(8)), rng.randrange(256)))
    end = len(data) if rng.random() < 0.8 else rng.randrange(len(data))
    return {"labels.db": bytes(data[:end])}


def _read_database(files: Files, folder: Path) -> object:
    write_files(files, folder)
    with LabelStore(folder / "labels.db", create=False) as store:
        found = [*store.current(), *store.settled(), *store.stats(), *store.missions()]
        store.add(_records())
        return found


# --- taxonomy, audit ---


def _taxonomy_toml(rng: Random) -> Files:
    text = (Path(__file__).parents[2] / "labels" / "taxonomy.toml").read_bytes()
    return {"taxonomy.toml": changed_bytes(text, rng, [text, b"[[classes]]\n", b"a.b.c = {}\n"])}


def _read_taxonomy(files: Files, folder: Path) -> object:
    write_files(files, folder)
    return Taxonomy.load(folder / "taxonomy.toml")


def _taxonomy_json(rng: Random) -> Files:
    return {"t.json": changed_text(Taxonomy.load().to_json(), rng)}


def _read_taxonomy_json(files: Files, folder: Path) -> object:
    """As a dataset version embeds it; what is no JSON never gets there."""
    try:
        value = json.loads(files["t.json"])
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
    value = json.loads(_audit_file())
    bad = rng.random() < 0.3
    text = changed_bytes(_audit_file(), rng, [b"{}"]) if bad else changed_text(value, rng)
    return {"audits/a.json": text}


def _read_audit(files: Files, folder: Path) -> object:
    write_files(files, folder)
    return read_audit(folder / "audits" / "a.json")


KINDS = [
    *(_labels(name) for name in _AHEAD),
    Kind("labels.patches", "files", 4, _patches, _import),
    Kind("labels.store", "files", 2, _database, _read_database),
    Kind("taxonomy.toml", "files", 8, _taxonomy_toml, _read_taxonomy),
    Kind("taxonomy.json", "files", 4, _taxonomy_json, _read_taxonomy_json),
    Kind("audit", "files", 6, _audit, _read_audit),
]
