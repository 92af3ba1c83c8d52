"""CoralNet's CSV of point annotations: a row a point, here the middle of a patch.

Columns: Name, Row, Column (pixels of the image, from 0), Label code or Label ID; CoralNet passes
over any further one, such as ours. Exports may have Annotator and Date annotated.

References
----------
https://coralnet.ucsd.edu/pages/help/, "Upload annotations, CSV" and "Export annotations, CSV"
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tokt.features.common.errors import ToktError
from tokt.labels.record import LabelRecord

from .box_attributes import carried_text, size_of, text_to_carry, whole
from .boxes import Box, patch_at
from .labels_and_boxes import (
    FoundBox,
    boxes_to_labels,
    labels_to_boxes,
    one_label_a_patch,
    short_names,
    without_suggestions,
)
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, label_of, lines
from .text_file import naming, read_table, save_table, utc_time

TITLE = "CoralNet"

COLUMNS = ("Name", "Row", "Column", "Label code")
_LABELS = ("label code", "label", "label id")  # the first that is there
_LONGEST = 10  # characters of a label code
_MACHINES = ("robot", "alleviate")
_NOBODY = ("", "imported", "(unknown user)")


def write_coralnet(
    path: Path, records: Iterable[LabelRecord], options: WriteOptions
) -> ExportResult:
    """Write labels of one mission, both cameras in one file.

    ToktError as `write_coco`, or where two people labelled one patch.
    """
    remarks: Remarks = Counter()
    people = without_suggestions(records, remarks, f"in {TITLE} they")
    chosen = one_label_a_patch(people, remarks, TITLE)
    frames, lost = labels_to_boxes(chosen, options, TITLE)
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
    return ExportResult(len(rows), [*lost, *lines(remarks)])


def read_coralnet(path: Path, options: ReadOptions) -> ImportResult:
    """Read a file, or refuse it with its first mistake and that line's number.

    What CoralNet's robot said becomes a suggestion, also where CoralNet accepted it by itself.
    ToktError where the file is no such CSV, or `boxes_to_labels` refuses its points.
    """
    points: list[FoundBox] = []
    remarks: Remarks = Counter()
    for where, row in read_table(path, ("name", "row", "column")):
        with naming(f"{path} {where}"):
            column = next((name for name in _LABELS if name in row), None)
            if column is None or "column" not in row:
                raise ToktError(f"{len(row)} fields, too few, or no column {COLUMNS[-1]!r}")
            if not row[column]:
                remarks["point", "left out: without a label"] += 1
                continue
            y, x = (whole(row[side].strip(), side) + 0.5 for side in ("row", "column"))
            who, time = row.get("annotator", "").strip(), row.get("date annotated")
            attributes = carried_text(row.get("tokt"))
            machine = who.lower().startswith(_MACHINES)
            points.append(
                FoundBox(
                    where,
                    row["name"],
                    Box(x, y, x, y),
                    row[column],
                    options.who(path) if who.lower() in _NOBODY else who,
                    attributes,
                    size_of(attributes),
                    time=utc_time(time) if time else None,
                    model_version=who if machine else None,
                    outline=((x, y),),
                )
            )
    with naming(path):
        return boxes_to_labels(points, options, remarks)
