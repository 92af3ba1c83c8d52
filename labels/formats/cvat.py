"""CVAT's XML, "CVAT for images 1.1": boxes, with ours in the attributes of each box.

CVAT finds images by their name. It keeps attributes that the task's labels have and drops others.
Whatever is uploaded comes back as ``source="file"``: a model's suggestions would be labels then.
Read are boxes, polygons and points; those that CVAT found by itself become suggestions.

References
----------
https://docs.cvat.ai/docs/dataset_management/formats/format-cvat/
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from tokt.features.common.errors import ToktError, naming
from tokt.labels.taxonomy import Taxonomy

from .box_attributes import size_in, to_attributes
from .boxes import Box, Shape, found_shape
from .labels_and_boxes import FoundBox, FrameLabels
from .options import ReadOptions, Remarks, WriteOptions, label_of
from .text_file import finite, read_utf8, save_text

TITLE = "CVAT"

_AUTOMATIC = "auto"
_GRAY = "#808080"
_SIDES = ("xtl", "ytl", "xbr", "ybr")
_SHAPES = ("box", "polygon", "points")
_SHAPE_FIELDS = frozenset(
    {"label", "source", "occluded", *_SIDES, "rotation", "points", "z_order", "group_id"}
)
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file."""
    root = Element("annotations")
    SubElement(root, "version").text = "1.1"
    _add_task(root, frames, options.taxonomy)
    written = 0
    for frame in frames:
        if _NOT_XML.search(frame.name):
            what = "left out: XML cannot hold the name of their frame"
            remarks["label", what] += len(frame.labels)
            continue
        said = {"id": str(len(root) - 2), "name": frame.name}
        size = {"width": str(frame.size.width), "height": str(frame.size.height)}
        image = SubElement(root, "image", {**said, **size})
        for record, box in frame.labels:
            sides = {side: f"{value:.2f}" for side, value in zip(_SIDES, box, strict=True)}
            shape = {"label": label_of(record), "source": "manual", "occluded": "0"}
            element = SubElement(image, "box", {**shape, **sides, "z_order": "0"})
            for name, value in to_attributes(record).items():
                SubElement(element, "attribute", name=name).text = str(value)
            written += 1
    ElementTree.indent(root)
    text = ElementTree.tostring(root, "unicode")
    save_text(path, f'<?xml version="1.0"?>\n{text}\n')
    return written


def _add_task(root: Element, frames: list[FrameLabels], taxonomy: Taxonomy) -> None:
    """What CVAT says of a task: its labels, and the attributes that these have."""
    records = [record for frame in frames for record, _ in frame.labels]
    names = sorted({name for record in records for name in to_attributes(record)})
    colors = {known.name: known.color for known in taxonomy.classes}
    task = _add(SubElement(root, "meta"), "task", name=records[0].mission, size=str(len(frames)))
    labels = _add(task, "labels")
    for label in [*colors, *sorted({label_of(record) for record in records} - set(colors))]:
        entry = _add(labels, "label", name=label, color=colors.get(label, _GRAY), type="any")
        attributes = _add(entry, "attributes")
        for name in names:
            field = {"input_type": "text", "default_value": "", "values": ""}
            _add(attributes, "attribute", name=name, mutable="False", **field)


def _add(parent: Element, tag: str, **texts: str) -> Element:
    """A new element, with an element for each text."""
    element = SubElement(parent, tag)
    for name, text in texts.items():
        SubElement(element, name).text = text
    return element


class _NoDoctype(ElementTree.TreeBuilder):
    """Refuses what entities are declared in: they can fill any memory, or name other files."""

    def doctype(self, *_: Any) -> None:
        raise ToktError("it has a DOCTYPE, which CVAT does not write")


def read_xml(path: Path) -> Element:
    """The root element of a file; ToktError if it is not of CVAT."""
    text = read_utf8(path)
    with naming(path):
        try:
            root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_NoDoctype()))
        except ElementTree.ParseError as error:
            raise ToktError(f"not XML: {error}") from None
        if root.tag != "annotations":
            raise ToktError(f"not of {TITLE}, whose XML begins with <annotations>")
    return root


def boxes(root: Element, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The shapes of a file."""
    tracks = len(root.findall("track"))
    remarks["track", "left out: export in the format CVAT for images 1.1"] += tracks
    for n, image in enumerate(root.findall("image"), 1):
        name, number = image.get("name", ""), f"image {image.get('id', n)}"
        for m, element in enumerate(image, 1):
            said = {
                entry.get("name", ""): entry.text or "" for entry in element.findall("attribute")
            }
            model = f"{TITLE} automatic" if element.get("source") == _AUTOMATIC else None
            if element.tag in _SHAPES:
                remarks.pass_over(element.keys(), _SHAPE_FIELDS)
            with remarks.entry(where := f"image {n} shape {m}"):
                size = size_in(image, "its image")
                for shape in _shapes(element, remarks):
                    what = shape, element.get("label", ""), who, said, size
                    yield FoundBox(where, name, *what, model_version=model, image_id=number)


def _shapes(element: Element, remarks: Remarks) -> Iterator[Shape]:
    """The shapes that one element is: of points as many as it has."""
    tag, numbers = element.tag, []
    if tag == "box" and not finite(element.get("rotation", 0), "rotation"):
        yield Shape(Box(*(finite(element.get(side), side) for side in _SIDES)))
        return
    if tag in _SHAPES[1:]:
        numbers = [finite(text, "points") for text in re.split("[,;]", element.get("points", ""))]
    step = 2 if tag == "points" else len(numbers) or 1
    for n in range(0, len(numbers) or 1, step):
        shape = found_shape(tag.removesuffix("s"), numbers[n : n + step])
        if shape is None:
            what = "turned box" if tag == "box" else ascii(tag)[1:-1][:20]
            remarks["shape", f"left out: {what}, not a box, polygon or point"] += 1
        else:
            yield shape
