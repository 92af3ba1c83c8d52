"""COCO detection JSON: boxes in pixels, with ours in the ``attributes`` of each annotation.

References
----------
https://cocodataset.org/#format-data
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.taxonomy import Taxonomy

from .box_attributes import READ, size_in, to_attributes
from .boxes import Box, Shape
from .labels_and_boxes import FoundBox, FrameLabels
from .options import ReadOptions, Remarks, WriteOptions, label_of
from .text_file import finite, finite_list, listed, of_kind, save_json, whole

TITLE = "COCO"

_IMAGE_FIELDS = ("id", "file_name", "width", "height", "license", "coco_url", "flickr_url")
_OF_DIVE = "dive_detection_attributes"
_ANNOTATION_FIELDS = frozenset(
    [
        *("id", "image_id", "category_id", "bbox", "area", "iscrowd", "segmentation", "score"),
        *("attributes", _OF_DIVE, *READ),
    ]
)


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file."""
    records = [record for frame in frames for record, _ in frame.labels]
    categories = _categories(options.taxonomy, {label_of(record) for record in records})
    ids = {category["name"]: category["id"] for category in categories}
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for image_id, frame in enumerate(frames, 1):
        size = {"width": frame.size.width, "height": frame.size.height}
        images.append({"id": image_id, "file_name": frame.name, **size})
        for record, box in frame.labels:
            width, height = box.x1 - box.x0, box.y1 - box.y0
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": ids[label_of(record)],
                    "bbox": [round(side, 3) for side in (box.x0, box.y0, width, height)],
                    "area": round(width * height, 3),
                    "iscrowd": 0,
                    "segmentation": [],
                    "attributes": to_attributes(record),
                }
            )
    info = {
        "description": f"patches of mission {records[0].mission}",
        "version": "1.0",
        "contributor": "tokt",
        "date_created": max(record.time for record in records),
    }
    found = {"images": images, "categories": categories, "annotations": annotations}
    save_json(path, {"info": info, "licenses": [], **found})
    return len(annotations)


def _categories(taxonomy: Taxonomy, used: set[str]) -> list[dict[str, Any]]:
    """The taxonomy's classes in order, then what else is used; ids from 1."""
    kinds = {known.name: known.obstacle for known in taxonomy.classes}
    names = [*kinds, *sorted(used - set(kinds))]
    words = {True: "obstacle", False: "no obstacle", None: ""}
    return [
        {"id": n, "name": name, "supercategory": words[kinds.get(name)]}
        for n, name in enumerate(names, 1)
    ]


def boxes(content: Any, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The boxes of a file.

    An annotation with a ``score`` below 1 is a detector's: it becomes a suggestion of the model
    version that is named as the annotator. Crowd regions are left out; of an outline its box is
    read.
    """
    document = of_kind(content, dict, "the file")
    images = _by_id(document, "images", remarks)
    for fields in images.values():
        remarks.pass_over(fields, _IMAGE_FIELDS)
    categories = _by_id(document, "categories", remarks)
    for where, entry in listed(document.get("annotations"), "annotations", "annotation"):
        with remarks.entry(where):
            annotation = of_kind(entry, dict, "it")
            remarks.pass_over(annotation, _ANNOTATION_FIELDS)
            if annotation.get("iscrowd"):
                remarks["annotation", "left out: of a crowd"] += 1
                continue
            if "bbox" not in annotation:
                remarks["annotation", "left out: without a box"] += 1
                continue
            image_id = whole(annotation.get("image_id"), "image_id")
            image = images.get(image_id)
            category = categories.get(whole(annotation.get("category_id"), "category_id"))
            if image is None or category is None:
                what = "image" if image is None else "category"
                raise ToktError(f"its {what}_id is that of no {what}")
            name = of_kind(category.get("name"), str, "name of its category")
            score = annotation.get("score")
            if annotation.get("segmentation"):
                remarks["annotation", "with an outline: only its box is read"] += 1
            yield FoundBox(
                where,
                of_kind(image.get("file_name"), str, "file_name of its image"),
                _shape(annotation["bbox"]),
                name,
                who,
                _attributes(annotation),
                size_in(image, "image"),
                model_version=None if score is None or finite(score, "score") >= 1 else who,
                image_id=f"image {image_id}",
            )


def _by_id(document: dict[str, Any], name: str, remarks: Remarks) -> dict[int, dict[str, Any]]:
    """Images or categories by number, without those that have none, or one that is there twice."""
    found: dict[int, dict[str, Any]] = {}
    twice = set()
    for where, value in listed(document.get(name), name, name):
        try:
            entry = of_kind(value, dict, "it")
            key = whole(entry.get("id"), "id")
            if key in found:
                twice.add(key)
                raise ToktError(f"id {key} is there twice: neither counts")
            found[key] = entry
        except ToktError as error:
            remarks["definition", f"left out: {where}: {error}"] += 1
    return {key: entry for key, entry in found.items() if key not in twice}


def _attributes(annotation: dict[str, Any]) -> dict[str, Any]:
    """Return the attributes of a box, from the places that CVAT and DIVE have for them."""
    found = {name: annotation[name] for name in READ if name in annotation}
    for place in (annotation.get(_OF_DIVE), annotation.get("attributes")):
        found |= place if isinstance(place, dict) else {}
    return found


def _shape(value: Any) -> Shape:
    sides = finite_list(value, "bbox")
    if len(sides) != 4:
        raise ToktError(f"bbox has {len(sides)} numbers, not 4")
    left, top, width, height = sides
    return Shape(Box(left, top, left + width, top + height))
