"""The MLflow run of a comparison."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mlflow

from tokt.models.registry.registry import Registry, local_uri, tracking_uri

RUN_NAME = "compare"
FOLDER = "compare"


def _metrics(result: dict[str, Any]) -> dict[str, float]:
    """The headline figures of each model, by the model's name."""
    found: dict[str, float] = {}
    for model in result["models"]:
        figures = {
            **{name: model["patch"][name] for name in ("f1", "precision", "recall", "macro_f1")},
            "average_precision": model["patch"]["average_precision"],
            "time_ms": model["time"]["median_ms"],
            "bundle_bytes": model["bundle_bytes"],
        }
        for name in ("false_status", "detected") if model["frames"] else ():
            figures[name] = model["frames"][name]
        for name, value in figures.items():
            if value is not None:
                found[f"{model['model']}/{name}"] = float(value)
    return found


def log_comparison(result: dict[str, Any], html: str, registry: Registry) -> str:
    """Log figures, report and JSON; return the run's id.

    Raises
    ------
    ToktError
        If the registry cannot be reached or written.
    """
    labels = [model["model"] for model in result["models"]]
    experiment = registry.experiment_id()
    with (
        registry.reported(),
        mlflow.start_run(experiment_id=experiment, run_name=RUN_NAME) as run,
    ):
        mlflow.set_tags(
            {
                "kind": "compare",
                "models": ", ".join(labels),
                **{f"model_{number}": label for number, label in enumerate(labels, 1)},
                "mode": result["mode"],
                "compared_on": result["what"],
            }
        )
        mlflow.log_metrics(_metrics(result))
        mlflow.log_text(html, f"{FOLDER}/report.html")
        mlflow.log_text(json.dumps(result, allow_nan=False), f"{FOLDER}/comparison.json")
        return str(run.info.run_id)


def has_registry(workspace: Path) -> bool:
    """Whether there is somewhere to log to that a comparison need not make first."""
    return tracking_uri(workspace) != local_uri(workspace) or (workspace / "mlflow.db").is_file()
