"""Label Studio's JSON: one task a frame, boxes in percent, ours in the ``meta`` of each box.

One annotation a task and annotator, ``ground_truth`` where it was settled; model suggestions are
``predictions``. ``completed_by`` is not written: Label Studio refuses files that name people it
does not know. Images are named as Label Studio's local storage serves them, from the folder that
holds the mission's folder.

References
----------
https://labelstud.io/guide/task_format, https://labelstud.io/tags/rectanglelabels
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import SUFFIXES
from tokt.labels.record import HUMAN, MODEL, LabelRecord, utc_text

from .box_attributes import to_attributes, whole
from .boxes import Box, Size
from .labels_and_boxes import FoundBox, FrameLabels, boxes_to_labels, labels_to_boxes
from .options import (
    ExportResult,
    ImportResult,
    ReadOptions,
    Remarks,
    WriteOptions,
    label_of,
    mission_images,
)
from .text_file import finite, naming, of_kind, read_json, save_json

TITLE = "Label Studio"

_KIND = "rectanglelabels"
_UNNAMED_MODEL = "label-studio"


def write_label_studio(
    path: Path, records: Iterable[LabelRecord], options: WriteOptions
) -> ExportResult:
    """Write labels of one mission, both cameras in one file.

    Raises
    ------
    ToktError
        If the labels are of several missions, the mission's frames are not given, or the file
        cannot be written.
    """
    frames, lost = labels_to_boxes(records, options, TITLE)
    folder = mission_images(options, TITLE).mission.path.resolve().name
    tasks: list[dict[str, Any]] = []
    annotations = 0
    for number, frame in enumerate(frames, 1):
        said = _groups(frame)
        people = [mine for mine in said if mine[0][0].source != MODEL]
        models = [mine for mine in said if mine[0][0].source == MODEL]
        tasks.append(
            {
                "id": number,
                "data": {"image": f"/data/local-files/?d={quote(f'{folder}/{frame.name}')}"},
                "annotations": [
                    _annotation(n, mine, frame.size)
                    for n, mine in enumerate(people, annotations + 1)
                ],
                "predictions": [
                    {"model_version": mine[0][0].model_version, "result": _result(mine, frame.size)}
                    for mine in models
                ],
            }
        )
        annotations += len(people)
    save_json(path, tasks)
    return ExportResult(sum(len(frame.labels) for frame in frames), lost)


Placed = Sequence[tuple[LabelRecord, Box]]


def _groups(frame: FrameLabels) -> list[Placed]:
    """The frame's labels by who said them and how."""

    def said_by(entry: tuple[LabelRecord, Box]) -> tuple[str, str, str]:
        record = entry[0]
        version = record.model_version if record.source == MODEL else None
        return record.annotator, record.source, version or ""

    return [list(mine) for _, mine in groupby(sorted(frame.labels, key=said_by), said_by)]


def _annotation(number: int, mine: Placed, size: Size) -> dict[str, Any]:
    return {
        "id": number,
        "created_at": max(record.time for record, _ in mine),
        "was_cancelled": False,
        "ground_truth": mine[0][0].source != HUMAN,
        "result": _result(mine, size),
    }


def _result(mine: Placed, size: Size) -> list[dict[str, Any]]:
    return [
        {
            "id": f"patch-{record.row}-{record.col}-{n}",
            "type": _KIND,
            "from_name": "label",
            "to_name": "image",
            "original_width": size.width,
            "original_height": size.height,
            "image_rotation": 0,
            "value": {
                "x": 100 * box.x0 / size.width,
                "y": 100 * box.y0 / size.height,
                "width": 100 * (box.x1 - box.x0) / size.width,
                "height": 100 * (box.y1 - box.y0) / size.height,
                "rotation": 0,
                _KIND: [label_of(record)],
            },
            "meta": to_attributes(record),
        }
        for n, (record, box) in enumerate(mine)
    ]


@dataclass(frozen=True)
class _Said:
    """What holds for all boxes of one annotation or prediction."""

    image: str
    annotator: str
    time: str | None = None
    model_version: str | None = None


def read_label_studio(path: Path, options: ReadOptions) -> ImportResult:
    """Read an export in the format JSON, or refuse it with its first mistake.

    Predictions become suggestions. Cancelled annotations, turned boxes and anything but labelled
    boxes are left out.

    Raises
    ------
    ToktError
        If the file is no such export, or `boxes_to_labels` refuses its boxes.
    """
    value, who = read_json(path), options.who(path)
    tasks = value if isinstance(value, list) else [value]
    remarks: Remarks = Counter()
    with naming(path):
        boxes = [
            box for n, task in enumerate(tasks, 1) for box in _task(task, f"task {n}", who, remarks)
        ]
        return boxes_to_labels(boxes, options, remarks)


def _task(value: Any, where: str, annotator: str, remarks: Remarks) -> Iterator[FoundBox]:
    task = of_kind(value, dict, where)
    if "data" not in task:
        raise ToktError(f"{where} has no data; export from Label Studio in the format JSON")
    image = _image(of_kind(task["data"], dict, f"{where}: data"))
    said = task.get("annotations", task.get("completions")) or []
    for n, value in enumerate(of_kind(said, list, f"{where}: annotations"), 1):
        place = f"{where} annotation {n}"
        annotation = of_kind(value, dict, place)
        if annotation.get("was_cancelled"):
            remarks["annotation", "left out: cancelled"] += 1
            continue
        who = _Said(image, _annotator(annotation) or annotator, _time(annotation, place))
        yield from _results(annotation, place, who, remarks)
    guessed = task.get("predictions") or []
    for n, value in enumerate(of_kind(guessed, list, f"{where}: predictions"), 1):
        place = f"{where} prediction {n}"
        prediction = of_kind(value, dict, place)
        version = prediction.get("model_version") or _UNNAMED_MODEL
        version = of_kind(version, str, f"{place}: model_version")
        who = _Said(image, version, model_version=version)
        yield from _results(prediction, place, who, remarks)


def _image(data: dict[str, Any]) -> str:
    """The task's image: what is called so, else the first text that ends like an image file."""
    texts = {key: value for key, value in data.items() if isinstance(value, str)}
    like = (text for text in texts.values() if Path(text).suffix.lower() in SUFFIXES)
    return texts.get("image") or next(like, "")


def _annotator(annotation: dict[str, Any]) -> str | None:
    """Who made it, as far as the file says."""
    who = annotation.get("completed_by")
    if isinstance(who, dict):
        who = who.get("email") or who.get("username") or who.get("id")
    if isinstance(who, str) and who.strip():
        return who.strip()
    return f"user {who}" if type(who) is int else None


def _time(annotation: dict[str, Any], where: str) -> str | None:
    if annotation.get("created_at") is None:
        return None
    return utc_text(of_kind(annotation["created_at"], str, f"{where}: created_at"))


def _results(said: dict[str, Any], where: str, who: _Said, remarks: Remarks) -> Iterator[FoundBox]:
    for n, value in enumerate(of_kind(said.get("result"), list, f"{where}: result"), 1):
        place = f"{where} result {n}"
        result = of_kind(value, dict, place)
        if result.get("type") != _KIND:
            kind = ascii(result.get("type"))[:40]
            remarks["result", f"left out: of type {kind}, not a labelled box"] += 1
            continue
        box = _found(result, place, who, remarks)
        if box:
            yield box


def _found(result: dict[str, Any], where: str, who: _Said, remarks: Remarks) -> FoundBox | None:
    value = of_kind(result.get("value"), dict, f"{where}: value")
    names = of_kind(value.get(_KIND) or [], list, f"{where}: {_KIND}")
    if not names or finite(value.get("rotation") or 0, f"{where}: rotation"):
        remarks["box", "left out: turned, or without class"] += 1
        return None
    if len(names) > 1:
        remarks["box", "with several classes: the first counts"] += 1
    size = _size(result, where)
    x, y, width, height = (
        finite(value.get(side), f"{where}: {side}") for side in ("x", "y", "width", "height")
    )
    across, down = size.width / 100, size.height / 100
    return FoundBox(
        where,
        who.image,
        Box(x * across, y * down, (x + width) * across, (y + height) * down),
        of_kind(names[0], str, f"{where}: {_KIND}"),
        who.annotator,
        result.get("meta"),
        size=size,
        time=who.time,
        model_version=who.model_version,
    )


def _size(result: dict[str, Any], where: str) -> Size:
    """Pixels of the frame; Label Studio writes them with each box."""
    return Size(
        *(
            whole(result.get(name), f"{where}: {name}")
            for name in ("original_height", "original_width")
        )
    )
