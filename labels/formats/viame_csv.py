"""VIAME CSV, as VIAME and DIVE read and write it: one camera, one row a box.

Columns: box id, image file, frame's position from 0, left, top, right, bottom (px), confidence,
length (-1 for none), then pairs of class and confidence, then free columns, of which
``(atr) KEY VALUE`` is an attribute of the box. A row that begins with ``#`` is a comment.

DIVE makes numbers of attribute values that look like numbers and writes them so; such values are
put into quotation marks to come back as they were.

References
----------
https://viame.readthedocs.io/en/latest/sections/detection_file_conversions.html
"""

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.record import MODEL, LabelRecord

from .box_attributes import size_of, to_attributes, whole
from .boxes import Box
from .labels_and_boxes import FoundBox, FrameLabels, boxes_to_labels, labels_to_boxes
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, label_of
from .text_file import csv_rows, finite, naming, read_utf8, save_table

TITLE = "VIAME CSV"

_HEADER = (
    "# 1: Detection or Track-id",
    "2: Video or Image Identifier",
    "3: Unique Frame Identifier",
    "4-7: Img-bbox(TL_x",
    "TL_y",
    "BR_x",
    "BR_y)",
    "8: Detection or Length Confidence",
    "9: Target Length (0 or -1 if invalid)",
    "10-11+: Repeated Species",
    "Confidence Pairs or Attributes",
)
_FIXED = 9  # columns before the classes
_SURE, _SUGGESTED = "1.0", "0.5"
_ATTRIBUTE = re.compile(r"\(atr\) (\S+)\s(.+)")
_SHAPE = re.compile(r"\((poly|hole|kp|mask)\)")
_SHAPES = ("box", "with an outline or points: only the box is read")


def write_viame_csv(
    path: Path, records: Iterable[LabelRecord], options: WriteOptions
) -> ExportResult:
    """Write labels of one mission's one camera.

    Raises
    ------
    ToktError
        If the labels are of several missions or cameras, the mission's frames are not given, or
        the file cannot be written.
    """
    chosen = list(records)
    cameras = sorted({record.camera for record in chosen})
    if len(cameras) > 1:
        raise ToktError(
            f"labels of cameras {', '.join(cameras)}: {TITLE} holds one; choose it by --camera"
        )
    frames, lost = labels_to_boxes(chosen, options, TITLE)
    rows: list[list[Any]] = []
    for frame in frames:
        position = options.images.position(frame.key) if options.images else 0
        rows += ([n, *row] for n, row in enumerate(_rows(frame, position), len(rows)))
    save_table(path, [_HEADER, ["# metadata", 'exported_by: "tokt"'], *rows])
    return ExportResult(len(rows), lost)


def _rows(frame: FrameLabels, position: int) -> Iterator[list[Any]]:
    name = frame.name.rpartition("/")[2]
    for record, box in frame.labels:
        confidence = _SUGGESTED if record.source == MODEL else _SURE
        attributes = to_attributes(record, frame.size)
        yield [
            *(name, position, *(f"{side:.2f}" for side in box), confidence, -1),
            *(label_of(record), confidence),
            *(f"(atr) {key} {_quoted(value)}" for key, value in attributes.items()),
        ]


def read_viame_csv(path: Path, options: ReadOptions) -> ImportResult:
    """Read a file, or refuse it with its first mistake and that line's number.

    A box with a confidence below 1 is a detector's: it becomes a suggestion of the model version
    that is named as the annotator.

    Raises
    ------
    ToktError
        If the file is no VIAME CSV, or `boxes_to_labels` refuses its boxes.
    """
    reader = csv_rows(read_utf8(path))
    boxes: list[FoundBox] = []
    remarks: Remarks = Counter()
    try:
        for row in reader:
            if row and not row[0].startswith("#"):
                boxes.append(_found(row, f"line {reader.line_num}", options.who(path)))
                remarks.update({_SHAPES for cell in row if _SHAPE.match(cell)})
    except (ToktError, csv.Error) as error:
        raise ToktError(f"{path} line {max(1, reader.line_num)}: {error}") from None
    with naming(path):
        return boxes_to_labels(boxes, options, remarks)


def _found(row: list[str], where: str, annotator: str) -> FoundBox:
    if len(row) < _FIXED:
        raise ToktError(f"{len(row)} fields where {TITLE} has at least {_FIXED}")
    box = Box(*(finite(value, "box corner") for value in row[3:7]))
    label, confidence = _class(row)
    attributes = _attributes(row)
    return FoundBox(
        where,
        row[1],
        box,
        label,
        annotator,
        attributes,
        size=size_of(attributes),
        position=whole(row[2].strip(), "frame"),
        model_version=annotator if confidence < 1 else None,
    )


def _class(row: list[str]) -> tuple[str, float]:
    """The class of the highest confidence, which may be none, and that confidence."""
    best = "", finite(row[7], "confidence") if row[7].strip() else 1.0
    first = True
    for name, value in zip(row[_FIXED::2], row[_FIXED + 1 :: 2], strict=False):
        if name.startswith("(") or not name:
            break
        confidence = finite(value, "confidence")
        if first or confidence > best[1]:
            best, first = (name, confidence), False
    return best


def _attributes(row: list[str]) -> dict[str, str]:
    found = (_ATTRIBUTE.fullmatch(cell.strip()) for cell in row[_FIXED:])
    return {match[1]: _unquoted(match[2]) for match in found if match}


def _quoted(value: str | int) -> str:
    if isinstance(value, int):
        return str(value)
    plain = value[0] != '"' and value not in ("true", "false") and not _looks_like_number(value)
    return value if plain else json.dumps(value, ensure_ascii=False)


def _looks_like_number(value: str) -> bool:
    try:
        float(value)
    except ValueError:
        return value[:2].lower() in ("0x", "0b", "0o")
    return True


def _unquoted(value: str) -> str:
    if value.startswith('"'):
        try:
            text = json.loads(value)
        except ValueError:
            return value
        return text if isinstance(text, str) else value
    return value
