"""What a run logs and a version is registered with."""

import json
from pathlib import Path

import mlflow
import numpy as np
import pytest

from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import open_dataset
from tokt.training.evaluation.frame_scores import frame_figures
from tokt.training.evaluation.metrics import obstacle_metrics


@pytest.fixture(scope="module")
def registry(trained):
    return Registry(trained)


@pytest.fixture(scope="module")
def version(registry):
    return registry.find("tiny-lbp/1")


def artifact(version, name, folder):
    uri = f"runs:/{version.run_id}/tokt/{name}"
    return Path(mlflow.artifacts.download_artifacts(uri, dst_path=str(folder))).read_bytes()


def test_the_figures_follow_from_what_is_kept(registry, version, trained):
    """held_out.parquet and the folds' rules give every figure that the recipe states."""
    recipe, held_out = registry.recipe(version), registry.held_out(version.label)
    dataset = open_dataset("tiny", trained / "datasets")
    assert held_out[dataset.patches.columns].equals(dataset.patches)
    assert (held_out.target == dataset.targets()).all()
    assert np.array_equal(held_out.obstacle_score, held_out.value_0)
    metrics, score = recipe["metrics"], held_out.obstacle_score.to_numpy()
    patch = obstacle_metrics((held_out.target == 1).to_numpy(), score)
    assert {name: metrics["patch"][name] for name in patch} == patch
    rules = [MofNRule.from_json(rule) for rule in recipe["fold_rules"]]
    fold = held_out.fold.to_numpy()
    assert frame_figures(dataset, score, fold, rules) == metrics["frames"]
    assert frame_figures(dataset, score, fold, [MofNRule()] * 3) == metrics["frames_at_zero"]
    assert [fold["class_weight"] for fold in metrics["folds"]] == [None] * 3


def test_the_operating_point_goes_from_training_into_recipe_run_and_bundle(
    registry, version, tmp_path
):
    recipe = registry.recipe(version)
    point = OperatingPoint.from_json(recipe["operating_point"])
    assert point.chosen["ocean_frames"] == 15 and "not a bound" in point.chosen["words"]
    assert registry.bundle(version.label).operating_point == point
    logged = json.loads(artifact(version, "operating_point.json", tmp_path))
    assert {name: logged[name] for name in point.to_json()} == point.to_json()
    assert logged["fold_rules"] == recipe["fold_rules"]
    run = registry.client.get_run(version.run_id).data
    assert float(run.params["rule_margin"]) == point.rule.margin
    assert run.params["target_rate"] == "0.0001"
    assert run.metrics["cv_detected_frames"] == recipe["metrics"]["frames"]["detected"]


def test_the_card_is_kept_with_the_run_and_is_the_versions_description(registry, version, tmp_path):
    card = registry.bundle(version.label).card
    assert artifact(version, "card.md", tmp_path).decode("utf-8") == card
    described = registry.client.get_model_version(version.name, version.version).description
    assert described == card or (len(card) > 5000 and described.startswith(card[:4000]))
