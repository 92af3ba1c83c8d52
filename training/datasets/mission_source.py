"""Missions with their labels, and folders of ready-cut patches, as plans for a dataset."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tokt.features.common.errors import FrameError, ToktError, counted, os_errors_as
from tokt.features.common.names import same_text
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.image_file import OTHER_PICTURES, SUFFIXES
from tokt.features.frames.mission import LEFT, FolderMission, Mission, frame_size, open_mission
from tokt.features.frames.single_pictures import why_single_pictures
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.formats.options import Remarks
from tokt.labels.merge import merge_annotators
from tokt.labels.record import MODEL, LabelRecord, NoLabelsError
from tokt.labels.store.known_missions import check_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.training.options import Notice

from .dataset import BINARY, PATCH_KEY, DatasetPlan, DatasetVersion, FrameSource, read_stored_frame
from .dive_positions import dive_positions, scene_length
from .frame_rows import SUFFIX as ROWS
from .mission_list import named_missions
from .split import bearable_block, blocks_of

PATCH_GRID = Grid(1, 1, None)
"""Of ready-cut patches, which are frames of one patch at their own size."""
_COLUMNS = [*PATCH_KEY, "label"]


def read_labels(
    files: Sequence[Path], taxonomy: Taxonomy, grid: Grid, notice: Notice | None = None
) -> list[LabelRecord]:
    """Read people's labels from label files; model suggestions are no labels.

    `notice` is told of what is left out; without it, a row with a mistake refuses its file.
    """
    found: list[LabelRecord] = []
    for file in files:
        remarks = None if notice is None else Remarks()
        found += [
            record
            for record in read_label_csv(file, taxonomy, grid=grid, remarks=remarks)
            if record.source != MODEL and record.label is not None
        ]
        if notice is not None and remarks is not None:
            for line in remarks.lines():
                notice(f"{file}: {line}")
    return found


def labels_of_mission(
    mission: Mission, records: Iterable[LabelRecord], grid: Grid, only: bool
) -> tuple[list[LabelRecord], str | None]:
    """The labels that belong to a mission, and a remark where its name is not the labels'.

    Labels of other missions and grids are passed over. With `only` they were given for this one
    mission: then labels that name just one mission are taken for it even if its folder is called
    otherwise, with a remark. Never so for labels from a store, which may be of another dive.

    Raises NoLabelsError if there are none for it, ToktError if they speak of frames it does not
    have.
    """
    fitting = [record for record in records if record.grid == grid]
    names = sorted({record.mission for record in fitting})
    mine = [record for record in fitting if record.mission == mission.name]
    remark = None
    if not mine and only and len(names) == 1:
        mine = fitting
        remark = f"labels of mission {names[0]!r} are taken for the frames in {mission.path}"
    if not mine:
        there = f"labels are of {', '.join(names)}: if one is meant, give NAME=DIR"
        raise NoLabelsError(
            f"no labels for mission {mission.name!r} ({there if names else 'none at all'}): "
            "label some, or import a file (tokt labels import)"
        )
    mine = _by_file(mission, mine)
    for camera in sorted({record.camera for record in mine}):
        frames = set(mission.frames(camera))
        missing = sorted({r.frame for r in mine if r.camera == camera} - frames)
        if missing:
            raise ToktError(
                f"mission {mission.path} has no {camera} frame {missing[0]}, which is labelled "
                f"({len(missing)} such frames); the labels are of mission {mine[0].mission!r}"
            )
    return mine, remark


def _by_file(mission: Mission, records: Sequence[LabelRecord]) -> list[LabelRecord]:
    """Labels with the number that their frame's file has here: its whole name is what it is.

    Raises ToktError where the file is not in the mission.
    """
    if not isinstance(mission, FolderMission):
        return list(records)
    found = []
    for record in records:
        number = mission.number_of(record.file, record.camera) if record.file else record.frame
        if number is None:
            raise ToktError(
                f"mission {mission.path} has no {record.camera} picture {record.file!r}, which is "
                f"labelled as frame {record.frame}"
            )
        found.append(record if number == record.frame else replace(record, frame=number))
    return found


@dataclass(frozen=True)
class LabelledMission:
    """A mission with its labels."""

    mission: Mission
    records: list[LabelRecord]  # of this mission, any annotators, in one grid; one at the least
    site: str = ""  # where it was; empty where that was not said
    date: str = ""  # when

    @property
    def name(self) -> str:
        """What its labels call it."""
        return self.records[0].mission

    def patches_in_view(self, grid: Grid) -> int:
        """Number of patches of a left frame that are not masked."""
        return grid.n_patches - len(_masked_cells(self.mission, LEFT, grid))


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
        shared = read_labels(labels, taxonomy, grid, notice)
    elif not all(one.labels for one in named):
        with LabelStore(workspace / FILE_NAME, create=False) as store:
            shared = store.current_and_settled(grid=grid)
    found: dict[str, LabelledMission] = {}
    for one, mission in zip(named, opened, strict=True):
        if not labels and not one.labels:
            check_mission(workspace, mission)
        given = one.labels
        records = read_labels(given, taxonomy, grid, notice) if given else shared
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
        mine = in_view(mission, mine, grid, notice)
        both = LabelledMission(mission, mine, one.site, one.date)
        if both.name in found:
            raise ToktError(f"two missions are named {both.name!r}; NAME=DIR tells them apart")
        found[both.name] = both
    return list(found.values())


def in_view(
    mission: Mission, records: Sequence[LabelRecord], grid: Grid, notice: Notice
) -> list[LabelRecord]:
    """Leave out the labels of masked patches, and tell how many these were.

    Raises NoLabelsError if all are.
    """
    masked = {
        camera: _masked_cells(mission, camera, grid)
        for camera in {record.camera for record in records}
    }
    kept = [one for one in records if (one.row, one.col) not in masked[one.camera]]
    if left_out := len(records) - len(kept):
        notice(
            f"note: {counted(left_out, 'label')} of mission {mission.name!r} in masked patches "
            f"left out ({mission.masks.words()})"
        )
    if not kept:
        raise NoLabelsError(f"all labels of mission {mission.name!r} are in masked patches")
    return kept


def _masked_cells(mission: Mission, camera: str, grid: Grid) -> set[tuple[int, int]]:
    if mission.masks.of(camera) is None:
        return set()
    # A mask is a camera's, whose frames are alike.
    width, height = frame_size(mission, camera)
    masked = mission.masks.patches(camera, grid, height, width)
    return {(int(row), int(col)) for row, col in np.argwhere(masked)}


def plan_from_missions(
    name: str,
    task: str,
    missions: Sequence[LabelledMission],
    taxonomy: Taxonomy,
    grid: Grid = DEFAULT_GRID,
    frames: Sequence[int] | None = None,
    block_frames: int | None = None,
    find_single_pictures: bool = True,
) -> tuple[DatasetPlan, list[str]]:
    """Plan a dataset of labelled frames, or of some `frames` of theirs, `block_frames` to a block.

    Blocks that are left open are as long as the labels can bear (`bearable_block`). With
    `find_single_pictures` each frame of a mission that is no sequence is a block of its own. Where
    annotators disagree and nobody settled it, a patch is `unsure`. With the plan come remarks of
    what a person should know: missions that are no sequence, conflicts between annotators.
    """
    sources: list[FrameSource] = []
    rows: list[tuple[str, str, int, int, int, str | None, int]] = []
    remarks: list[str] = []
    positions: dict[str, dict[int, int]] = {}
    wanted = None if frames is None else set(frames)
    for one in missions:
        merged = merge_annotators(r for r in one.records if wanted is None or r.frame in wanted)
        if merged.conflicts:
            remarks.append(f"{len(merged.conflicts)} patches left out: annotators disagree")
        keys = sorted({(r.camera, r.frame) for r in merged.records if r.label != UNSURE})
        placed = dive_positions(one.mission)
        remarks += [placed.remark] if placed.remark else []
        positions[one.name] = placed.of_frame
        for camera, frame in keys:
            load = partial(one.mission.encoded, frame, camera)
            position, file = placed.of_frame[frame], _file_name(one, frame, camera)
            source = FrameSource(one.name, camera, frame, "", load, position=position, name=file)
            sources.append(source)
        rows += [
            (one.name, r.camera, r.frame, r.row, r.col, r.label, placed.of_frame[r.frame])
            for r in merged.records
        ]
        if isinstance(one.mission, FolderMission) and one.mission.passed_over:
            remarks.append(f"mission {one.name} has {one.mission.passed_over_words()}")
    table = pd.DataFrame(rows, columns=[*_COLUMNS, "position"])
    sure = table[table.label != UNSURE]
    sites = {one.name: one.site for one in missions if one.site}
    single = {}
    if find_single_pictures:
        single = {one.name: why_single_pictures(one.mission) for one in missions}
        single = {name: why for name, why in single.items() if why}
    for mission, why in single.items():
        remarks.append(
            f"mission {mission} is taken for single pictures, as {why}: each is a block of its "
            "own. If it is a sequence, give --block 20"
        )
    scenes = _scene_lengths([one for one in missions if one.name not in single], positions)
    if set(sure.mission) <= set(single):
        block_frames = 1
    if block_frames == 1 and not single:
        single = {one.name: "blocks of one frame were asked for" for one in missions}
    if block_frames is None:
        classes = sure.label.map(taxonomy.is_obstacle) if task == BINARY else sure.label
        scene = max(scenes.values(), default=0)
        block_frames = bearable_block(sure, pd.factorize(classes)[0], sites, single, scene)
    remarks += _short_blocks(scenes, block_frames)
    keys = pd.DataFrame([(s.mission, s.position) for s in sources], columns=["mission", "position"])
    groups = blocks_of(keys, block_frames, single)
    sources = [replace(one, group=group) for one, group in zip(sources, groups, strict=True)]
    plan = DatasetPlan(
        name,
        task,
        grid,
        taxonomy,
        sources,
        sure,
        len(table) - len(sure),
        block_frames,
        _describe_sources(missions),
        sites,
        {one.name: one.mission.masks for one in missions if one.mission.masks},
        single,
        scenes,
    )
    return plan, remarks


def _file_name(one: LabelledMission, frame: int, camera: str) -> str:
    """The file of a frame, below the mission's folder; empty of a video's."""
    if not isinstance(one.mission, FolderMission):
        return ""
    return one.mission.file(frame, camera).relative_to(one.mission.path).as_posix()


def _scene_lengths(
    missions: Iterable[LabelledMission], positions: Mapping[str, Mapping[int, int]]
) -> dict[str, int]:
    """Frames for which a scene stays the same, of missions where that can be measured."""
    lengths = {
        one.name: scene_length(one.mission, positions[one.name], {r.frame for r in one.records})
        for one in missions
    }
    return {name: length for name, length in lengths.items() if length is not None}


def _short_blocks(scenes: Mapping[str, int], block_frames: int) -> list[str]:
    """A remark for each mission whose scene stays the same for longer than a block."""
    return [
        f"the scene of mission {name} stays the same for about {length} frames, longer than a "
        f"block of {block_frames}. Near copies are learnt and tested on, and figures flatter: "
        "label frames farther apart"
        for name, length in scenes.items()
        if length > block_frames
    ]


def _describe_sources(missions: Sequence[LabelledMission]) -> list[str]:
    counts = Counter(record.annotator for one in missions for record in one.records)
    people = ", ".join(f"{who} ({count} records)" for who, count in sorted(counts.items()))
    about = [", ".join(filter(None, (one.mission.name, one.date))) for one in missions]
    return [f"mission {words}" for words in about] + [f"labels by {people}"]


def plan_with(base: DatasetVersion, added: DatasetPlan) -> DatasetPlan:
    """Plan what a dataset version holds and what a plan adds, under the version's name.

    The version's missions need not be on disk. The content, and so the hash, is what one build of
    all missions gives.

    Raises ToktError if both have a mission of one name, an added label is none of the version's
    classes, or the version was changed on disk.
    """
    base.check()
    both = set(base.frames.mission) & {source.mission for source in added.frames}
    if both:
        raise ToktError(f"dataset {base.label} has frames of mission {min(both)!r} already")
    for label in sorted(added.patches.label.unique()):
        base.taxonomy.check_label(label)
    stored = [
        FrameSource(
            *(row.mission, row.camera, row.frame, row.group, partial(_stored, base, row)),
            known=None if pictured else (row.digest, row.height, row.width),
            position=row.position,
            name=row.name,
        )
        for row, pictured in zip(base.frames.itertuples(index=False), base.pictured, strict=True)
    ]
    return DatasetPlan(
        base.name,
        base.task,
        base.grid,
        base.taxonomy,
        [*stored, *added.frames],
        pd.concat([base.patches[_COLUMNS], added.patches], ignore_index=True),
        base.info["unsure_left_out"] + added.unsure,
        None if base.block_frames is None else max(base.block_frames, added.block_frames or 1),
        [*base.info["sources"], *added.sources],
        {**base.sites, **added.sites},
        {**base.masks, **added.masks},
        {**base.info.get("single_pictures", {}), **added.single_pictures},
        {**base.info.get("scene_frames", {}), **added.scene_frames},
    )


def _stored(base: DatasetVersion, row: Any) -> tuple[bytes, str]:
    path = base.path / "frames" / row.file
    if not row.file.endswith(ROWS):
        read_stored_frame(path, row.digest)
    return _load(path)


def passed_over(folder: Path) -> list[str]:
    """Files below a folder of patches that are no patches of a class, a line for each kind."""
    kinds: Counter[str] = Counter()
    for path in folder.glob("**/*"):
        parts = path.relative_to(folder).parts
        if not path.is_file() or any(part.startswith(".") for part in parts):
            continue
        suffix = path.suffix.lower()
        if suffix in OTHER_PICTURES:
            kinds[f"{suffix}: a kind of picture that tokt does not read"] += 1
        elif suffix in SUFFIXES and len(parts) != 2:
            where = "beside the folders of classes" if len(parts) == 1 else "in folders of folders"
            kinds[where] += 1
    return [f"{counted(n, 'picture')} passed over, {kind}" for kind, n in kinds.items()]


def plan_from_patch_folder(name: str, task: str, folder: Path, taxonomy: Taxonomy) -> DatasetPlan:
    """Plan a dataset from a folder with one sub-folder of patch images a class.

    Each image is a frame of a 1x1 grid at its own size. File names do not say which photo a
    patch was cut from, so the dataset is marked ungrouped.

    Raises ToktError if the folder is missing, has no images, or a sub-folder is not a class.
    """
    mission, images = folder.resolve().name, patch_images(folder, taxonomy)
    rows = [(mission, "left", n, 0, 0, label_of(image)) for n, image in enumerate(images, 1)]
    table = pd.DataFrame(rows, columns=_COLUMNS)
    sure = table[table.label != UNSURE]
    sources = [
        FrameSource(
            *(mission, "left", n, f"{mission}#{n:07d}", partial(_load, images[n - 1])),
            position=n,
            name=images[n - 1].relative_to(folder).as_posix(),
        )
        for n in sure.frame
    ]
    return DatasetPlan(
        name,
        task,
        PATCH_GRID,
        taxonomy,
        sources,
        sure,
        len(table) - len(sure),
        None,
        [f"patches in {mission} (ungrouped)"],
    )


def patch_images(folder: Path, taxonomy: Taxonomy) -> list[Path]:
    """The images of a folder with one sub-folder a class; an image's label is its folder's name.

    Raises ToktError if the folder is missing, has no images, or a sub-folder is not a class.
    """
    if not folder.is_dir():
        raise ToktError(f"folder of patches {folder} does not exist")
    classes = [child for child in folder.iterdir() if child.is_dir() and child.name[0] != "."]
    images = sorted(
        path
        for child in classes
        for path in child.iterdir()
        if path.suffix.lower() in SUFFIXES and path.name[0] != "."
    )
    if not images:
        raise ToktError(f"folder of patches {folder} has no images (one sub-folder a class)")
    for label in sorted(set(map(label_of, images))):
        taxonomy.check_label(label)
    return images


def label_of(image: Path) -> str:
    """Return the label of an image in a folder of patches, which its folder's name is."""
    return same_text(image.parent.name)


def _load(path: Path) -> tuple[bytes, str]:
    with os_errors_as(str(path), FrameError):
        return path.read_bytes(), path.suffix.lower()
