"""iFDO: the metadata of a set of images, with annotations; ours are in the ``tokt`` of each.

What an iFDO file that lies with the mission says is written again, with the labels.

References
----------
https://marine-imaging.com/fair/schemas/annotation-v2.0.0.json
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from uuid import uuid4

from tokt.labels.record import LabelRecord

from .box_attributes import size_of, to_attributes
from .boxes import Box, Outline, found_shape
from .frame_metadata import HEADER, ITEMS, first_entry, ifdo_of, load_ifdo
from .labels_and_boxes import (
    FoundBox,
    FrameLabels,
    boxes_to_labels,
    labels_to_boxes,
    short_names,
    without_suggestions,
)
from .options import (
    ExportResult,
    ImportResult,
    ReadOptions,
    Remarks,
    WriteOptions,
    label_of,
    lines,
    mission_images,
)
from .text_file import finite, naming, of_kind, save_json, utc_time

TITLE = "iFDO"

_LABELS, _CREATORS = "image-annotation-labels", "image-annotation-creators"
_ANNOTATIONS = "image-annotations"
_KINDS = {"single-pixel": "point"}


def write_ifdo(path: Path, records: Iterable[LabelRecord], options: WriteOptions) -> ExportResult:
    """Write labels of one mission, both cameras in one file, as JSON.

    ToktError as `write_coco`, or where the iFDO file that lies with the mission cannot be read.
    """
    remarks: Remarks = Counter()
    # BIIGLE, which imports such files, passes over the confidence.
    chosen = without_suggestions(records, remarks, "for tools without confidence they")
    frames, lost = labels_to_boxes(chosen, options, TITLE)
    records = [record for frame in frames for record, _ in frame.labels]
    images = mission_images(options, TITLE)
    source = ifdo_of(images.mission.path)
    if source is None:
        name = f"{uuid4()}"
        header = {"image-set-name": images.name, "image-set-uuid": name}
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
    known = {images.find(name): name for name in items}
    short = short_names(frames)
    for frame in frames:
        item = first_entry(items.setdefault(known.get(frame.key, short[frame.key]), {}))
        others = of_kind(item.get(_ANNOTATIONS) or [], list, f"{source}: {_ANNOTATIONS}")
        kept = [other for other in others if not (isinstance(other, dict) and "tokt" in other)]
        ours = [_annotation(record, box, frame) for record, box in frame.labels]
        item[_ANNOTATIONS] = [*kept, *ours]
    save_json(path, document)
    return ExportResult(len(records), [*lost, *lines(remarks)])


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


def read_ifdo_labels(path: Path, options: ReadOptions) -> ImportResult:
    """Read a file, or refuse it with its first mistake.

    A label with a confidence below 1 becomes a suggestion of the model that is its annotator.
    ToktError where the file is no iFDO file, or `boxes_to_labels` refuses its shapes.
    """
    document = load_ifdo(path)
    remarks: Remarks = Counter()
    found: list[FoundBox] = []
    with naming(path):
        labels, creators = (_names(document[HEADER], field) for field in (_LABELS, _CREATORS))
        for name, item in document[ITEMS].items():
            what = f"{name!r:.100}: {_ANNOTATIONS}"
            said = of_kind(first_entry(item).get(_ANNOTATIONS) or [], list, what)
            for n, value in enumerate(said, 1):
                where = f"{name!r:.100} annotation {n}"
                annotation = of_kind(value, dict, where)
                shape = _shape(annotation, where, remarks)
                if shape is None:
                    continue
                attributes = annotation.get("tokt")
                for entry in of_kind(annotation.get("labels") or [], list, f"{where}: labels"):
                    label = of_kind(entry, dict, f"{where}: labels")
                    what = of_kind(label.get("label", label.get("id")), str, f"{where}: label")
                    who = of_kind(label.get("annotator") or "", str, f"{where}: annotator")
                    time = of_kind(label.get("created-at") or "", str, f"{where}: created-at")
                    sure = finite(label.get("confidence", 1), f"{where}: confidence") >= 1
                    who = creators.get(who, who) or options.who(path)
                    found.append(
                        FoundBox(
                            *(where, name, shape[0], labels.get(what, what), who),
                            attributes,
                            size_of(attributes),
                            time=utc_time(time) if time else None,
                            model_version=None if sure else who,
                            outline=shape[1],
                        )
                    )
        return boxes_to_labels(found, options, remarks)


def _names(header: dict[str, Any], field: str) -> dict[str, str]:
    """Names by id."""
    found = {}
    for value in of_kind(header.get(field) or [], list, field):
        entry = of_kind(value, dict, field)
        key = of_kind(entry.get("id"), str, f"{field}: id")
        found[key] = of_kind(entry.get("name", key), str, f"{field}: name")
    return found


def _shape(annotation: dict[str, Any], where: str, remarks: Remarks) -> tuple[Box, Outline] | None:
    listed = of_kind(annotation.get("coordinates") or [], list, f"{where}: coordinates")
    # A video's has a list a moment; some writers leave out the outer list of an image's.
    values = listed[0] if len(listed) == 1 else listed
    if not isinstance(values, list) or any(isinstance(value, list) for value in values):
        values = []
    numbers = [finite(value, f"{where}: coordinates") for value in values]
    kind = str(annotation.get("shape"))
    shape = found_shape(_KINDS.get(kind, kind), numbers)
    if shape is None:
        remarks["shape", f"left out: {ascii(kind)[:20]} with {len(numbers)} numbers"] += 1
    return shape
