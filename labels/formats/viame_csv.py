"""VIAME CSV, as VIAME and DIVE read and write it: one camera, one row a box.

Columns: box id, image file, frame's position from 0, left, top, right, bottom (px), confidence,
length (-1 for none), then pairs of class and confidence, then free columns, of which
``(atr) KEY VALUE`` is an attribute of the box. A row that begins with ``#`` is a comment.

DIVE makes numbers of attribute values that look like numbers and writes them so; such values are
put into quotation marks to come back as they were. A box with a confidence below 1 is a detector's:
it becomes a suggestion of the model version that is named as the annotator.

References
----------
https://viame.readthedocs.io/en/latest/sections/detection_file_conversions.html
"""

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.labels.record import MODEL, LabelRecord

from .box_attributes import carried_text, to_attributes
from .boxes import Box, Shape
from .labels_and_boxes import FoundBox, FrameLabels
from .options import ReadOptions, Remarks, WriteOptions, label_of, mission_images
from .text_file import Rows, finite, save_table, whole

TITLE = "VIAME CSV"

_HEADER = (
    *("# 1: Detection or Track-id", "2: Video or Image Identifier", "3: Unique Frame Identifier"),
    *("4-7: Img-bbox(TL_x", "TL_y", "BR_x", "BR_y)", "8: Detection or Length Confidence"),
    *("9: Target Length (0 or -1 if invalid)", "10-11+: Repeated Species"),
    "Confidence Pairs or Attributes",
)
_FIXED = 9  # columns before the classes
_SURE, _SUGGESTED = "1.0", "0.5"
_ATTRIBUTE = re.compile(r"\(atr\) (\S+)\s(.+)")
_RATE = re.compile(r"\s*fps:\s*(\d{1,6}(?:\.\d+)?)\s*$")  # of the header: frames a second
_CLOCK = re.compile(r"(\d{1,4}):(\d{2}):(\d{2}(?:\.\d+)?)")  # hours, minutes, seconds
_SHAPE = re.compile(r"\((poly|hole|kp|mask)\)")
_SHAPES = ("box", "with an outline or points: only the box is read")


def of_one_camera(
    records: Iterable[LabelRecord], remarks: Remarks, title: str
) -> list[LabelRecord]:
    """The labels; ToktError if they are of several cameras."""
    found = list(records)
    cameras = sorted({record.camera for record in found})
    if len(cameras) > 1:
        raise ToktError(
            f"labels of cameras {', '.join(cameras)}: {title} holds one; choose it by --camera"
        )
    return found


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission's one camera."""
    images = mission_images(options, TITLE)
    rows: list[list[Any]] = []
    for frame in frames:
        place = frame.name.rpartition("/")[2], images.position(frame.key)
        for record, box in frame.labels:
            sure = _SUGGESTED if record.source == MODEL else _SURE
            sides = [f"{side:.2f}" for side in box]
            said = to_attributes(record, frame.size).items()
            attributes = [f"(atr) {key} {_quoted(value)}" for key, value in said]
            rows.append([len(rows), *place, *sides, sure, -1, label_of(record), sure, *attributes])
    rate = images.frames_per_second
    metadata = ["# metadata", *([f"fps: {rate}"] if rate else []), 'exported_by: "tokt"']
    save_table(path, [_HEADER, metadata, *rows])
    return len(rows)


def boxes(rows: Rows, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The boxes of a file."""
    rate = None
    for where, row in rows:
        if row[0].startswith("#"):
            rate = next((float(said[1]) for said in map(_RATE.match, row) if said), rate)
            continue
        with remarks.entry(where):
            if len(row) < _FIXED:
                raise ToktError(f"{len(row)} fields where {TITLE} has at least {_FIXED}")
            box = Box(*(finite(value, "box corner") for value in row[3:7]))
            label, confidence = _class(row)
            found = (_ATTRIBUTE.fullmatch(cell.strip()) for cell in row[_FIXED:])
            position = whole(row[2].strip(), "frame")
            clock = _CLOCK.fullmatch(row[1].strip())
            yield FoundBox(
                *(where, row[1], Shape(box), label, who),
                {match[1]: _unquoted(match[2]) for match in found if match},
                model_version=who if confidence < 1 else None,
                position=position,
                time_s=_seconds(clock) if clock else None,
                in_whole_seconds=clock is not None and "." not in clock[3],
                rate=rate,
            )
            remarks.update({_SHAPES for cell in row if _SHAPE.match(cell)})


def _seconds(clock: re.Match[str]) -> float:
    return int(clock[1]) * 3600 + int(clock[2]) * 60 + float(clock[3])


def _class(row: list[str]) -> tuple[str, float]:
    """The class of the highest confidence, which may be none, and that confidence."""
    best = "", finite(row[7], "confidence") if row[7].strip() else 1.0
    found = []
    for name, value in zip(row[_FIXED::2], row[_FIXED + 1 :: 2], strict=False):
        if name.startswith("(") or not name:
            break
        found.append((name, finite(value, "confidence")))
    return max(found, key=lambda pair: pair[1], default=best)


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
    text = carried_text(value) if value.startswith('"') else None
    return text if isinstance(text, str) else value
