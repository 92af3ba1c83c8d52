"""`tokt dataset`: build, list, show and diff dataset versions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from tokt.features.common.terminal import print_json, say
from tokt.features.common.workspace import DEFAULT_WORKSPACE

from .help import Commands
from .options import (
    DatasetArgument,
    FramesOption,
    JsonOption,
    LabelFilesOption,
    MissionsOption,
    PatchesOption,
    TaxonomyOption,
    WorkspaceOption,
    fields_of,
)
from .output import answer, progress
from .output import print_line as print

if TYPE_CHECKING:
    from tokt.training.datasets.dataset import DatasetVersion

dataset_app = Commands("dataset", "Build, list, show and diff dataset versions.")


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
        int | None,
        Option(
            help="Frames in a block, which no fold splits; 1 for single photographs. Default: 20, "
            "or as many as the labels can bear.",
            min=1,
        ),
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Build a dataset version from labelled missions or patches."""
    given = fields_of(locals())
    from tokt.training.datasets.dataset_options import DatasetOptions, build_dataset

    dataset = build_dataset(DatasetOptions(**given), progress=progress, notice=say)
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
    grouped, block = "UNGROUPED", dataset.block_frames
    if block:
        grouped = "each held out alone"
    if block and block > 1:
        grouped = f"{info['groups']} blocks of up to {block} frames, each held out as a whole"
    print(f"{label}: {info['patches']} patches ({counts}) in {info['frames']} frames, {grouped}")
    print(f"  task {info['task']}, {info['unsure_left_out']} unsure patches left out")
    for source in info["sources"]:
        print(f"  from {source}")
    if not dataset.has_positions:
        print("  blocks count frame numbers: built by an older tokt")
    if scenes := info.get("scene_frames"):
        words = ", ".join(f"{length} ({name})" for name, length in scenes.items())
        print(f"  frames for which a scene stays the same: {words}")
    if dataset.sites:
        print(f"  sites: {', '.join(f'{name} {site}' for name, site in dataset.sites.items())}")
