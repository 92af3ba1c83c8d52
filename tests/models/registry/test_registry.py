"""The registry in a file, and the way to a bundle."""

import json
import os
import re
from pathlib import Path

import mlflow
import pytest

from tests.calls import free_port, refuses
from tokt.models.bundle.bundle import bundle_from_bytes, read_bundle
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import open_dataset


def test_a_new_registry_is_empty_and_whole(tmp_path):
    registry = Registry(tmp_path / "fresh" / ".tokt", create=True)
    assert registry.versions() == []
    refuses("there are: none yet", registry.find, "anything")
    own = registry.client.get_experiment_by_name("Default").artifact_location
    assert own == (tmp_path / "fresh/.tokt/mlartifacts/0").as_uri()


def test_what_a_run_holds(trained):
    registry = Registry(trained)
    version = registry.find("tiny-lbp")
    client = mlflow.MlflowClient()
    run = client.get_run(version.run_id)
    dataset = open_dataset("tiny", trained / "datasets")
    assert run.info.status == "FINISHED"
    assert run.data.params["dataset_hash"] == dataset.hash
    assert run.data.params["setting_seed"] == "42"
    assert run.data.params["split_folds"] == "3"
    assert float(run.data.params["penalty_chosen"]) in (0.01, 0.1, 1.0, 10.0)
    metrics = registry.recipe(version)["metrics"]
    assert run.data.metrics["cv_f1"] == metrics["patch"]["f1"]
    for figure in ("f1", "precision", "recall", "average_precision"):
        logged = client.get_metric_history(version.run_id, f"fold_{figure}")
        by_fold = [metric.value for metric in sorted(logged, key=lambda m: m.step)]
        assert by_fold == [fold[figure] for fold in metrics["folds"]]
    (used,) = run.inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("tiny", dataset.hash[:32])
    assert {tag.value for tag in used.tags} == {"training"}
    assert json.loads(used.dataset.profile)["num_rows"] == len(dataset.patches)
    source = mlflow.data.get_source(used.dataset)
    assert Path(source.load()).resolve() == dataset.path.resolve()
    # MLflow shows them on the model's own page too.
    model = client.get_logged_model(registry.recipe(version)["provenance"]["mlflow_model_id"])
    assert (model.status, model.source_run_id) == ("READY", version.run_id)
    (shown,) = [metric for metric in model.metrics if metric.key == "cv_f1"]
    assert (shown.value, shown.dataset_digest) == (metrics["patch"]["f1"], dataset.hash[:32])
    logged = [client.list_artifacts(version.run_id, folder) for folder in ("plots", "tokt")]
    files = {item.path for items in logged for item in items}
    assert {"plots/precision_recall.png", "plots/confusion.png", "tokt/recipe.json"} <= files


def test_exporting_twice_gives_the_same_bytes(trained, tmp_path, run_tokt, tiny_bundle):
    ran = run_tokt("export", "tiny-lbp/1", "-o", tmp_path / "b.tokt", "--workspace", trained)
    assert ran.code == 0
    assert (tmp_path / "b.tokt").read_bytes() == tiny_bundle.read_bytes()
    assert bundle_from_bytes(tiny_bundle.read_bytes(), "again").label == "tiny-lbp/1"


def test_aliases_move(workspace, run_tokt):
    registry = Registry(workspace)
    assert registry.find("tiny-lbp").aliases == ("challenger",)
    first = registry.find("tiny-lbp/1")
    registry.register("tiny-lbp", "models:/tiny-lbp/1", first.run_id, _model_id(registry), {})
    where = ("--workspace", workspace)
    assert run_tokt("models", "alias", "tiny-lbp/1", "champion", *where).code == 0
    assert registry.find("tiny-lbp@champion").version == "1"
    assert run_tokt("models", "alias", "tiny-lbp/2", "champion", *where).code == 0
    assert registry.find("tiny-lbp@champion").version == "2"
    assert registry.find("tiny-lbp@challenger").version == "1"
    assert registry.find("tiny-lbp").version == "2"  # the newest
    listed = json.loads(run_tokt("models", "list", "--json", *where).out)["models"]
    found = [(item["version"], item["aliases"]) for item in listed]
    assert found == [("2", ["champion"]), ("1", ["challenger"])]  # the newest first


def _model_id(registry: Registry) -> str:
    return registry.client.get_model_version("tiny-lbp", "1").model_id


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("nothing", "no model 'nothing' in the registry (there are: tiny-lbp)"),
        ("tiny-lbp@champion", "model 'tiny-lbp' has no alias 'champion'"),
        ("tiny-lbp/9", "model 'tiny-lbp' has no version 9"),
        ("tiny-lbp@", "not a model: 'tiny-lbp@'"),
        ("a'; drop", 'no model "a\'; drop"'),
    ],
)
def test_references_to_nothing(trained, reference, message):
    refuses(re.escape(message), Registry(trained).find, reference)


def test_what_cannot_be_an_alias(trained):
    for alias in ("latest", "v3", "a b", "", "-x", "a/b"):
        refuses("cannot be an alias", Registry(trained).set_alias, "tiny-lbp", alias)


def test_a_model_that_tokt_did_not_train_is_said(workspace):
    registry = Registry(workspace)
    experiment = registry.experiment_id()
    with mlflow.start_run(experiment_id=experiment) as run:
        pass
    registry.register("foreign", "models:/tiny-lbp/1", run.info.run_id, _model_id(registry), {})
    refuses("was it trained by tokt", registry.bundle, "foreign")


def test_a_database_that_is_none_is_said(tmp_path):
    (tmp_path / "mlflow.db").write_bytes(b"this is no database" * 100)
    refuses("the model registry at sqlite", lambda: Registry(tmp_path).versions())


def test_a_folder_name_that_mlflow_cannot_use_is_said(tmp_path, run_tokt):
    ran = run_tokt("models", "list", "--workspace", tmp_path / "what?")
    assert ran.code == 2
    assert "cannot keep its file in a path with '?'" in ran.err


def test_reading_makes_no_registry(tmp_path):
    refuses("no model has been trained", Registry, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_its_own_registry_whatever_the_environment_says(tmp_path, monkeypatch):
    elsewhere = f"sqlite:///{tmp_path / 'elsewhere.db'}"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", elsewhere)
    own = Registry(tmp_path / "demo", create=True, own=True)
    assert own.versions() == [] and own.uri == f"sqlite:///{tmp_path / 'demo' / 'mlflow.db'}"
    assert os.environ["MLFLOW_TRACKING_URI"] == elsewhere
    assert not (tmp_path / "elsewhere.db").exists()


def test_workspaces_in_one_process_keep_apart(trained, tmp_path):
    """MLflow keeps the last tracking URI in the environment; the next one must not get it."""
    assert [item.label for item in Registry(trained).versions()] == ["tiny-lbp/1"]
    assert Registry(tmp_path, create=True).versions() == []
    assert not {"MLFLOW_TRACKING_URI", "MLFLOW_REGISTRY_URI"} & set(os.environ)


def test_a_server_that_is_down_is_said_in_seconds(workspace, run_tokt, monkeypatch):
    """MLflow by itself would try for longer than a test may last."""
    port = free_port()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{port}")
    ran = run_tokt("train", "tiny", "--extractor", "lbp", "--workspace", workspace)
    assert ran.code == 2
    said = f"tokt: error: the model registry at http://127.0.0.1:{port}"
    assert ran.err.splitlines()[-1].startswith(said)


def test_an_exported_bundle_says_where_it_comes_from(trained, tiny_bundle):
    bundle = read_bundle(tiny_bundle)
    provenance = bundle.content.provenance
    assert provenance["dataset_hash"] == open_dataset("tiny", trained / "datasets").hash
    assert provenance["mlflow_run_id"] == Registry(trained).find("tiny-lbp").run_id
    assert len(bundle.content.trained_on) == 40
    assert len(bundle.content.golden.frames) == 2
    assert "cross-validation over blocks of" in bundle.content.card
