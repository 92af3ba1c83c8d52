"""`tokt dataset`: build, list and show dataset versions."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from tokt.features.common.errors import ToktError

from .options import (
    DEFAULT_WORKSPACE,
    DatasetArgument,
    FramesOption,
    JsonOption,
    LabelFilesOption,
    TaxonomyOption,
    WorkspaceOption,
)
from .output import answer, print_json, progress, say
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.features.frames.grid import Grid
    from tokt.features.frames.mission import Mission
    from tokt.labels.record import LabelRecord
    from tokt.labels.taxonomy import Taxonomy
    from tokt.training.datasets.dataset import DatasetVersion

dataset_app = typer.Typer(
    help="Build, list and show dataset versions, immutable and named by content.",
    no_args_is_help=False,
)


def labels_for(
    labels: list[Path],
    workspace: Path,
    taxonomy: Taxonomy,
    grid: Grid,
    missions: Iterable[Mission] = (),
) -> list[LabelRecord]:
    """The records of the label files given, or else all of the workspace's label store.

    The store knows missions by name: it is refused where it has labels of another dive of the
    same name as one of `missions`.
    """
    from tokt.labels.store.known_missions import check_mission
    from tokt.labels.store.store import FILE_NAME, LabelStore
    from tokt.training.datasets.mission_source import read_labels

    if labels:
        return read_labels(labels, taxonomy, grid)
    with LabelStore(workspace / FILE_NAME, create=False) as store:
        for mission in missions:
            check_mission(workspace, mission)
        return store.current_and_settled(grid=grid)


@dataset_app.command("build")
def build(
    name: Annotated[str, Argument(help="Name of the dataset.")],
    mission: Annotated[
        list[Path] | None, Option("--mission", help="Mission folder or video; repeatable.")
    ] = None,
    labels: LabelFilesOption = None,
    patches: Annotated[
        Path | None,
        Option("--patches", help="Folder with one sub-folder of patch images per class."),
    ] = None,
    task: Annotated[str, Option(help="binary (obstacle or clear) or classes.")] = "binary",
    frames: FramesOption = None,
    grid: Annotated[str | None, Option(help="Grid of the labels. Default: 10x10@360.")] = None,
    block: Annotated[
        int | None,
        Option(help="Frames per group; no group is split between folds. Default: 20.", min=1),
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Build a dataset version from labelled missions, or from a folder of patches."""
    from tokt.features.frames.grid import DEFAULT_GRID, Grid
    from tokt.features.frames.mission import open_mission, parse_frames
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
        opened = map(open_mission, mission or [])
        records = labels_for(labels or [], workspace, classes, cells, opened)
        plan, remarks = plan_from_missions(
            name,
            task,
            mission or [],
            records,
            classes,
            cells,
            wanted,
            block or BLOCK_FRAMES,
            labels_are_for_it=bool(labels),
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


def _show(dataset: DatasetVersion) -> None:
    label, info = dataset.label, dataset.info
    counts = ", ".join(f"{name} {count}" for name, count in info["labels"].items())
    grouped = f"{info['groups']} groups" if info["block_frames"] else "UNGROUPED"
    print(f"{label}: {info['patches']} patches ({counts}) in {info['frames']} frames, {grouped}")
    print(f"  task {info['task']}, {info['unsure_left_out']} unsure patches left out")
    for source in info["sources"]:
        print(f"  from {source}")
