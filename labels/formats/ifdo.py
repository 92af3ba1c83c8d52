"""iFDO: the metadata of a set of images, with annotations; ours are in the ``tokt`` of each.

What an iFDO file that lies with the mission says is written again, with the labels. A label with a
confidence below 1 becomes a suggestion of the model that is its annotator. No suggestion is
written: BIIGLE, which imports such files, passes over the confidence.

References
----------
https://marine-imaging.com/fair/schemas/annotation-v2.0.0.json
"""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from uuid import UUID

from tokt.labels.record import LabelRecord

from .box_attributes import to_attributes
from .boxes import Box, Shape
from .frame_metadata import HEADER, ITEMS, first_entry, ifdo_of, load_ifdo
from .labels_and_boxes import FoundBox, FrameLabels, known_shape, short_names
from .options import ReadOptions, Remarks, WriteOptions, label_of, mission_images
from .text_file import finite, finite_list, listed, objects, of_kind, save_json, utc_time

TITLE = "iFDO"

_LABELS, _CREATORS = "image-annotation-labels", "image-annotation-creators"
_ANNOTATIONS = "image-annotations"
_FIELDS = frozenset({"shape", "coordinates", "labels", "tokt"})


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file, as JSON."""
    records = [record for frame in frames for record, _ in frame.labels]
    images = mission_images(options, TITLE)
    source = ifdo_of(images.mission.path)
    if source is None:
        # The same mission, the same name: exports of the same labels are equal.
        mission = records[0].mission
        digest = hashlib.sha256(mission.encode()).digest()[:16]
        name = str(UUID(bytes=digest, version=4))
        header = {"image-set-name": mission, "image-set-uuid": name}
        header |= {"image-set-handle": f"urn:uuid:{name}", "image-set-ifdo-version": "v2.1.0"}
        document: dict[str, Any] = {HEADER: header, ITEMS: {}}
        remarks["header", "with no more than a name: no ifdo.json is in the mission's folder"] += 1
    else:
        document = load_ifdo(source)
    about = {known.name: known.description for known in options.taxonomy.classes}
    labels = {label_of(record): {"info": about.get(label_of(record), "")} for record in records}
    _add_names(document[HEADER], _LABELS, labels)
    _add_names(document[HEADER], _CREATORS, {record.annotator: {} for record in records})
    items = document[ITEMS]
    known = {images.find(name).key: name for name in items}
    short = short_names(frames)
    for frame in frames:
        item = first_entry(items.setdefault(known.get(frame.key, short[frame.key]), {}))
        others = of_kind(item.get(_ANNOTATIONS) or [], list, f"{source}: {_ANNOTATIONS}")
        kept = [other for other in others if not (isinstance(other, dict) and "tokt" in other)]
        ours = [_annotation(record, box, frame) for record, box in frame.labels]
        item[_ANNOTATIONS] = [*kept, *ours]
    save_json(path, document)
    return len(records)


def _add_names(header: dict[str, Any], field: str, names: dict[str, dict[str, str]]) -> None:
    there = _names(header, field)
    more = [{"id": name, "name": name, **names[name]} for name in sorted(set(names) - set(there))]
    header[field] = [*(header.get(field) or []), *more]


def _annotation(record: LabelRecord, box: Box, frame: FrameLabels) -> dict[str, Any]:
    label = {"label": label_of(record), "annotator": record.annotator, "created-at": record.time}
    return {
        "shape": "rectangle",
        "coordinates": [[round(side, 3) for side in box.corners]],
        "labels": [label],
        "tokt": to_attributes(record, frame.size),
    }


def boxes(
    document: dict[str, Any], options: ReadOptions, who: str, remarks: Remarks
) -> Iterator[FoundBox]:
    """The shapes of a file."""
    names, people = (_names(document[HEADER], field) for field in (_LABELS, _CREATORS))
    for image, item in document[ITEMS].items():
        place = f"{image!r:.100}"
        with remarks.group(place):
            said = first_entry(item).get(_ANNOTATIONS) or []
            for where, entry in listed(said, _ANNOTATIONS, f"{place} annotation"):
                with remarks.entry(where):
                    annotation = of_kind(entry, dict, "it")
                    remarks.pass_over(annotation, _FIELDS)
                    shape = _shape(annotation, remarks)
                    if shape is None:
                        continue
                    for _, label in objects(annotation.get("labels") or [], "labels", "label"):
                        what = _identifier(label.get("label", label.get("id")), "label")
                        by = _identifier(label.get("annotator") or "", "annotator")
                        by = people.get(by, by) or who
                        time = utc_time(of_kind(label.get("created-at") or "", str, "created-at"))
                        sure = finite(label.get("confidence", 1), "confidence") >= 1
                        found = names.get(what, what), by, annotation.get("tokt"), None, time
                        yield FoundBox(where, image, shape, *found, None if sure else by)


def _identifier(value: Any, what: str) -> str:
    """An identifier as text; BIIGLE's are numbers."""
    return str(value) if type(value) is int else of_kind(value, str, what)


def _names(header: dict[str, Any], field: str) -> dict[str, str]:
    """Names by id."""
    found = {}
    for _, entry in objects(header.get(field) or [], field, field):
        key = _identifier(entry.get("id"), f"{field}: id")
        found[key] = of_kind(entry.get("name", key), str, f"{field}: name")
    return found


def _shape(annotation: dict[str, Any], remarks: Remarks) -> Shape | None:
    listed = of_kind(annotation.get("coordinates") or [], list, "coordinates")
    # A video's has a list a moment; some writers leave out the outer list of an image's.
    values = listed[0] if len(listed) == 1 else listed
    if not isinstance(values, list) or any(isinstance(value, list) for value in values):
        values = []
    return known_shape(str(annotation.get("shape")), finite_list(values, "coordinates"), remarks)
