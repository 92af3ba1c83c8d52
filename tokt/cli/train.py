"""``tokt train`` and ``tokt evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .dataset import labels_for
from .options import DEFAULT_WORKSPACE, JsonOption, TaxonomyOption, WorkspaceOption
from .output import print_json, progress, say


def train(
    dataset: Annotated[str, typer.Argument(help="NAME or NAME@HASH.")],
    extractor: Annotated[
        str,
        typer.Option(help="lbp, haralick, or exact ones joined by + (lbp_24_8_frame+haralick)."),
    ],
    preset: Annotated[str, typer.Option(help="thesis, plain or best.")] = "best",
    name: Annotated[
        str | None, typer.Option(help="The model's name; default: DATASET-EXTRACTOR.")
    ] = None,
    folds: Annotated[int, typer.Option(help="Folds of the cross-validation.", min=2)] = 5,
    embargo: Annotated[
        int, typer.Option(help="Frames left out of training on each side of a test frame.", min=1)
    ] = 5,
    ocean: Annotated[
        Path | None, typer.Option(help="Ocean image of preset thesis; default: a clear frame.")
    ] = None,
    other: Annotated[
        Path | None, typer.Option(help="Other image of preset thesis; default: a rendered one.")
    ] = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Cross-validate, train, log and register one model version."""
    from ..features.errors import ToktError
    from ..models.registry import Registry, check_model_name
    from ..training.cross_validation import Split
    from ..training.dataset import open_dataset
    from ..training.presets import extractor_for, settings_named
    from ..training.tracking import log_and_register
    from ..training.train import TrainRequest
    from ..training.train import train as train_task

    settings = settings_named(preset)
    if (ocean or other) and not settings.two_images:
        raise ToktError("--ocean and --other go with --preset thesis")
    data = open_dataset(dataset, workspace / "datasets")
    chosen = extractor_for(extractor, preset)
    model_name = name or f"{data.name}-{extractor.replace('+', '_')}"
    check_model_name(model_name)
    request = TrainRequest(
        data, model_name, chosen, extractor, settings, Split(folds, embargo), ocean, other
    )
    registry = Registry(workspace, create=True)
    registry.experiment_id()  # a registry that cannot be reached is said before the work
    trained = train_task(request, workspace / "cache", progress)
    version = log_and_register(trained, registry)
    result: dict[str, Any] = {
        "model": {"name": version.name, "version": version.version, "aliases": version.aliases},
        "run_id": version.run_id,
        "dataset": data.label,
        "dataset_hash": data.hash,
        "extractor": chosen.spec,
        "preset": preset,
        "penalty": trained.penalty,
        "cv": trained.metrics,
    }
    if json:
        print_json(result)
        return
    _print_training(version.label, trained.metrics)


def _print_training(label: str, metrics: dict[str, Any]) -> None:
    patch, frames = metrics["patch"], metrics["frames"]
    print(f"{label} (alias challenger)")
    print(f"  {metrics['split']}")
    _print_patches(patch)
    if patch["f1"] is not None:
        print("  F1 by fold: " + ", ".join(figure(fold["f1"]) for fold in metrics["folds"]))
        print(
            f"  false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames"
        )
    if not metrics["converged"]:
        print("  the solver stopped at its iteration limit (unscaled features)")


def _print_patches(patch: dict[str, Any]) -> None:
    """Obstacle figures where they mean something, and those by class for several classes."""
    if patch["f1"] is not None:
        print(
            f"  obstacle patches: F1 {figure(patch['f1'])}, precision "
            f"{figure(patch['precision'])}, recall {figure(patch['recall'])}, "
            f"AP {figure(patch['average_precision'])}"
        )
    if patch["f1"] is None or len(patch["per_class"]) > 2:
        by_class = ", ".join(
            f"{name} {figure(row['f1'])}" for name, row in patch["per_class"].items()
        )
        print(f"  classes: macro-F1 {figure(patch['macro_f1'])} ({by_class})")


def figure(value: float | None) -> str:
    """A figure with three decimals, or ``-`` where it is undefined."""
    return "-" if value is None else f"{value:.3f}"


def evaluate(
    model: Annotated[str, typer.Argument(help="NAME, NAME@ALIAS, NAME/VERSION or a .tokt file.")],
    mission: Annotated[Path, typer.Option("--mission", help="Mission folder or video.")],
    labels: Annotated[
        list[Path] | None,
        typer.Option("--labels", help="Label file; repeatable. Default: the label store."),
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="Only these frame numbers, as 1-99,132-246.")
    ] = None,
    taxonomy: TaxonomyOption = None,
    workspace: WorkspaceOption = DEFAULT_WORKSPACE,
    json: JsonOption = False,
) -> None:
    """Score a model on a labelled mission: patches, frame statuses, first detection."""
    from ..features.mission import open_mission, parse_frames
    from ..labels.taxonomy import load_taxonomy
    from ..models.load import load_model
    from ..training.evaluate import evaluate as evaluate_task
    from ..training.mission_source import labels_of_mission

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
    _print_evaluation(bundle.label, result)


def _print_evaluation(label: str, result: dict[str, Any]) -> None:
    patch, frames = result["patch"], result["frames"]
    print(
        f"{label} on {result['mission']}: {patch['n']} patches, "
        f"{result['unsure_ignored']} unsure ones ignored"
    )
    _print_patches(patch)
    print(f"  false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames")
    print(f"  obstacle seen in {frames['detected']} of {frames['obstacle_frames']} obstacle frames")
    print(f"  first of three frames in a row with status 1: {frames['first_detection']}")
