"""BIIGLE's CSV report of image annotations: a row a label, here a rectangle a patch.

``points`` is a JSON list of alternating x and y in pixels (a circle's: x, y, radius);
``attributes`` are the image's, with its size. ``label_hierarchy`` is ``root > ... > label``.

References
----------
https://biigle.de/manual/tutorials/reports/reports-schema#annotation-csv-report
"""

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import UNSURE

from .box_attributes import carried_text, size_in, text_to_carry
from .boxes import found_shape
from .labels_and_boxes import (
    FoundBox,
    boxes_to_labels,
    labels_to_boxes,
    short_names,
    without_suggestions,
)
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, label_of, lines
from .text_file import finite, naming, of_kind, read_table, save_table, utc_time

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


def write_biigle(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    """Write labels of one mission, both cameras in one file; ToktError as `write_coco`."""
    remarks: Remarks = Counter()
    chosen = without_suggestions(records, remarks, f"in {TITLE} they")
    frames, lost = labels_to_boxes(chosen, options, TITLE)
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
    return ExportResult(len(rows), [*lost, *lines(remarks)])


def read_biigle(path: Path, options: ReadOptions) -> ImportResult:
    """Read a report, or refuse it with its first mistake and that line's number.

    A class is mapped by its name or its hierarchy, or by that of a label above it.
    ToktError where the file is no such CSV, or `boxes_to_labels` refuses its shapes.
    """
    found: list[FoundBox] = []
    remarks: Remarks = Counter()
    for where, row in read_table(path, _NEEDED):
        with naming(f"{path} {where}"):
            if any(column not in row for column in _NEEDED):
                raise ToktError(f"{len(row)} fields, too few")
            kind = row["shape_name"]
            values = of_kind(carried_text(row["points"]), list, "points")
            shape = found_shape(kind.lower(), [finite(value, "points") for value in values])
            if shape is None:
                remarks["shape", f"left out: {kind[:20]!r} with {len(values)} numbers"] += 1
                continue
            who = f"{row.get('firstname') or ''} {row.get('lastname') or ''}".strip()
            time, image = row.get("created_at"), carried_text(row.get("attributes"))
            found.append(
                FoundBox(
                    where,
                    row["filename"],
                    shape[0],
                    _class(row, options),
                    who or options.who(path),
                    carried_text(row.get("tokt")),
                    size_in(image if isinstance(image, dict) else {}, "attributes"),
                    time=utc_time(time) if time else None,
                    outline=shape[1],
                )
            )
    with naming(path):
        return boxes_to_labels(found, options, remarks)


def _class(row: dict[str, str], options: ReadOptions) -> str:
    """What --map has, the nearest first; else the name where that is a class, else all of it."""
    name = row["label_name"]
    parts = (row.get("label_hierarchy") or name).split(_BETWEEN)
    above = [_BETWEEN.join(parts[:n]) for n in range(len(parts), 0, -1)]
    ours = (*options.taxonomy.names, UNSURE)
    known = (label for label in (above[0], name, *above[1:]) if label in options.classes)
    return next(known, name if name in ours else above[0])
