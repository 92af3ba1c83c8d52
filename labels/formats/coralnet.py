"""CoralNet's CSV of point annotations: a row a point, here the middle of a patch.

Columns: Name, Row, Column (pixels of the image, from 0), Label code or Label ID; CoralNet passes
over any further one, such as ours. Exports may have Annotator and Date annotated. What CoralNet's
robot said becomes a suggestion, also where CoralNet accepted it by itself.

CoralNet-Toolbox writes further columns: what is not ``Verified`` is a suggestion, and of a polygon
there is only its middle, which is left out.

References
----------
https://coralnet.ucsd.edu/pages/help/, "Upload annotations, CSV" and "Export annotations, CSV"
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

from tokt.features.common.errors import ToktError
from tokt.labels.record import LabelRecord

from .box_attributes import carried_text, is_unverified, text_to_carry
from .boxes import Box, Shape, patch_at
from .labels_and_boxes import (
    FoundBox,
    FrameLabels,
    one_label_a_patch,
    short_names,
    without_suggestions,
)
from .options import ReadOptions, Remarks, WriteOptions, label_of
from .text_file import Rows, by_name, save_table, utc_time, whole

TITLE = "CoralNet"

COLUMNS = ("Name", "Row", "Column", "Label code")
_LABELS = ("label code", "label", "label id")  # the first that is there
_LONGEST = 10  # characters of a label code
_MACHINES = ("robot", "alleviate")
_POINTS = ("", "patch", "point")
"""Annotation types of CoralNet-Toolbox whose row and column are all that there is."""
_READ = frozenset(
    [
        *("name", "row", "column", *_LABELS, "annotator", "date annotated", "tokt"),
        *("verified", "annotation type"),
    ]
)
_NOBODY = ("", "imported", "(unknown user)")


def of_people_once(
    records: Iterable[LabelRecord], remarks: Remarks, title: str
) -> list[LabelRecord]:
    """One person's label a patch."""
    return one_label_a_patch(without_suggestions(records, remarks, title), remarks, title)


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file."""
    names = short_names(frames)
    rows: list[list[str | int]] = []
    for frame in frames:
        for record, box in frame.labels:
            x, y = int((box.x0 + box.x1) / 2), int((box.y0 + box.y1) / 2)
            if patch_at(record.grid, frame.size, x + 0.5, y + 0.5) != (record.row, record.col):
                remarks["label", "left out: its patch is too small for a pixel in its middle"] += 1
                continue
            label = label_of(record)
            if len(label) > _LONGEST:
                remarks["label", f"{label!r} is longer than {TITLE}'s label codes of 10 signs"] += 1
            rows.append([names[frame.key], y, x, label, text_to_carry(record, frame.size)])
    save_table(path, [(*COLUMNS, "tokt"), *rows])
    return len(rows)


def boxes(rows: Rows, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The points of a file."""
    for where, row in by_name(rows, ("name", "row", "column"), _READ, remarks):
        with remarks.entry(where):
            label = next((row[name] for name in _LABELS if name in row), None)
            if label is None:
                raise ToktError(f"{len(row)} fields, too few, or no column {COLUMNS[-1]!r}")
            if not label:
                remarks["point", "left out: without a label"] += 1
                continue
            kind = row.get("annotation type", "").strip().lower()
            if kind not in _POINTS:
                remarks["point", f"left out: only the middle of a {kind[:20]}"] += 1
                continue
            y, x = (whole(row[side].strip(), side) + 0.5 for side in ("row", "column"))
            said_by = row.get("annotator", "").strip()
            by = who if said_by.lower() in _NOBODY else said_by
            machine = said_by.lower().startswith(_MACHINES) or is_unverified(row)
            yield FoundBox(
                *(where, row["name"], Shape(Box(x, y, x, y), ((x, y),)), label),
                by,
                carried_text(row.get("tokt")),
                time=utc_time(row.get("date annotated")),
                model_version=by if machine else None,
            )
