"""Labels as boxes on their frames, for formats that hold boxes in pixels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from tokt.features.common.errors import FrameError, ToktError
from tokt.labels.record import SETTLED, LabelRecord

from .boxes import Box, Size, patch_box
from .images import FrameKey, MissionImages
from .options import Remarks, WriteOptions, lines, mission_images


@dataclass(frozen=True)
class FrameLabels:
    """One frame's labels and the boxes of their patches, in order of row, column, annotator."""

    key: FrameKey
    name: str
    size: Size
    labels: list[tuple[LabelRecord, Box]]


def labels_to_boxes(
    records: Iterable[LabelRecord], options: WriteOptions, what: str
) -> tuple[list[FrameLabels], list[str]]:
    """Labels by frame, and a line each for those that cannot be placed.

    Raises
    ------
    ToktError
        If there are no frames, labels of several missions, or none that can be placed.
    """
    images = mission_images(options, f"{what} needs file names and sizes of frames")
    groups = frames_of(records, what)
    frames: list[FrameLabels] = []
    remarks: Remarks = Counter()
    for key, mine in options.progress(groups, len(groups), "frames"):
        fault = _add(frames, images, key, mine)
        if fault:
            remarks["label", f"left out: {fault}"] += len(mine)
    if not frames:
        raise ToktError("; ".join(["no label could be written", *lines(remarks)]))
    return frames, lines(remarks)


def frames_of(
    records: Iterable[LabelRecord], what: str
) -> list[tuple[FrameKey, list[LabelRecord]]]:
    """Labels of one mission by frame, sorted."""
    chosen = sorted(
        records,
        key=lambda r: (
            *(r.camera, r.frame, str(r.grid), r.row, r.col),
            *(r.source == SETTLED, r.annotator, r.source),
        ),
    )
    missions = sorted({record.mission for record in chosen})
    if len(missions) > 1:
        raise ToktError(
            f"labels of missions {', '.join(missions)}: {what} is written for one; choose it by"
            " --mission NAME"
        )
    grouped = groupby(chosen, lambda record: FrameKey(record.camera, record.frame))
    return [(key, list(mine)) for key, mine in grouped]


def _add(
    frames: list[FrameLabels], images: MissionImages, key: FrameKey, mine: Sequence[LabelRecord]
) -> str | None:
    """Append the frame's labels, or say why not."""
    name = images.file_name(key)
    if name is None:
        return f"{images.mission.path} has no such frames"
    try:
        size = images.size(key)
    except FrameError:
        return "their frames cannot be read"
    boxes = [(record, patch_box(record.grid, size, record.row, record.col)) for record in mine]
    frames.append(FrameLabels(key, name, size, boxes))
    return None
