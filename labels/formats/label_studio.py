"""Label Studio's JSON: one task a frame, boxes in percent, ours in the ``meta`` of each box.

One annotation a task and annotator, ``ground_truth`` where it was settled; model suggestions are
``predictions``. ``completed_by`` is not written: Label Studio refuses files that name people it
does not know. Images are named as Label Studio's local storage serves them, from the folder that
holds the mission's folder.

References
----------
https://labelstud.io/guide/task_format, https://labelstud.io/tags/rectanglelabels
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import SUFFIXES
from tokt.labels.record import HUMAN, MODEL, LabelRecord

from .box_attributes import checked_size, to_attributes
from .boxes import Box, Shape, Size
from .labels_and_boxes import PERCENT, FoundBox, FrameLabels
from .options import ReadOptions, Remarks, WriteOptions, label_of, mission_images
from .text_file import finite, listed, of_kind, save_json, utc_time, whole

TITLE = "Label Studio"

_KIND = "rectanglelabels"
_SIDES = ("x", "y", "width", "height")
_PIXELS = ("original_height", "original_width")
_RESULT_FIELDS = frozenset(
    {
        *("id", "type", "from_name", "to_name", *_PIXELS, "image_rotation"),
        *("value", "meta", "score", "origin"),
    }
)
_UNNAMED_MODEL = "label-studio"


def save(path: Path, frames: list[FrameLabels], options: WriteOptions, remarks: Remarks) -> int:
    """Write labels of one mission, both cameras in one file."""
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
                "data": {
                    "image": f"/data/local-files/?d={quote(os.fsencode(f'{folder}/{frame.name}'))}"
                },
                "annotations": [
                    {
                        "id": n,
                        "created_at": max(record.time for record, _ in mine),
                        "was_cancelled": False,
                        "ground_truth": mine[0][0].source != HUMAN,
                        "result": _result(mine, frame.size),
                    }
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
    return sum(len(frame.labels) for frame in frames)


Placed = Sequence[tuple[LabelRecord, Box]]


def _groups(frame: FrameLabels) -> list[Placed]:
    """The frame's labels by who said them and how."""

    def said_by(entry: tuple[LabelRecord, Box]) -> tuple[str, str, str]:
        record = entry[0]
        version = record.model_version if record.source == MODEL else None
        return record.annotator, record.source, version or ""

    return [list(mine) for _, mine in groupby(sorted(frame.labels, key=said_by), said_by)]


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


def boxes(content: Any, options: ReadOptions, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    """The boxes of an export in the format JSON.

    Predictions become suggestions. Cancelled annotations, turned boxes and anything but labelled
    boxes are left out.
    """
    tasks = content if isinstance(content, list) else [content]
    for where, task in listed(tasks, "tasks", "task"):
        with remarks.group(where):
            yield from _of_task(of_kind(task, dict, "it"), where, who, remarks)


def _of_task(task: dict[str, Any], where: str, who: str, remarks: Remarks) -> Iterator[FoundBox]:
    if "data" not in task:
        raise ToktError("no data; export from Label Studio in the format JSON")
    images = _images(of_kind(task["data"], dict, "data"))
    made_by_people = task.get("annotations", task.get("completions")) or []
    for at, entry in listed(made_by_people, "annotations", f"{where} annotation"):
        with remarks.group(at):
            annotation = of_kind(entry, dict, "it")
            if annotation.get("was_cancelled"):
                remarks["annotation", "left out: cancelled"] += 1
                continue
            said = _Said(
                images, where, _annotator(annotation) or who, time=_made(annotation, remarks)
            )
            yield from _results(annotation, at, said, remarks)
    for at, entry in listed(task.get("predictions") or [], "predictions", f"{where} prediction"):
        with remarks.group(at):
            prediction = of_kind(entry, dict, "it")
            version = prediction.get("model_version") or _UNNAMED_MODEL
            version = of_kind(version, str, "model_version")
            yield from _results(prediction, at, _Said(images, where, version, version), remarks)


def _made(annotation: dict[str, Any], remarks: Remarks) -> str | None:
    """The time of an annotation; None where it has none that can be read."""
    made = annotation.get("created_at") or ""
    try:
        is_number = type(made) in (int, float)
        return utc_time(made if is_number else of_kind(made, str, "created_at"))
    except ToktError as error:
        remarks["annotation", f"taken as of now: {error}"] += 1
        return None


@dataclass(frozen=True)
class _Said:
    """The image, the person and the time of all boxes of one annotation or prediction."""

    images: dict[str, str]  # the task's, by the field of its data
    task: str
    annotator: str
    model_version: str | None = None
    time: str | None = None


def _images(data: dict[str, Any]) -> dict[str, str]:
    """The task's images: texts that end like an image file, or else what is called image."""
    texts = {key: value for key, value in data.items() if isinstance(value, str)}
    like = {key: text for key, text in texts.items() if _ending(text) in SUFFIXES}
    return like or {"image": texts.get("image", "")}


def _ending(text: str) -> str:
    """The ending of a file's name, in small letters; of a URL without what follows ``?``."""
    return Path(text.partition("?")[0]).suffix.lower()


def _annotator(annotation: dict[str, Any]) -> str | None:
    """Who made it, as far as the file says."""
    who = annotation.get("completed_by")
    if isinstance(who, dict):
        who = who.get("email") or who.get("username") or who.get("id")
    if isinstance(who, str) and who.strip():
        return who.strip()
    return f"user {who}" if type(who) is int else None


def _results(
    holder: dict[str, Any], where: str, said: _Said, remarks: Remarks
) -> Iterator[FoundBox]:
    """The boxes of one annotation or prediction."""
    for place, entry in listed(holder.get("result"), "result", f"{where} result"):
        with remarks.entry(place):
            result = of_kind(entry, dict, "it")
            if result.get("type") != _KIND:
                kind = ascii(result.get("type"))[:40]
                remarks["result", f"left out: of type {kind}, not a labelled box"] += 1
                continue
            remarks.pass_over(result, _RESULT_FIELDS)
            image = said.images.get(str(result.get("to_name")))
            if len(said.images) == 1:
                (image,) = said.images.values()
            if image is None or result.get("item_index"):
                remarks["box", "left out: on one of several pictures of a task"] += 1
                continue
            value = of_kind(result.get("value"), dict, "value")
            names = of_kind(value.get(_KIND) or [], list, _KIND)
            if not names or finite(value.get("rotation") or 0, "rotation"):
                remarks["box", "left out: turned, or without class"] += 1
                continue
            if finite(result.get("image_rotation") or 0, "image_rotation") % 360:
                remarks["box", "left out: on a picture that was turned in Label Studio"] += 1
                continue
            if len(names) > 1:
                remarks["box", "with several classes: the first counts"] += 1
            sides = [result.get(side) for side in _PIXELS]
            size = None if None in sides else checked_size(*(whole(s, "size") for s in sides))
            x, y, width, height = (finite(value.get(side), side) for side in _SIDES)
            shape = Shape(Box(x, y, x + width, y + height))
            yield FoundBox(
                place,
                image,
                shape if size is None else shape.scaled(PERCENT, size),
                of_kind(names[0], str, _KIND),
                said.annotator,
                result.get("meta"),
                size,
                said.time,
                said.model_version,
                image_id=said.task,
                in_percent=size is None,
            )
