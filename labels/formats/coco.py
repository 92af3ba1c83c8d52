"""COCO detection JSON: boxes in pixels, with ours in the ``attributes`` of each annotation.

References
----------
https://cocodataset.org/#format-data
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy

from .box_attributes import size_in, to_attributes, whole
from .boxes import Box
from .labels_and_boxes import FoundBox, FrameLabels, boxes_to_labels, labels_to_boxes
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, label_of
from .text_file import finite, naming, of_kind, read_json, save_json

TITLE = "COCO"


def write_coco(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    """Write labels of one mission, both cameras in one file.

    Raises
    ------
    ToktError
        If the labels are of several missions, the mission's frames are not given, or the file
        cannot be written.
    """
    frames, lost = labels_to_boxes(records, options, TITLE)
    records = [record for frame in frames for record, _ in frame.labels]
    categories = _categories(options.taxonomy, {label_of(record) for record in records})
    ids = {category["name"]: category["id"] for category in categories}
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for image_id, frame in enumerate(frames, 1):
        images.append(
            {
                "id": image_id,
                "file_name": frame.name,
                "width": frame.size.width,
                "height": frame.size.height,
            }
        )
        annotations += _annotations(frame, image_id, len(annotations) + 1, ids)
    document = {
        "info": {
            "description": f"patches of mission {records[0].mission}",
            "version": "1.0",
            "contributor": "tokt",
            "date_created": max(record.time for record in records),
        },
        "licenses": [],
        "images": images,
        "categories": categories,
        "annotations": annotations,
    }
    save_json(path, document)
    return ExportResult(len(annotations), lost)


def _categories(taxonomy: Taxonomy, used: set[str]) -> list[dict[str, Any]]:
    """The taxonomy's classes in order, then what else is used; ids from 1."""
    kinds = {known.name: known.obstacle for known in taxonomy.classes}
    names = [*kinds, *sorted(used - set(kinds))]
    words = {True: "obstacle", False: "no obstacle", None: ""}
    return [
        {"id": n, "name": name, "supercategory": words[kinds.get(name)]}
        for n, name in enumerate(names, 1)
    ]


def _annotations(
    frame: FrameLabels, image_id: int, first_id: int, ids: dict[str, int]
) -> list[dict[str, Any]]:
    found = []
    for n, (record, box) in enumerate(frame.labels, first_id):
        left, top, width, height = box.x0, box.y0, box.x1 - box.x0, box.y1 - box.y0
        found.append(
            {
                "id": n,
                "image_id": image_id,
                "category_id": ids[label_of(record)],
                "bbox": [round(side, 3) for side in (left, top, width, height)],
                "area": round(width * height, 3),
                "iscrowd": 0,
                "segmentation": [],
                "attributes": to_attributes(record),
            }
        )
    return found


def read_coco(path: Path, options: ReadOptions) -> ImportResult:
    """Read a file, or refuse it with its first mistake.

    An annotation with a ``score`` below 1 is a detector's: it becomes a suggestion of the model
    version that is named as the annotator. Crowd regions are left out; of an outline its box is
    read.

    Raises
    ------
    ToktError
        If the file is no COCO detection file, or `boxes_to_labels` refuses its boxes.
    """
    content, who = read_json(path), options.who(path)
    remarks: Remarks = Counter()
    with naming(path):
        document = of_kind(content, dict, "the file")
        images = _by_id(document, "images")
        names = {
            key: of_kind(category.get("name"), str, f"category {key}: name")
            for key, category in _by_id(document, "categories").items()
        }
        annotations = of_kind(document.get("annotations"), list, "annotations")
        found = (
            _found(annotation, f"annotation {n}", images, names, who, remarks)
            for n, annotation in enumerate(annotations, 1)
        )
        return boxes_to_labels([box for box in found if box], options, remarks)


def _by_id(document: dict[str, Any], name: str) -> dict[int, dict[str, Any]]:
    found: dict[int, dict[str, Any]] = {}
    for n, value in enumerate(of_kind(document.get(name), list, name), 1):
        entry = of_kind(value, dict, f"{name} {n}")
        key = whole(entry.get("id"), f"{name} {n}: id")
        if key in found:
            raise ToktError(f"{name} {n}: id {key} is there twice")
        found[key] = entry
    return found


def _found(
    value: Any,
    where: str,
    images: dict[int, dict[str, Any]],
    names: dict[int, str],
    annotator: str,
    remarks: Remarks,
) -> FoundBox | None:
    annotation = of_kind(value, dict, where)
    if annotation.get("iscrowd"):
        remarks["annotation", "left out: of a crowd"] += 1
        return None
    if "bbox" not in annotation:
        remarks["annotation", "left out: without a box"] += 1
        return None
    image = images.get(whole(annotation.get("image_id"), f"{where}: image_id"))
    name = names.get(whole(annotation.get("category_id"), f"{where}: category_id"))
    if image is None or name is None:
        what = "image" if image is None else "category"
        raise ToktError(f"{where}: its {what}_id is that of no {what}")
    if annotation.get("segmentation"):
        remarks["annotation", "with an outline: only its box is read"] += 1
    score = finite(annotation.get("score", 1.0), f"{where}: score")
    return FoundBox(
        where,
        of_kind(image.get("file_name"), str, f"{where}: file_name of its image"),
        _box(annotation["bbox"], where),
        name,
        annotator,
        annotation.get("attributes"),
        size=size_in(image, f"{where}: image"),
        model_version=annotator if score < 1 else None,
    )


def _box(value: Any, where: str) -> Box:
    listed = of_kind(value, list, f"{where}: bbox")
    sides = [finite(side, f"{where}: bbox") for side in listed]
    if len(sides) != 4:
        raise ToktError(f"{where}: bbox has {len(sides)} numbers, not 4")
    left, top, width, height = sides
    return Box(left, top, left + width, top + height)
