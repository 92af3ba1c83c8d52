"""CVAT's XML, "CVAT for images 1.1": boxes, with ours in the attributes of each box.

CVAT finds images by their name. It keeps attributes that the task's labels have and drops others.
Whatever is uploaded comes back as ``source="file"``: a model's suggestions would be labels then.

References
----------
https://docs.cvat.ai/docs/dataset_management/formats/format-cvat/
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from tokt.features.common.errors import ToktError
from tokt.labels.record import LabelRecord
from tokt.labels.taxonomy import Taxonomy

from .box_attributes import size_in, to_attributes
from .boxes import Box, Outline, Size, found_shape
from .labels_and_boxes import (
    FoundBox,
    FrameLabels,
    boxes_to_labels,
    labels_to_boxes,
    without_suggestions,
)
from .options import ExportResult, ImportResult, ReadOptions, Remarks, WriteOptions, label_of, lines
from .text_file import finite, naming, read_utf8, save_text

TITLE = "CVAT"

_AUTOMATIC = "auto"
_GRAY = "#808080"
_SIDES = ("xtl", "ytl", "xbr", "ybr")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_CORNER = re.compile(r"[,;]")


def write_cvat(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    """Write labels of one mission, both cameras in one file; ToktError as `write_coco`."""
    remarks: Remarks = Counter()
    chosen = without_suggestions(records, remarks, f"in {TITLE} they")
    frames, lost = labels_to_boxes(chosen, options, TITLE)
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
    return ExportResult(written, [*lost, *lines(remarks)])


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


def _root(text: str) -> Element:
    try:
        root = ElementTree.fromstring(text, ElementTree.XMLParser(target=_NoDoctype()))
    except ElementTree.ParseError as error:
        raise ToktError(f"not XML: {error}") from None
    if root.tag != "annotations":
        raise ToktError(f"not of {TITLE}, whose XML begins with <annotations>")
    return root


def read_cvat(path: Path, options: ReadOptions) -> ImportResult:
    """Read a file, or refuse it with its first mistake.

    Boxes, polygons and points count. Those that CVAT found by itself become suggestions.
    ToktError where the file is no such XML, or `boxes_to_labels` refuses its shapes.
    """
    text, who = read_utf8(path), options.who(path)
    remarks: Remarks = Counter()
    found: list[FoundBox] = []
    with naming(path):
        root = _root(text)
        tracks = root.findall("track")
        remarks["track", "left out: export in the format CVAT for images 1.1"] += len(tracks)
        for n, image in enumerate(root.findall("image"), 1):
            size = size_in(image, f"image {n}")
            for m, element in enumerate(image, 1):
                found += _found(element, image, size, f"image {n} shape {m}", who, remarks)
        return boxes_to_labels(found, options, remarks)


def _found(
    element: Element, image: Element, size: Size | None, where: str, who: str, remarks: Remarks
) -> Iterator[FoundBox]:
    attributes = {entry.get("name", ""): entry.text or "" for entry in element.findall("attribute")}
    automatic = element.get("source") == _AUTOMATIC
    for box, outline in _shapes(element, where, remarks):
        yield FoundBox(
            where,
            image.get("name", ""),
            box,
            element.get("label", ""),
            who,
            attributes,
            size,
            model_version=f"{TITLE} automatic" if automatic else None,
            outline=outline,
        )


def _shapes(element: Element, where: str, remarks: Remarks) -> Iterator[tuple[Box, Outline]]:
    """The shapes that one element is: of points as many as it has."""
    tag = element.tag
    if tag == "box" and not finite(element.get("rotation", 0), f"{where}: rotation"):
        yield Box(*(finite(element.get(side), f"{where}: {side}") for side in _SIDES)), ()
        return
    numbers = []
    if tag in ("polygon", "points"):
        texts = _CORNER.split(element.get("points", ""))
        numbers = [finite(text, f"{where}: points") for text in texts]
    step = 2 if tag == "points" else len(numbers) or 1
    for n in range(0, len(numbers) or 1, step):
        shape = found_shape(tag.removesuffix("s"), numbers[n : n + step])
        if shape is None:
            what = "turned box" if tag == "box" else ascii(tag)[1:-1][:20]
            remarks["shape", f"left out: {what}, not a box, polygon or point"] += 1
        else:
            yield shape
