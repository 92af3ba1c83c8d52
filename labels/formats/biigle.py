"""BIIGLE's CSV report of image annotations: a row a label, here a rectangle a patch.

``points`` is a JSON list of alternating x and y in pixels (a circle's: x, y, radius);
``attributes`` are the image's, with its size. ``label_hierarchy`` is ``root > ... > label``.

References
----------
https://biigle.de/manual/tutorials/reports/reports-schema#annotation-csv-report
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tokt.labels.taxonomy import UNSURE

from .box_attributes import carried_text, size_in, text_to_carry
from .labels_and_boxes import FoundBox, FrameLabels, known_shape, short_names
from .options import ReadOptions, Remarks, WriteOptions, label_of
from .text_file import Rows, by_name, finite_list, save_table, utc_time

TITLE = "BIIGLE"

COLUMNS = (
    *("annotation_label_id", "label_id", "label_name", "label_hierarchy"),
    *("user_id", "firstname", "lastname", "image_id", "filename"),
    *("image_longitude", "image_latitude", "shape_id", "shape_name", "points"),
    *("attributes", "annotation_id", "created_at"),
)
_RECTANGLE = 5  # its shape_id
_NEEDED = ("label_name", "filename", "shape_name", "points")
_BETWEEN = " > "


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file."""
    names = short_names(frames)
    label_ids: dict[str, int] = {}
    users: dict[str, int] = {}
    rows: list[list[Any]] = []
    for image, frame in enumerate(frames, 1):
        size = json.dumps({"width": frame.size.width, "height": frame.size.height})
        for record, box in frame.labels:
            label, who, n = label_of(record), record.annotator, len(rows) + 1
            points = [round(side, 3) for side in box.corners]
            rows.append(
                [
                    *(n, label_ids.setdefault(label, len(label_ids) + 1), label, label),
                    *(users.setdefault(who, len(users) + 1), who, "", image, names[frame.key]),
                    *("", "", _RECTANGLE, "Rectangle", json.dumps(points), size, n),
                    record.time[:19].replace("T", " "),
                    text_to_carry(record, frame.size),
                ]
            )
    save_table(path, [(*COLUMNS, "tokt"), *rows])
    return len(rows)


def boxes(rows: Rows, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The shapes of a report.

    A class is mapped by its name or its hierarchy, or by that of a label above it.
    """
    for where, row in by_name(rows, _NEEDED, (*COLUMNS, "tokt"), remarks):
        with remarks.entry(where):
            numbers = finite_list(carried_text(row["points"]), "points")
            shape = known_shape(row["shape_name"], numbers, remarks)
            if shape:
                person = f"{row.get('firstname') or ''} {row.get('lastname') or ''}".strip()
                image = carried_text(row.get("attributes"))
                yield FoundBox(
                    *(where, row["filename"], shape, _class(row, options), person or who),
                    carried_text(row.get("tokt")),
                    size_in(image if isinstance(image, dict) else {}, "attributes"),
                    utc_time(row.get("created_at")),
                    image_id=f"image {image_id}" if (image_id := row.get("image_id")) else "",
                )


def _class(row: dict[str, str], options: ReadOptions) -> str:
    """What --map has, the nearest first; else the name where that is a class, else all of it."""
    name = row["label_name"]
    parts = (row.get("label_hierarchy") or name).split(_BETWEEN)
    above = [_BETWEEN.join(parts[:n]) for n in range(len(parts), 0, -1)]
    ours = (*options.taxonomy.names, UNSURE)
    known = (label for label in (above[0], name, *above[1:]) if label in options.classes)
    return next(known, name if name in ours else above[0])
