"""Log a trained model to MLflow and register it, so that it can be traced and exported."""

import json
import re
import subprocess
import tempfile
import time
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import mlflow
import mlflow.sklearn
import numpy as np
import pandas as pd
from mlflow.data.dataset_source_registry import resolve_dataset_source
from mlflow.data.meta_dataset import MetaDataset
from mlflow.entities import Metric
from mlflow.models import infer_signature

from tokt import __version__
from tokt.features.frames.mission import format_frames
from tokt.features.kernels.dispatch import KERNELS
from tokt.models.bundle.bundle import (
    Golden,
    distribution_bytes,
    golden_bytes,
    lineage_bytes,
    weights_bytes,
)
from tokt.models.registry.registration import FILES_TAG, RegisteredVersion, files_tag
from tokt.models.registry.registry import RECIPE_VERSION, Registry
from tokt.models.signing.keys import SigningKey
from tokt.training.datasets.dataset import FRAME_KEY, DatasetVersion
from tokt.training.evaluation import plots
from tokt.training.evaluation.report import report_page

from .classifier import decision_values
from .train import Trained, parameters

NEWEST_ALIAS = "challenger"
_MAX_DESCRIPTION = 5000  # what MLflow's database keeps of one
_NOT_IN_A_NAME = re.compile(r"[^\w.\- ]")  # of a metric; missions are called as folders are
_LIBRARIES = ("numpy", "opencv-python-headless", "scikit-learn", "mlflow")


def code_version() -> str:
    """The version of tokt, with the git commit where it runs from a checkout."""
    folder = Path(__file__).parents[2]
    if not (folder / ".git").exists():
        return __version__  # git would describe whatever repository the install happens to be in
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude=*"],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return __version__
    return f"{__version__}+g{found.stdout.strip()}"


def _golden_rows(dataset: DatasetVersion) -> list[int]:
    """Two frames of the dataset: the one with most obstacle patches, and the clearest one."""
    patches = dataset.patches.assign(obstacle=dataset.obstacles())
    counts = patches.groupby(FRAME_KEY).obstacle.agg(["sum", "size"])
    listed = counts.loc[pd.MultiIndex.from_frame(dataset.frames[FRAME_KEY])].reset_index(drop=True)
    most = int(listed["sum"].idxmax())
    clearest = int((listed["size"] - listed["sum"]).idxmax())
    return sorted({most, clearest})


def _golden(trained: Trained) -> Golden:
    """Golden frames with what *scikit-learn's* pipeline says of them, not the folded weights."""
    dataset = trained.request.dataset
    files, values = [], []
    for row in _golden_rows(dataset):
        image = dataset.read_frame(row)
        files.append(cv2.imencode(".png", image)[1].tobytes())
        described = trained.request.extractor.describe(image, dataset.grid)
        values.append(decision_values(trained.pipeline, described))
    obstacle = np.stack([trained.model.obstacle_patches(value) for value in values])
    return Golden(tuple(files), np.stack(values), obstacle)


def _trained_frames(trained: Trained) -> dict[str, str]:
    """The frame numbers learnt from, by mission; empty where it was not the dataset's."""
    dataset = trained.request.dataset
    if trained.request.settings.two_images or dataset.block_frames is None:
        return {}
    frames = dataset.frames.groupby("mission").frame
    return {str(name): format_frames(numbers.tolist()) for name, numbers in frames}


def _recipe(trained: Trained, model_id: str) -> dict[str, Any]:
    request, model = trained.request, trained.model
    dataset = request.dataset
    pairs = zip(model.classes, model.obstacle, strict=True)
    return {
        "recipe_version": RECIPE_VERSION,
        "hashed": True,
        "extractor": request.extractor.spec,
        "extractor_name": request.extractor_name,
        "dim": request.extractor.dim,
        "grid": dataset.grid.to_json(),
        "classes": [{"name": name, "obstacle": flag} for name, flag in pairs],
        "thresholds": model.thresholds.tolist(),
        "landmarks": model.landmarks,
        "operating_point": trained.operating_point.to_json(),
        "distribution": trained.distribution.summary() if trained.distribution else None,
        "fold_rules": [rule.to_json() for rule in trained.held_out.rules],
        "metrics": trained.metrics,
        "provenance": {
            "dataset": dataset.label,
            "dataset_hash": dataset.hash,
            "dataset_sources": "; ".join(dataset.info["sources"]),
            "missions": dataset.frames.mission.value_counts().to_dict(),
            "label_counts": dataset.info["labels"],
            "trained_frames": _trained_frames(trained),
            "preset": request.settings.preset,
            "penalty": trained.choice.penalty,
            "class_weight": trained.choice.class_weight or "none",
            "learnt_changes": ", ".join(request.settings.changes) or "none",
            **({"search": request.search} if request.search else {}),
            "code_version": code_version(),
            "mlflow_model_id": model_id,
            "libraries": ", ".join(f"{name} {version(name)}" for name in _LIBRARIES),
            "kernels": KERNELS.name,
        },
    }


def _flat_metrics(metrics: dict[str, Any]) -> dict[str, float]:
    """The headline figures under the names a run is searched by."""
    patch, frames = metrics["patch"], metrics["frames"]
    figures = {
        "cv_f1": patch["f1"],
        "cv_precision": patch["precision"],
        "cv_recall": patch["recall"],
        "cv_average_precision": patch["average_precision"],
        "cv_macro_f1": patch["macro_f1"],
        "cv_ocean_frames": frames["ocean_frames"],
        "cv_false_status_frames": frames["false_status"],
        "cv_false_status_frames_at_margin_0": metrics["frames_at_zero"]["false_status"],
        "cv_obstacle_frames": frames["obstacle_frames"],
        "cv_detected_frames": frames["detected"],
        "cv_detected_frames_at_margin_0": metrics["frames_at_zero"]["detected"],
        **{f"cv_dives_{name}": value for name, value in metrics.get("over_dives", {}).items()},
        **{
            f"cv_{what[:-1]}_f1_{_NOT_IN_A_NAME.sub('_', name)}": one["f1"]
            for what in ("dives", "sites")
            for name, one in metrics.get(what, {}).items()
        },
        **{f"stress_f1_{name}": one["f1"] for name, one in metrics.get("stress", {}).items()},
        **{
            f"cv_first_detection_{_NOT_IN_A_NAME.sub('_', name)}": at
            for name, at in frames["first_detection"].items()
        },
    }
    return {name: float(value) for name, value in figures.items() if isinstance(value, int | float)}


def _logged_metrics(metrics: dict[str, Any]) -> list[Metric]:
    """The headline figures, and those of each fold as its step: one commit for all of them."""
    now = int(time.time() * 1000)
    headlines = [Metric(name, value, now, 0) for name, value in _flat_metrics(metrics).items()]
    return headlines + [
        Metric(f"fold_{figure}", fold[figure], now, index)
        for index, fold in enumerate(metrics["folds"])
        for figure in ("f1", "precision", "recall", "average_precision")
        if fold[figure] is not None
    ]


def _write_artifacts(folder: Path, trained: Trained, model_id: str) -> None:
    recipe = json.dumps(_recipe(trained, model_id), indent=2, sort_keys=True)
    (folder / "recipe.json").write_text(recipe + "\n", "utf-8")
    (folder / "weights.npz").write_bytes(weights_bytes(trained.model))
    (folder / "golden.npz").write_bytes(golden_bytes(_golden(trained)))
    (folder / "lineage.npz").write_bytes(lineage_bytes(trained.trained_on))
    if trained.distribution is not None:
        data = distribution_bytes(trained.distribution)
        (folder / "distribution.npz").write_bytes(data)
    _held_out_table(trained).to_parquet(folder / "held_out.parquet", index=False)


def _held_out_table(trained: Trained) -> pd.DataFrame:
    """What each patch was called by a model that did not learn from it."""
    dataset, values = trained.request.dataset, trained.held_out.values
    return dataset.patches.assign(
        fold=trained.held_out.fold,
        target=dataset.targets(),
        obstacle_score=trained.model.obstacle_score(values),
        **{f"value_{output}": values[:, output] for output in range(values.shape[1])},
    )


def _log_figures(trained: Trained) -> None:
    tested = trained.held_out.fold >= 0
    truth = np.asarray(trained.model.obstacle, bool)[trained.request.dataset.targets()[tested]]
    score = trained.model.obstacle_score(trained.held_out.values[tested])
    if truth.any() and not truth.all():
        curve = plots.precision_recall({trained.request.name: (truth, score)})
        mlflow.log_figure(curve, "plots/precision_recall.png")
    confusion = trained.metrics["patch"]["confusion"]
    mlflow.log_dict(confusion, "plots/confusion.json")
    mlflow.log_figure(plots.confusion(confusion), "plots/confusion.png")
    mlflow.log_dict(
        {
            **trained.operating_point.to_json(),
            "fold_rules": trained.metrics["fold_rules"],
            "frames": trained.metrics["frames"],
            "frames_at_margin_0": trained.metrics["frames_at_zero"],
        },
        "tokt/operating_point.json",
    )


def _lineage(dataset: DatasetVersion) -> MetaDataset:
    with warnings.catch_warnings():
        # mlflow registers two sources of the same name for local folders and says so each time.
        warnings.simplefilter("ignore", UserWarning)
        source = resolve_dataset_source(dataset.path.resolve().as_uri())
    return MetaDataset(source, name=dataset.name, digest=dataset.hash[:32])


def log_and_register(
    trained: Trained, registry: Registry, key: SigningKey | None = None
) -> RegisteredVersion:
    """Log a run with parameters, figures, curves, dataset and model; register the version.

    The new version gets the alias ``challenger``; nothing becomes ``champion`` by itself.

    Parameters
    ----------
    key : SigningKey, optional
        Signs the registration.

    Raises
    ------
    ToktError
        If the registry cannot be reached or written.
    """
    request = trained.request
    features = np.zeros((1, request.extractor.dim))
    experiment = registry.experiment_id()
    with (
        registry.reported(),
        mlflow.start_run(experiment_id=experiment, run_name=request.name) as run,
    ):
        mlflow.log_params(parameters(trained))
        registry.client.log_batch(run.info.run_id, metrics=_logged_metrics(trained.metrics))
        info = mlflow.sklearn.log_model(
            trained.pipeline,
            name="model",
            signature=infer_signature(features, trained.pipeline.predict(features)),
            pip_requirements=[f"scikit-learn=={version('scikit-learn')}"],
            serialization_format="skops",
        )
        mlflow.log_input(_lineage(request.dataset), context="training")
        _log_figures(trained)
        with tempfile.TemporaryDirectory() as folder:
            _write_artifacts(Path(folder), trained, info.model_id)
            files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
            mlflow.log_artifacts(folder, "tokt")
    tags = {"dataset": request.dataset.label, "extractor": request.extractor_name}
    tags["preset"] = request.settings.preset
    tags[FILES_TAG] = files_tag(request.name, run.info.run_id, files)
    if request.search:
        tags["search"] = request.search
    registered = registry.register(
        request.name, info.model_uri, run.info.run_id, info.model_id, tags
    )
    if key is not None:
        registry.sign(registered, key)
    _log_card(registered, registry)
    return registry.set_alias(registered.label, NEWEST_ALIAS)


def log_adaptation(found: dict[str, Any], registered: RegisteredVersion, registry: Registry) -> str:
    """Keep what `adaptation` found with the version's run; the same as an HTML page.

    Raises
    ------
    ToktError
        If the registry cannot be reached or written.
    """
    page = report_page(__package__ or "", found=found, label=registered.label)
    with registry.reported():
        registry.client.log_dict(registered.run_id, found, "tokt/adaptation.json")
        registry.client.log_text(registered.run_id, page, "tokt/adaptation.html")
    return page


def _log_card(registered: RegisteredVersion, registry: Registry) -> None:
    """Keep the card, which names the version, beside what it is made from, and as description."""
    card = registry.card(registered.label)
    description = card
    if len(card) > _MAX_DESCRIPTION:
        more = "\n\n(The whole card is the run's artifact tokt/card.md.)"
        description = card[: _MAX_DESCRIPTION - len(more)] + more
    with registry.reported():
        registry.client.log_text(registered.run_id, card, "tokt/card.md")
        registry.client.update_model_version(registered.name, registered.version, description)
