"""One PNG a patch in one folder a class, as `tokt dataset build --patches` reads them.

The pixels are those of the resized frame, the ones that extractors look at: a dataset of such
patches has the features that ``border: patch`` gives on the frames. A manifest keeps what file
names cannot say, so a folder comes back as labels; a patch that somebody moved to the folder of
another class comes back as that class.
"""

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tokt.features.common.arrays import I64, U8
from tokt.features.common.atomic import publish_folder, scratch_folder
from tokt.features.common.errors import ToktError, naming, os_errors_as
from tokt.features.common.names import same_text
from tokt.features.frames.grid import Grid
from tokt.features.frames.image_file import SUFFIXES
from tokt.labels.record import LabelRecord

from .box_attributes import changed_by_hand, from_attributes, to_attributes
from .images import FrameKey
from .labels_and_boxes import class_names, one_label_a_patch, seen_frames
from .options import (
    ExportResult,
    ImportResult,
    ReadOptions,
    Remarks,
    WriteOptions,
    label_of,
    mission_images,
)
from .text_file import of_kind, read_json

TITLE = "folder of patches"

MANIFEST = "tokt_patches.json"
FORMAT = 1
"""Format of the manifest. Raise it when an older `tokt` would misread a newer one."""

_UNSAFE = re.compile(r"[^\w.-]+")


def write_patch_folder(
    path: Path, records: Iterable[LabelRecord], options: WriteOptions
) -> ExportResult:
    """Write labels of one mission and grid, whole or not at all, into a new or empty folder.

    Of a patch that was settled the settlement is written, and the opinions are not.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ToktError(f"{path} is there already; give the name of a new folder")
    images = mission_images(options, f"a {TITLE} needs the frames' pixels")
    remarks = Remarks()
    chosen = one_label_a_patch(records, remarks, f"a {TITLE}")
    grids = sorted({str(record.grid) for record in chosen})
    if len(grids) > 1:
        raise ToktError(f"labels on grids {', '.join(grids)}: choose one by --grid")
    frames = seen_frames(chosen, options, remarks, f"a {TITLE}", images.pixels)
    patches: dict[str, dict[str, str | int]] = {}
    with os_errors_as(f"cannot write {path}"), scratch_folder(path) as folder:
        for key, frame, mine in frames:
            _write_frame(folder, key, frame, mine, patches)
        if not patches:
            raise ToktError("; ".join(["no patch could be written", *remarks.lines()]))
        manifest = {"format": FORMAT, "patches": patches}
        text = json.dumps(manifest, ensure_ascii=False, indent=1) + "\n"
        (folder / MANIFEST).write_text(text, encoding="utf-8")
        if path.is_dir():
            path.rmdir()
        publish_folder(folder, path)
    return ExportResult(len(patches), remarks.lines())


def _write_frame(
    folder: Path,
    key: FrameKey,
    frame: U8,
    mine: list[LabelRecord],
    patches: dict[str, dict[str, str | int]],
) -> None:
    picture, boxes = _resized(frame, mine[0].grid)
    for record in mine:
        mission = _UNSAFE.sub("_", record.mission)
        name = f"{mission}_{key.camera}_{key.frame:06d}_r{record.row:02d}_c{record.col:02d}.png"
        y0, y1, x0, x1 = boxes[record.row * record.grid.cols + record.col]
        good, data = cv2.imencode(".png", picture[y0:y1, x0:x1])
        if not good:
            raise ToktError(f"{record.cell} cannot be stored as PNG")
        target = folder / label_of(record) / name
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(data.tobytes())
        patches[name] = to_attributes(record)


def _resized(frame: U8, grid: Grid) -> tuple[U8, I64]:
    """The frame at the grid's width, in colour where it has some, and the patches' boxes."""
    height, width = grid.resized(*frame.shape[:2])
    boxes = grid.boxes(height, width)
    if grid.width is not None:
        frame = np.asarray(cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA))
    return frame, boxes


def read_patch_folder(path: Path, options: ReadOptions) -> ImportResult:
    """Read a folder that `write_patch_folder` wrote, and what people made of it since.

    A patch in another folder than it was written to is a label by hand, of the annotator that is
    given or else of the one who labelled it before.
    """
    manifest = _manifest(path)
    remarks = Remarks()
    records = []
    with naming(path):
        found = _found(path, manifest, remarks)
        remarks["patch", "gone from the folder: what was said of them stays"] += len(
            manifest.keys() - found.keys()
        )
        classes = class_names(found.values(), options)
        for name, folder in found.items():
            record, label = manifest[name], classes[folder]
            if not label:
                remarks["patch", f"left out by --map: class {folder!r}"] += 1
                continue
            if folder != record.label:
                remarks["patch", "moved to another class: labels by hand"] += 1
                by = options.annotator, path.resolve().name
                record = changed_by_hand(record, label, *by)
            records.append(replace(record, label=label))
    if not records:
        raise ToktError(f"{path} has no patches of {MANIFEST} in it")
    return ImportResult(records, remarks.lines())


def _manifest(path: Path) -> dict[str, LabelRecord]:
    """The records as written, by file name."""
    file = path / MANIFEST
    if not file.is_file():
        raise ToktError(
            f"{path} has no {MANIFEST}: patches that tokt did not write belong to no frame"
            " (train on them by tokt dataset build NAME --patches DIR)"
        )
    value = read_json(file)
    with naming(file):
        manifest = of_kind(value, dict, "the manifest")
        if manifest.get("format") != FORMAT:
            raise ToktError(
                f"format {ascii(manifest.get('format'))[:40]}; this tokt reads {FORMAT}"
            )
        found = {}
        for name, entry in of_kind(manifest.get("patches"), dict, "patches").items():
            with naming(f"patch {name!r}"):
                record = from_attributes(of_kind(entry, dict, "its entry"))
            if record is None:
                raise ToktError(f"patch {name!r} is of no frame")
            found[name] = record
        return found


def _found(path: Path, manifest: dict[str, LabelRecord], remarks: Remarks) -> dict[str, str]:
    """The sub-folder of each patch of the manifest; remarks tell of other images."""
    found: dict[str, str] = {}
    classes = (entry for entry in path.iterdir() if entry.is_dir() and entry.name[0] != ".")
    for child in sorted(classes):
        for image in sorted(child.iterdir()):
            if image.name not in manifest:
                is_image = image.suffix.lower() in SUFFIXES
                remarks["image", f"left out: not in {MANIFEST}, so of no frame"] += is_image
            elif image.name in found:
                raise ToktError(f"{image.name} is in {found[image.name]} and in {child.name}")
            else:
                found[image.name] = same_text(child.name)
    return found
