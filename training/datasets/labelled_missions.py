"""Missions as a user names them, opened, each with its labels."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.record import LabelRecord
from tokt.labels.store.known_missions import check_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import Taxonomy
from tokt.training.options import Notice

from .mission_list import named_missions
from .mission_source import LabelledMission, labels_of_mission, read_labels


def labelled_missions(
    missions: Sequence[Path],
    labels: Sequence[Path],
    workspace: Path,
    taxonomy: Taxonomy,
    grid: Grid,
    notice: Notice,
) -> list[LabelledMission]:
    """Open missions as they were named, each with its labels; `notice` is told what is odd.

    A mission's labels are those that a list of missions gives it, or else of `labels`, or else of
    the workspace's label store. The store knows missions by name: it is refused where it has labels
    of another dive of the same name.
    """
    named = [one for text in missions for one in named_missions(text)]
    opened = [open_mission(one.path, one.name) for one in named]
    shared: list[LabelRecord] = []
    if labels:
        shared = read_labels(labels, taxonomy, grid)
    elif not all(one.labels for one in named):
        with LabelStore(workspace / FILE_NAME, create=False) as store:
            shared = store.current_and_settled(grid=grid)
    found: dict[str, LabelledMission] = {}
    for one, mission in zip(named, opened, strict=True):
        if not labels and not one.labels:
            check_mission(workspace, mission)
        records = read_labels(one.labels, taxonomy, grid) if one.labels else shared
        if missing := set(one.cameras) - set(mission.cameras):
            raise ToktError(f"mission {mission.name!r} has no {missing.pop()} camera")
        if one.cameras:
            records = [record for record in records if record.camera in one.cameras]
        only = bool(one.labels or (labels and len(named) == 1))
        mine, remark = labels_of_mission(mission, records, grid, only)
        if remark:
            notice(f"note: {remark}")
        if one.name and one.name != mine[0].mission:
            mine = [replace(record, mission=one.name) for record in mine]
        both = LabelledMission(mission, mine, one.site, one.date)
        if both.name in found:
            raise ToktError(f"two missions are named {both.name!r}; NAME=DIR tells them apart")
        found[both.name] = both
    return list(found.values())
