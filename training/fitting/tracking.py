"""Log a trained model to MLflow and register it, so that it can be traced and exported."""

import base64
import json
import re
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
from mlflow import MlflowClient
from mlflow.entities import LoggedModelOutput, LoggedModelStatus, Metric
from mlflow.models import Model

from tokt import __version__
from tokt.features.common.canonical import printable_json
from tokt.features.common.errors import naming, os_errors_as
from tokt.mlflow import COLUMN, LOADER_MODULE, SIGNATURE
from tokt.models.bundle.bundle import BundleContent, Golden, bundle_bytes
from tokt.models.bundle.card import model_card
from tokt.models.registry.registration import FILES_TAG, NUMBER_TAG, RegisteredVersion, files_tag
from tokt.models.registry.registry import BUNDLE_FILE, Registry, retry_once
from tokt.models.signing.keys import SigningKey
from tokt.training.datasets.dataset import DatasetVersion
from tokt.training.evaluation import plots
from tokt.training.evaluation.report import report_page

from .contents import content_of, recipe_of
from .train import Trained, parameters

NEWEST_ALIAS = "challenger"
_SIGHT_FRAMES = 60
"""About so many frames of each mission's camera give the numbers of sight: more are near copies."""
_MAX_DESCRIPTION = 5000  # what MLflow's database keeps of one
_MAX_KEY = 250  # characters that MLflow keeps of a metric's name
_NOT_IN_A_NAME = re.compile(r"[^\w.\- ]")  # of a metric; missions are called as folders are


def _flat_metrics(metrics: dict[str, Any]) -> dict[str, float]:
    """The headline figures under the names a run is searched by."""
    patch, frames = metrics["patch"], metrics["frames"]
    figures = {
        **{f"cv_{name}": patch[name] for name in (*_FOLD_FIGURES, "macro_f1")},
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
    kept = {name[:_MAX_KEY]: value for name, value in figures.items()}
    return {name: float(value) for name, value in kept.items() if isinstance(value, int | float)}


_FOLD_FIGURES = ("f1", "precision", "recall", "average_precision")


def _logged_metrics(trained: Trained, model_id: str) -> list[Metric]:
    """The headline figures, and those of each fold as its step: one commit for all of them.

    They are the model's, of the dataset, and MLflow shows them with both.
    """
    metrics, dataset, now = trained.metrics, trained.request.dataset, int(time.time() * 1000)
    figures = [(name, value, 0) for name, value in _flat_metrics(metrics).items()] + [
        (f"fold_{figure}", fold[figure], index)
        for index, fold in enumerate(metrics["folds"])
        for figure in _FOLD_FIGURES
        if fold[figure] is not None
    ]
    of = {"dataset_name": dataset.name, "dataset_digest": dataset.hash[:32]}
    return [Metric(name, value, now, step, model_id, **of) for name, value, step in figures]


def _written_artifacts(folder: Path, trained: Trained, model_id: str) -> dict[str, bytes]:
    """What the run holds beside the bundle, written into a folder."""
    recipe = json.dumps(recipe_of(trained, mlflow_model_id=model_id), indent=2, sort_keys=True)
    (folder / "recipe.json").write_text(recipe + "\n", "utf-8")
    held_out_table(trained).to_parquet(folder / "held_out.parquet", index=False)
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def _log_model(client: MlflowClient, bundle: bytes, golden: Golden, model: Model) -> None:
    """Log the bundle as the data of a pyfunc, in place of any that was logged before.

    ``mlflow.pyfunc.log_model`` would log the run's metrics once more each time.
    """
    text = base64.b64encode(golden.frames[0]).decode("ascii")
    with tempfile.TemporaryDirectory() as folder:
        file, whole = Path(folder) / BUNDLE_FILE, Path(folder) / "model"
        file.write_bytes(bundle)
        mlflow.pyfunc.save_model(
            str(whole),
            loader_module=LOADER_MODULE,
            data_path=str(file),
            mlflow_model=model,
            signature=SIGNATURE,
            input_example=pd.DataFrame({COLUMN: [text]}),
            pip_requirements=[f"tokt=={__version__}"],
        )
        client.log_model_artifacts(model.model_id, str(whole))
    client.finalize_logged_model(model.model_id, LoggedModelStatus.READY)


def _register(
    registry: Registry, content: BundleContent, files: dict[str, bytes], tags: dict[str, str]
) -> tuple[RegisteredVersion, str]:
    """Log the bundle under the next number and register it; again if MLflow gave another one.

    The number stands in the bundle, and MLflow says it afterwards. A version whose bundle has
    another number is never listed (`RegisteredVersion.own`), and is deleted. One that others took
    meanwhile is not tried: trainings at a time would take each other's numbers for ever. Returns
    the version and its card.
    """
    run_id, model_id = (content.provenance[f"mlflow_{what}_id"] for what in ("run", "model"))
    recipe, least = printable_json(files["recipe.json"]), 1
    while True:
        number = registry.next_number(content.name, least)
        card = model_card(f"{content.name}/{number}", recipe, content.provenance)
        bundle = bundle_bytes(replace(content, version=str(number), card=card))
        with registry.reported():
            model = Model(artifact_path="model", run_id=run_id, model_id=model_id)
            _log_model(registry.client, bundle, content.golden, model)
        hashed = files_tag(content.name, run_id, {**files, BUNDLE_FILE: bundle})
        all_tags = {**tags, FILES_TAG: hashed, NUMBER_TAG: f"{content.name}/{number}"}
        uri = f"models:/{model_id}"
        if registry.next_number(content.name, least) != number:
            continue
        registered = registry.register(content.name, uri, run_id, model_id, all_tags)
        if registered.own:
            return registered, card
        registry.withdraw(registered)
        least = int(registered.version) + 1


def held_out_table(trained: Trained) -> pd.DataFrame:
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
    folds = pd.DataFrame(trained.metrics["folds"])
    mlflow.log_table(folds.filter(["frames", *_FOLD_FIGURES]), "tables/folds.json")
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


def log_dataset(
    patches: pd.DataFrame, context: str, dataset: DatasetVersion | None, name: str = ""
) -> None:
    """Log a table of patches to the active run as one of MLflow's datasets.

    It has name, hash and place of its dataset version, or else the name that is given.
    """
    with warnings.catch_warnings():
        # mlflow registers two sources of the same name for local folders and says so each time;
        # that whole numbers cannot be missing is meant.
        warnings.simplefilter("ignore", UserWarning)
        of = {"name": name}
        if dataset is not None:
            of = {"name": dataset.name, "source": dataset.path.resolve().as_uri()}
            of["digest"] = dataset.hash[:32]
        table = mlflow.data.from_pandas(patches, targets="label", **of)
        retry_once(lambda: mlflow.log_input(table, context))


def log_and_register(
    trained: Trained, registry: Registry, key: SigningKey | None = None
) -> RegisteredVersion:
    """Log a run with parameters, figures, curves, dataset and model; register the version.

    The new version gets the alias ``challenger``; nothing becomes ``champion`` by itself. `key`
    signs the registration. Raises ToktError if the registry cannot be reached or written.
    """
    request, logged = trained.request, parameters(trained)
    experiment = registry.experiment_id()
    with (
        registry.reported(),
        mlflow.start_run(experiment_id=experiment, run_name=request.name, nested=True) as run,
    ):
        mlflow.log_params(logged)
        texts = {name: str(value) for name, value in logged.items()}
        model_id = mlflow.initialize_logged_model("model", params=texts).model_id
        registry.client.log_outputs(run.info.run_id, [LoggedModelOutput(model_id, step=0)])
        log_dataset(request.dataset.patches, "training", request.dataset)
        registry.client.log_batch(run.info.run_id, metrics=_logged_metrics(trained, model_id))
        _log_figures(trained)
        with tempfile.TemporaryDirectory() as folder:
            files = _written_artifacts(Path(folder), trained, model_id)
            mlflow.log_artifacts(folder, "tokt")
    tags = {"dataset": request.dataset.label, "extractor": request.extractor_name}
    tags["preset"] = request.settings.preset
    if request.search:
        tags["search"] = request.search
    recipe = printable_json(files["recipe.json"])
    content = content_of(trained, recipe, mlflow_run_id=run.info.run_id)
    state = f"run {run.info.run_id} is logged, and tokt models list shows whether it is registered"
    with naming(state), os_errors_as("its files"):
        registered, card = _register(registry, content, files, tags)
        if key is not None:
            registry.sign(registered, key)
        _log_card(registered, card, registry)
        return registry.set_alias(registered.label, NEWEST_ALIAS)


def adaptation_page(told: dict[str, Any], label: str) -> str:
    """Return what `adaptation` tells of a version as an HTML page."""
    return report_page(__package__ or "", found=told, label=label)


def log_adaptation(told: dict[str, Any], registered: RegisteredVersion, registry: Registry) -> None:
    """Keep what `adaptation` tells with the version's run, as JSON and as a page."""
    page = adaptation_page(told, registered.label)
    with registry.reported():
        registry.client.log_dict(registered.run_id, told, "tokt/adaptation.json")
        registry.client.log_text(registered.run_id, page, "tokt/adaptation.html")


def _log_card(registered: RegisteredVersion, card: str, registry: Registry) -> None:
    """Keep the card, which names the version, beside what it is made from, and as description."""
    description = card
    if len(card) > _MAX_DESCRIPTION:
        more = "\n\n(The whole card is the run's artifact tokt/card.md.)"
        description = card[: _MAX_DESCRIPTION - len(more)] + more
    with registry.reported():
        registry.client.log_text(registered.run_id, card, "tokt/card.md")
        registry.client.update_model_version(registered.name, registered.version, description)
