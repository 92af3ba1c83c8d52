"""`tokt dataset`: build, list, show and diff dataset versions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.errors import ToktError

from .help import Commands
from .options import (
    DEFAULT_WORKSPACE,
    DatasetArgument,
    FramesOption,
    JsonOption,
    LabelFilesOption,
    MissionsOption,
    PatchesOption,
    TaxonomyOption,
    WorkspaceOption,
)
from .output import answer, print_json, progress, say
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.features.frames.grid import Grid
    from tokt.labels.record import LabelRecord
    from tokt.labels.taxonomy import Taxonomy
    from tokt.training.datasets.dataset import DatasetVersion
    from tokt.training.datasets.mission_source import LabelledMission

dataset_app = Commands("dataset", "Build, list, show and diff dataset versions.")


def labelled_missions(
    missions: list[Path], labels: list[Path] | None, workspace: Path, taxonomy: Taxonomy, grid: Grid
) -> list[LabelledMission]:
    """Open missions as they were named, each with its labels; what is odd of them is said.

    A mission's labels are those that a list of missions gives it, or else of `labels`, or else of
    the workspace's label store. The store knows missions by name: it is refused where it has labels
    of another dive of the same name.
    """
    from tokt.features.frames.mission import open_mission
    from tokt.labels.store.known_missions import check_mission
    from tokt.labels.store.store import FILE_NAME, LabelStore
    from tokt.training.datasets.mission_list import named_missions
    from tokt.training.datasets.mission_source import (
        LabelledMission,
        labels_of_mission,
        read_labels,
    )

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
            say(f"note: {remark}")
        if one.name and one.name != mine[0].mission:
            mine = [replace(record, mission=one.name) for record in mine]
        both = LabelledMission(mission, mine, one.site, one.date)
        if both.name in found:
            raise ToktError(f"two missions are named {both.name!r}; NAME=DIR tells them apart")
        found[both.name] = both
    return list(found.values())


@dataset_app.command("build")
def build(
    name: Annotated[str, Argument(help="Name of the dataset.")],
    mission: MissionsOption = None,
    labels: LabelFilesOption = None,
    patches: PatchesOption = None,
    task: Annotated[str, Option(help="Learn obstacle or clear, or every class.")] = "binary",
    frames: FramesOption = None,
    grid: Annotated[str | None, Option(help="Grid of the labels. Default: 10x10@360.")] = None,
    block: Annotated[
        int | None, Option(help="Frames in a block, which no fold splits. Default: 20.", min=1)
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Build a dataset version from labelled missions or patches."""
    from tokt.features.frames.grid import DEFAULT_GRID, Grid
    from tokt.features.frames.mission import parse_frames
    from tokt.labels.taxonomy import load_taxonomy
    from tokt.training.datasets.dataset import build_dataset, thin_classes
    from tokt.training.datasets.mission_source import plan_from_missions, plan_from_patch_folder
    from tokt.training.datasets.splits import BLOCK_FRAMES, FOLDS

    if bool(mission) == bool(patches):
        raise ToktError("give either --mission DIR or --patches DIR")
    classes = load_taxonomy(workspace, taxonomy)
    remarks: list[str] = []
    if patches:
        if labels or frames or grid or block:
            raise ToktError(
                "--patches has its labels in its folder names; --labels, --frames, --grid and "
                "--block go with --mission"
            )
        plan = plan_from_patch_folder(name, task, patches, classes)
    else:
        cells = Grid.parse(grid) if grid else DEFAULT_GRID
        wanted = parse_frames(frames) if frames else None
        missions = labelled_missions(mission or [], labels, workspace, classes, cells)
        plan, remarks = plan_from_missions(
            name, task, missions, classes, cells, wanted, block or BLOCK_FRAMES
        )
    for remark in remarks:
        say(f"note: {remark}")
    dataset = build_dataset(plan, workspace / "datasets", progress)
    if dataset.info["frames_that_are_copies"]:
        say(
            f"note: {dataset.info['frames_that_are_copies']} frames are copies of others; blocks "
            "that share a picture stay on one side of every split"
        )
    for line in thin_classes(dataset, FOLDS):
        say(f"WARNING: {line}")
    answer(json, {"label": dataset.label, **dataset.info}, lambda: _show(dataset))


@dataset_app.command("list")
def list_(workspace: WorkspaceOption = DEFAULT_WORKSPACE, json: JsonOption = False) -> None:
    """List every dataset version of the workspace."""
    from tokt.training.datasets.dataset import list_datasets

    found = list_datasets(workspace / "datasets")
    if json:
        print_json({"datasets": [{"label": item.label, **item.info} for item in found]})
        return
    for item in found:
        info = item.info
        grouped = "" if info["block_frames"] else ", UNGROUPED"
        counts = f"{info['patches']} patches in {info['frames']} frames{grouped}"
        print(f"{item.label}  {item.task}  {counts}")


@dataset_app.command("show")
def show(
    dataset: DatasetArgument,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Show the content of a dataset version."""
    from tokt.training.datasets.dataset import open_dataset

    found = open_dataset(dataset, workspace / "datasets")
    answer(json, {"label": found.label, **found.info}, lambda: _show(found))


@dataset_app.command("diff")
def diff(
    before: DatasetArgument,
    after: DatasetArgument,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Show what changed between two dataset versions."""
    from tokt.training.datasets.dataset import open_dataset
    from tokt.training.datasets.diff import diff_datasets

    root = workspace / "datasets"
    found = diff_datasets(open_dataset(before, root), open_dataset(after, root))
    answer(json, found, lambda: _print_diff(found))


def _print_diff(found: dict[str, Any]) -> None:
    print(f"{found['before']} -> {found['after']}")
    if found["same_content"]:
        print("  the same content: nothing that is learnt from changed")
    counts = {key: found[key] for key in ("patches", "frames", "unsure_left_out")}
    for name, (was, now) in {**counts, **found["settings"], **found["labels"]}.items():
        print(f"  {name.replace('_', ' ')}: {was if was == now else f'{was} -> {now}'}")
    for one in found["relabelled"] or ():
        print(f"  from {one['from']} to {one['to']}: {one['patches']} patches")
    for name, changes in found["missions"]["changes"].items():
        words = (f"{count} {key.replace('_', ' ')}" for key, count in changes.items())
        print(f"  mission {name}: {', '.join(words)}")
    for kind, lines in found["sources"].items():
        for line in lines:
            print(f"  source {kind}: {line}")


def _show(dataset: DatasetVersion) -> None:
    label, info = dataset.label, dataset.info
    counts = ", ".join(f"{name} {count}" for name, count in info["labels"].items())
    grouped = f"{info['groups']} groups" if info["block_frames"] else "UNGROUPED"
    print(f"{label}: {info['patches']} patches ({counts}) in {info['frames']} frames, {grouped}")
    print(f"  task {info['task']}, {info['unsure_left_out']} unsure patches left out")
    for source in info["sources"]:
        print(f"  from {source}")
    if dataset.sites:
        print(f"  sites: {', '.join(f'{name} {site}' for name, site in dataset.sites.items())}")
