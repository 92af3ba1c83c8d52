"""``tokt evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tokt.cli.options import DEFAULT_WORKSPACE, JsonOption, TaxonomyOption, WorkspaceOption
from tokt.cli.output import print_json, print_patches, progress, say

from .dataset import labels_for

if TYPE_CHECKING:
    from tokt.models.bundle.bundle import Bundle


def evaluate(
    model: Annotated[str, typer.Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")],
    mission: Annotated[Path, typer.Option("--mission", help="Mission folder or video.")],
    labels: Annotated[
        list[Path] | None,
        typer.Option("--labels", help="Label file; repeatable. Default: the label store."),
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="Use these frames only, such as 1-99,132-246.")
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Score a model on a labelled mission: patches, frame statuses, first detection."""
    from tokt.features.frames.mission import open_mission, parse_frames
    from tokt.labels.taxonomy import load_taxonomy
    from tokt.models.registry.load import load_model
    from tokt.training.datasets.mission_source import labels_of_mission
    from tokt.training.evaluation.evaluate import evaluate as evaluate_task

    classes = load_taxonomy(workspace, taxonomy)
    opened = open_mission(mission)
    wanted = parse_frames(frames) if frames else None
    bundle = load_model(model, workspace)
    records = labels_for(labels or [], workspace, classes, bundle.grid, [opened])
    mine, remark = labels_of_mission(opened, records, bundle.grid, only=bool(labels))
    if remark:
        say(f"note: {remark}")
    result = evaluate_task(bundle, opened, mine, classes, progress, wanted)
    if result["seen_in_training"]:
        say(
            f"WARNING: the model learnt from {result['seen_in_training']} of these frames: "
            "these are training figures, not a test"
        )
    elif result["mission_in_training"]:
        say(
            "note: the model learnt from other frames of this mission; another dive can go much "
            "worse than these figures"
        )
    if json:
        print_json(result)
        return
    _print_evaluation(bundle, result)


def _print_evaluation(bundle: Bundle, result: dict[str, Any]) -> None:
    patch, frames = result["patch"], result["frames"]
    print(
        f"{bundle.label} on {result['mission']}: {patch['n']} patches, "
        f"{result['unsure_ignored']} unsure ones ignored"
    )
    print_patches(patch)
    print(f"  status 1 with {bundle.operating_point.rule.words()}")
    print(f"  false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames")
    print(f"  obstacle seen in {frames['detected']} of {frames['obstacle_frames']} obstacle frames")
    print(f"  status unknown in {frames['unknown']} of {frames['n']} frames")
    print(f"  first of three frames in a row with status 1: {frames['first_detection']}")
