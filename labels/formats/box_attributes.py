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

FORMAT = 1
"""Format of the attributes. Raise it when an older `tokt` would misread newer ones."""

_PREFIX = "tokt_"
_MARK = f"{_PREFIX}format"
_SIZE = f"{_PREFIX}size"
_SIZE_TEXT = re.compile(r"(\d{1,6})x(\d{1,6})")
_WHOLE = re.compile(r"(-?[0-9]{1,18})(?:\.0*)?")
_MAX_EXACT = 2**53
_LARGEST = 10**300  # what a float can hold, with room to calculate


def to_attributes(record: LabelRecord, size: Size | None = None) -> dict[str, str | int]:
    """All that a record says, and the frame's size where the format has no other place for it."""
    said = {**vars(record), "grid": str(record.grid), "label": label_of(record), "blind": "yes"}
    if record.source == HUMAN:
        del said["source"]
    if record.model_version is None:
        del said["model_version"]
    if not record.blind:
        del said["blind"]
    found = {_MARK: FORMAT, **{f"{_PREFIX}{name}": value for name, value in said.items()}}
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

    Parameters
    ----------
    attributes : mapping
        Anything else carries none.

    Raises
    ------
    ToktError
        If they are ours but not whole, or of a newer format.
    """
    if not isinstance(attributes, Mapping) or _MARK not in attributes:
        return None
    version = whole(attributes[_MARK], _MARK)
    if not 1 <= version <= FORMAT:
        raise ToktError(
            f"{_MARK} {version} is not one this tokt reads ({FORMAT}); a newer tokt wrote it"
        )
    source = _text(attributes, "source") if f"{_PREFIX}source" in attributes else HUMAN
    with_model = f"{_PREFIX}model_version" in attributes
    return LabelRecord(
        mission=_text(attributes, "mission"),
        camera=_text(attributes, "camera"),
        frame=_number(attributes, "frame"),
        grid=Grid.parse(_text(attributes, "grid")),
        row=_number(attributes, "row"),
        col=_number(attributes, "col"),
        label=_text(attributes, "label"),
        annotator=_text(attributes, "annotator"),
        time=utc_text(_text(attributes, "time")),
        source=source,
        model_version=_text(attributes, "model_version") if with_model else None,
        blind=attributes.get(f"{_PREFIX}blind") == "yes",
    )


def size_in(holder: Any, where: str) -> Size | None:
    """The size that an object of a file has as ``height`` and ``width``; None where it has none.

    Raises
    ------
    ToktError
        If these are no whole numbers.
    """
    if holder.get("width") is None or holder.get("height") is None:
        return None
    return Size(*(whole(holder.get(side), f"{where}: {side}") for side in ("height", "width")))


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


def whole(value: Any, what: str) -> int:
    """A whole number, also written ``3.0`` or as text.

    Raises
    ------
    ToktError
        If it is none.
    """
    if type(value) is int and abs(value) < _LARGEST:
        return value
    if type(value) is float and value.is_integer() and abs(value) < _MAX_EXACT:
        return int(value)
    match = _WHOLE.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ToktError(f"{what} {_short(value)} is not a whole number")
    return int(match[1])


def _number(attributes: Mapping[str, Any], name: str) -> int:
    return whole(_value(attributes, name), _PREFIX + name)


def _text(attributes: Mapping[str, Any], name: str) -> str:
    value = _value(attributes, name)
    if not isinstance(value, str):
        raise ToktError(f"{_PREFIX}{name} {_short(value)} is not text")
    return value


def _value(attributes: Mapping[str, Any], name: str) -> Any:
    if _PREFIX + name not in attributes:
        raise ToktError(f"no {_PREFIX}{name} beside {_MARK}")
    return attributes[_PREFIX + name]


def _short(value: Any) -> str:
    text = ascii(value)
    return text if len(text) <= 40 else text[:37] + "..."
