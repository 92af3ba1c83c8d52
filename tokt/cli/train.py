"""``tokt train``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .figures import figure, print_patches
from .options import DEFAULT_WORKSPACE, JsonOption, WorkspaceOption
from .output import print_json, progress


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
    print_patches(patch)
    if patch["f1"] is not None:
        print("  F1 by fold: " + ", ".join(figure(fold["f1"]) for fold in metrics["folds"]))
        print(
            f"  false status in {frames['false_status']} of {frames['ocean_frames']} ocean frames"
        )
    if not metrics["converged"]:
        print("  the solver stopped at its iteration limit (unscaled features)")
