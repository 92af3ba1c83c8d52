"""A label record as attributes of a box, where a format has a place for attributes.

They are written so that files of our own come back without loss, also through a tool that turns
the text ``3`` into the number ``3.0``, and that what people changed there can be told from what
they left.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.record import HUMAN, MODEL, LabelRecord, utc_now, utc_text

from .boxes import Size
from .options import label_of
from .text_file import finite, whole

FORMAT = 1
"""Format of the attributes. Raise it when an older `tokt` would misread newer ones."""

_PREFIX = "tokt_"
_MARK = f"{_PREFIX}format"
_SIZE = f"{_PREFIX}size"
_SIZE_TEXT = re.compile(r"(\d{1,6})x(\d{1,6})")
_ROTATION, _VERIFIED = "rotation", "verified"
READ = frozenset({_ROTATION, _VERIFIED, _ROTATION.capitalize(), _VERIFIED.capitalize()})
"""Attributes of other tools that are looked at."""
_MAX_SIDE_PX = 10**6
_UNSAID = {
    "source": HUMAN,
    "model_version": None,
    "blind": False,
    "file": "",
}  # nothing is written of these


def to_attributes(record: LabelRecord, size: Size | None = None) -> dict[str, str | int]:
    """All that a record says, and the frame's size where the format has no other place for it."""
    said = {**vars(record), "grid": str(record.grid), "label": label_of(record)}
    found: dict[str, str | int] = {_MARK: FORMAT}
    for name, value in said.items():
        if name not in _UNSAID or value != _UNSAID[name]:
            found[_PREFIX + name] = "yes" if value is True else value
    return {**found, _SIZE: f"{size.width}x{size.height}"} if size else found


def text_to_carry(record: LabelRecord, size: Size) -> str:
    """The attributes as one text, which no spreadsheet takes for a number or a date."""
    return json.dumps(to_attributes(record, size), ensure_ascii=False)


def carried_text(text: str | None) -> Any:
    """The opposite of `text_to_carry`; None where the text is something else."""
    try:
        return json.loads(text or "null")
    except (ValueError, RecursionError):
        return None


def size_of(attributes: Any) -> Size | None:
    """The frame's size that attributes carry."""
    text = attributes.get(_SIZE) if isinstance(attributes, Mapping) else None
    match = _SIZE_TEXT.fullmatch(text) if isinstance(text, str) else None
    return Size(int(match[2]), int(match[1])) if match else None


def from_attributes(attributes: Any) -> LabelRecord | None:
    """The record that attributes carry, as it was written; None where they carry none.

    ToktError if they are ours but not whole, or of a newer format.
    """
    if not isinstance(attributes, Mapping) or _MARK not in attributes:
        return None
    version = whole(attributes[_MARK], _MARK)
    if not 1 <= version <= FORMAT:
        raise ToktError(
            f"{_MARK} {version} is not one this tokt reads ({FORMAT}); a newer tokt wrote it"
        )

    def value(name: str) -> Any:
        if _PREFIX + name not in attributes and name not in _UNSAID:
            raise ToktError(f"no {_PREFIX}{name} beside {_MARK}")
        return attributes.get(_PREFIX + name, _UNSAID.get(name))

    def text(name: str) -> str:
        found = value(name)
        if not isinstance(found, str):
            raise ToktError(f"{_PREFIX}{name} {ascii(found)[:40]} is not text")
        return found

    def number(name: str) -> int:
        return whole(value(name), _PREFIX + name)

    return LabelRecord(
        *(text("mission"), text("camera"), number("frame"), Grid.parse(text("grid"))),
        *(number("row"), number("col"), text("label"), text("annotator")),
        *(utc_text(text("time")), text("source")),
        model_version=None if value("model_version") is None else text("model_version"),
        blind=value("blind") == "yes",
        file=text("file"),
    )


def is_turned(attributes: Any) -> bool:
    """Tell whether attributes say that the box is turned, as those of CVAT and DIVE do.

    ToktError if the angle is no number.
    """
    return bool(finite(_said(attributes, _ROTATION) or 0, _ROTATION))


def is_unverified(attributes: Any) -> bool:
    """Tell whether attributes say that no person looked at what a model said."""
    return str(_said(attributes, _VERIFIED)).strip().lower() in ("false", "0", "no")


def _said(attributes: Any, name: str) -> Any:
    """An attribute by its name, in small letters or with a large first one."""
    if not isinstance(attributes, Mapping):
        return None
    return attributes.get(name, attributes.get(name.capitalize()))


def size_in(holder: Any, where: str) -> Size | None:
    """The size that an object of a file has as ``height`` and ``width``; None where it has none.

    ToktError if these are no whole numbers.
    """
    sides = {side: holder.get(side) for side in ("height", "width")}
    if None in sides.values():
        return None
    return checked_size(*(whole(value, f"{where}: {side}") for side, value in sides.items()))


def checked_size(height: int, width: int) -> Size:
    """A picture's size; ToktError of sides that no picture has."""
    if not (0 < height <= _MAX_SIDE_PX and 0 < width <= _MAX_SIDE_PX):
        raise ToktError("a size that no picture has")
    return Size(height, width)


def changed_by_hand(
    record: LabelRecord, label: str, annotator: str | None, instead: str
) -> LabelRecord:
    """What a person made of a record in another tool: said now, and no model's suggestion.

    By `annotator`, else by who said it before, or by `instead` where that was a model.
    """
    suggested = record.source == MODEL
    return replace(
        record,
        label=label,
        annotator=annotator or (instead if suggested else record.annotator),
        time=utc_now(),
        source=HUMAN if suggested else record.source,
        model_version=None,
        blind=False,
    )
