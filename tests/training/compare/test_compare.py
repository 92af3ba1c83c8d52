"""`tokt compare`: its figures against evaluate's, what it refuses, and the page in a browser."""

import json
import re
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import mlflow
import numpy as np
import pandas as pd
import pytest
from sklearn.ensemble import HistGradientBoostingClassifier

import tokt
from tests.calls import refuses
from tokt.models.operating_point import MofNRule
from tokt.models.registry.registry import Registry
from tokt.training.compare.comparison import explorer_data
from tokt.training.compare.frames import FrameSeries, frame_figures, statuses
from tokt.training.compare.held_out_predictions import check_different, read_held_out
from tokt.training.compare.learning import set_up
from tokt.training.compare.predictions import ComparedModels
from tokt.training.compare.report import report_html
from tokt.training.datasets.dataset import open_dataset
from tokt.training.evaluation.metrics import obstacle_metrics

LBP, THESIS = "tiny-lbp/1", "tiny-thesis/1"


@dataclass(frozen=True)
class Compared:
    """One run of the command, and what it worked on."""

    workspace: Path
    page: Path
    json: dict[str, Any]
    judged: ComparedModels
    err: str

    def model(self, label):
        return next(model for model in self.json["models"] if model["model"] == label)


@pytest.fixture(scope="module")
def compared(trained, done, tmp_path_factory):
    """A cross-validated model against one of the thesis's kind, on what both held out.

    With ceilings, of which the net is not installed.
    """
    folder = tmp_path_factory.mktemp("compare")
    workspace = folder / ".tokt"
    shutil.copytree(trained, workspace)
    where = ("--workspace", workspace)
    thesis = ("--extractor", "lbp", "--preset", "thesis", "--name", "tiny-thesis", "--folds", 3)
    done("train", "tiny", *thesis, *where)
    page = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tokt.training.compare.ceilings.find_spec", lambda name: None)
        asked = ("compare", "tiny-lbp", "tiny-thesis", "-o", page, "--ceilings")
        ran = done(*asked, "--json", *where)
    judged = read_held_out([LBP, THESIS], workspace)
    return Compared(workspace, page, json.loads(ran.out), judged, ran.err)


def test_held_out_figures_are_those_of_the_training(compared):
    registry = Registry(compared.workspace)
    recipe = registry.recipe(registry.find(LBP))["metrics"]
    mine, frames = compared.model(LBP), recipe["frames"]
    # The thesis's model learnt from one frame, which is left out for both.
    left_out = recipe["patches_tested"] - compared.json["patches"]
    assert 0 < left_out <= 100
    assert mine["frames"]["ocean_frames"] == frames["ocean_frames"] - 1
    assert mine["frames"]["obstacle_frames"] == frames["obstacle_frames"]
    assert mine["frames"]["detected"] == frames["detected"]
    assert mine["patch"]["f1"] == pytest.approx(recipe["patch"]["f1"], abs=0.01)
    assert any(f"{left_out} of" in note for note in compared.json["notes"])


def test_the_verdict_is_in_words_with_how_sure_it_is(compared):
    (pair,) = compared.json["pairs"]
    assert pair["models"] == [LBP, THESIS]
    f1, other = (compared.model(label)["patch"]["f1"] for label in (LBP, THESIS))
    assert pair["difference"] == pytest.approx(f1 - other)
    assert pair["verdict"] == "better" and pair["interval"]["low"] > 0 and pair["p"] <= 0.05
    assert f"{LBP} is better than {THESIS}" in compared.json["words"][0]
    assert f"{pair['interval']['low']:+.3f}" in compared.json["words"][0]
    for name in ("f1", "average_precision"):
        bounds = compared.model(LBP)["intervals"][name]
        assert bounds["low"] <= compared.model(LBP)["patch"][name] <= bounds["high"]
    assert compared.json["ranking"] == [LBP, THESIS]
    time = compared.model(LBP)["time"]
    assert 0 < time["low_ms"] <= time["median_ms"] <= time["high_ms"] and time["runs"] >= 30


def test_the_learning_curve_tests_on_what_was_held_out(compared):
    curve = compared.json["learning_curve"]
    assert curve["model"] == LBP
    registry = Registry(compared.workspace)
    recipe = registry.recipe(registry.find(LBP))["metrics"]
    # All blocks, each fold's own settings: the cross-validation once more.
    assert curve["points"][-1]["mean"] == pytest.approx(recipe["patch"]["f1"], abs=1e-9)
    assert [point["fraction"] for point in curve["points"]] == [0.25, 0.5, 0.75, 1.0]
    assert len(curve["stretches"]) == 11 and len(curve["words"]) >= 3
    labels = {row["label"]: row["n"] for row in curve["by_label"]}
    assert sum(labels.values()) == recipe["patches_tested"]


def test_the_worst_errors_are_errors_and_have_pictures(compared):
    errors = compared.json["errors"]
    assert {error["kind"] for error in errors} == {"miss", "false alarm"}
    assert all(error["said"][label] != error["label"] for error in errors for label in error["of"])
    for error in errors:
        said = [error["scores"][label] > 0 for label in error["of"]]
        assert all(said) if error["kind"] == "false alarm" else not any(said)
        assert (error["label"] == "ocean") == (error["kind"] == "false alarm")
    page = compared.page.read_text("utf-8")
    assert page.count("data:image/jpeg;base64,") == len(errors)
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "https://" not in page


def test_a_comparison_is_a_run_of_mlflow(compared):
    registry = Registry(compared.workspace)
    run_id = compared.err.rpartition("MLflow run: ")[2].split()[0]
    run = registry.client.get_run(run_id)
    assert run.info.run_name == "compare" and run.data.tags["models"] == f"{LBP}, {THESIS}"
    assert run.data.metrics[f"{LBP}/f1"] == compared.model(LBP)["patch"]["f1"]
    page = mlflow.artifacts.load_text(f"runs:/{run_id}/compare/report.html")
    assert page == compared.page.read_text("utf-8")
    assert mlflow.artifacts.load_dict(f"runs:/{run_id}/compare/comparison.json") == compared.json
    logged = {item.path for item in registry.client.list_artifacts(run_id, "compare")}
    assert {f"compare/{name}.png" for name in ("statuses", "errors", "learning")} <= logged
    table = mlflow.artifacts.load_dict(f"runs:/{run_id}/compare/models.json")
    assert [row[0] for row in table["data"]] == [LBP, THESIS] and "f1" in table["columns"]
    # On the models' own pages too, and with what was evaluated on.
    for label in (LBP, THESIS):
        recipe = registry.recipe(registry.find(label))
        model = registry.client.get_logged_model(recipe["provenance"]["mlflow_model_id"])
        (found,) = [each for each in model.metrics if each.key == f"{label}/f1"]
        assert (found.run_id, found.value) == (run_id, compared.model(label)["patch"]["f1"])
    (used,) = run.inputs.dataset_inputs
    dataset = open_dataset("tiny", compared.workspace / "datasets")
    assert (used.dataset.name, used.dataset.digest) == ("tiny", dataset.hash[:32])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["tiny-lbp"], "at least two models"),
        (["tiny-lbp", LBP], "given twice"),
        (["tiny-lbp", "nobody"], "no model 'nobody'"),
        (["tiny-lbp", "tiny-thesis", "--frames", "1-9"], "go with --mission"),
        (["tiny-lbp", "tiny-thesis", "--learning-curve", "other"], "not one of the models"),
        (["tiny-lbp", "tiny-thesis", "--learning-curve", "tiny-thesis"], "from two images"),
        (["tiny-lbp", "tiny-thesis", "-o", "."], "names the report's file"),
    ],
)
def test_what_cannot_be_compared_is_one_line(compared, refused, arguments, said):
    refused(said, "compare", *arguments, "--workspace", compared.workspace)


def test_another_dataset_that_is_gone_needs_a_mission(compared, monkeypatch):
    recipe = Registry.recipe

    def another(self, version):
        found = recipe(self, version)
        if version.label == THESIS:
            found["provenance"] |= {"dataset_hash": "0" * 64, "dataset": "part@0000"}
        return found

    monkeypatch.setattr(Registry, "recipe", another)
    data = "part@0000 of .* is not in this workspace, .* train all on one, or give --mission"
    refuses(data, read_held_out, [LBP, THESIS], compared.workspace)


def test_a_file_that_was_exported_is_the_registered_model(compared, refused, tiny_bundle):
    command = ("compare", tiny_bundle, LBP, "--workspace")
    refused(f"{LBP} is given twice", *command, compared.workspace)
    refused("no model has been trained in workspace", *command, tiny_bundle.parent)


def test_two_models_of_one_name_are_not_said_to_be_one():
    names = ["tower/1", "tower/1"]
    refuses("two different models are called tower/1", check_different, names, ["aa", "bb"])
    refuses("tower/1 is given twice", check_different, names, ["aa", "aa"])


@pytest.fixture(scope="module")
def two_dives(tiny_dive, begun, done, told, tmp_path_factory):
    """Two models of the tiny mission and of the same in brighter water; what was told."""
    folder = tmp_path_factory.mktemp("dives")
    where, missions = ("--workspace", begun(folder / ".tokt")), []
    for name, gain in (("tiny", 1.0), ("late", 1.3)):
        labels = tiny_dive(folder / name, range(1, 25), gain)
        missions += ["--mission", folder / name, "--labels", labels]
    done("dataset", "build", "two", *missions, "--block", 4, *where)
    plain = ("--preset", "plain", "--folds", 3, "--embargo", 1, *where)
    models = [
        told("train", "two", "--extractor", name, "--name", name, *plain)
        for name in ("lbp", "haralick")
    ]
    return folder / ".tokt", models


def test_models_of_several_dives_are_held_out_and_compared_by_dive(two_dives, told, refused):
    workspace, models = two_dives
    where = ("--workspace", workspace)
    for model in models:
        assert list(model["cv"]["dives"]) == ["late", "tiny"]
        by_fold = [fold["f1"] for fold in model["cv"]["folds"]]
        assert [one["f1"] for one in model["cv"]["dives"].values()] == by_fold
        assert model["cv"]["over_dives"]["f1"] == pytest.approx(np.mean(by_fold))
        assert "2-fold cross-validation over whole dives" in model["cv"]["split"]
        assert "A dive counts by the root of its patches" in model["cv"]["split"]
        logged = mlflow.MlflowClient(f"sqlite:///{workspace}/mlflow.db").get_run(model["run_id"])
        assert logged.data.params["split_by"] == logged.data.params["split_weight"] == "dive"
        assert logged.data.metrics["cv_dive_f1_tiny"] == by_fold[1]
        assert logged.data.metrics["cv_dives_f1"] == pytest.approx(np.mean(by_fold))
    page = workspace.parent / "page.html"
    found = told("compare", "lbp", "haralick", "-o", page, *where)
    assert (found["unit"], found["blocks"]) == ("dives", 2)
    assert "2 dives count as independent. So few dives cannot show a difference" in found["method"]
    assert "bootstrap over whole dives, the same dives" in found["method"]
    assert any("learnt nothing of its dive" in note for note in found["notes"])
    assert len(found["stretches"]) == 14  # still by blocks along the dives
    assert found["pairs"][0]["verdict"] == "cannot tell"
    for model, trained in zip(found["models"], models, strict=True):
        for name, one in model["dives"].items():
            assert one == trained["cv"]["dives"][name]
    report = page.read_text("utf-8")
    assert "F1 of dive late" in report and "dives that differ" in report
    points = found["learning_curve"]["points"]
    of_model = {"lbp/1": models[0], "haralick/1": models[1]}[found["learning_curve"]["model"]]
    assert points[-1]["mean"] == pytest.approx(of_model["cv"]["patch"]["f1"], abs=1e-9)
    assert "those tested of others" in found["learning_curve"]["how"]
    train = ("train", "two", "--preset", "plain", *where)
    by_block = ("--folds", 3, "--embargo", 1, "--split", "block", "--weight", "patch")
    blocks = told(*train, "--extractor", "lbp", "--name", "blocks", *by_block)
    assert "3-fold cross-validation over blocks of" in blocks["cv"]["split"]
    assert "Every dive" not in blocks["cv"]["split"] and len(blocks["cv"]["dives"]) == 2
    folds = "lbp/1, blocks/1: not cross-validated in the same folds: give --mission DIR"
    refused(folds, "compare", "lbp", "blocks", *where)


def test_frames_that_were_learnt_from_are_refused(compared, refused, tiny):
    options = ("--mission", tiny.path, "--labels", tiny.labels, "--workspace", compared.workspace)
    said = refused("learnt from 40 of the 40", "compare", "tiny-lbp", "tiny-thesis", *options)
    assert f"{LBP} learnt from 40 of the 40 frames (1-40)" in said
    assert f"{THESIS} learnt from 1 of the 40 frames" in said


@pytest.fixture
def later_dive(tiny_dive, tmp_path):
    """Frames like the tiny mission's that no model has seen; every fourth number is missing."""
    return tiny_dive(tmp_path / "later", [n for n in range(100, 130) if n % 4]).parent


def test_single_pictures_count_one_by_one(compared, told, later_dive, tmp_path):
    for number, file in enumerate(sorted((later_dive / "Left").iterdir())):
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(file), picture[:, : picture.shape[1] - 4 * (number % 3)])
    options = ("--mission", later_dive, "--labels", later_dive / "labels.csv")
    found = told("compare", "tiny-lbp", "tiny-thesis", *options, "--workspace", compared.workspace,
                 "-o", tmp_path / "c.html")  # fmt: skip
    assert "count as independent, and each picture of later" in found["notes"][0]
    assert found["method"].startswith("22 blocks of frames count as independent")


def test_on_a_mission_the_figures_are_evaluates(compared, told, later_dive, tmp_path):
    options = ("--mission", later_dive, "--labels", later_dive / "labels.csv")
    some = ("--rate", 4, "--frames", "109-111,113-115,117-119,121-123,125-127,129")
    options = (*options, *some, "--workspace", compared.workspace)
    page = tmp_path / "report.html"
    found = told("compare", "tiny-lbp", "tiny-thesis", *options, "-o", page)
    assert found["mode"] == "mission"
    assert "Leave --mission out" in found["learning_curve"]["missing"]
    for model in found["models"]:
        evaluated = told("evaluate", model["model"], *options)
        for name in ("f1", "precision", "recall", "average_precision", "per_class", "confusion"):
            assert model["patch"][name] == evaluated["patch"][name]
        for name in ("n", "ocean_frames", "false_status", "obstacle_frames", "detected", "unknown"):
            assert model["frames"][name] == evaluated["frames"][name], name
        assert model["frames"]["approaches"] == [
            {"mission": "later", "camera": "left", **one}
            for one in evaluated["frames"]["approaches"]
        ]
        name = "false_status_per_hour"
        assert model["frames"][name] == evaluated["frames"][name]
        (sequence,) = model["frames"]["sequences"]
        assert sequence["first_detection"] == evaluated["frames"]["first_detection"]
    text = page.read_text("utf-8")
    assert text.startswith("<!doctype html>") and "false statuses an hour" in text
    (one,) = evaluated["frames"]["approaches"]
    assert f"approach later:{one['first_obstacle_frame']}-" in text


def test_several_missions_are_counted_together(compared, told, refused, later_dive, tmp_path):
    listed = "".join(
        f'[[mission]]\nname = "{name}"\ndir = "{later_dive}"\nlabels = "{later_dive}/labels.csv"\n'
        for name in ("first", "a-second")
    )
    (tmp_path / "missions.toml").write_text(listed, "utf-8")
    command = ("compare", "tiny-lbp", "tiny-thesis", "--workspace", compared.workspace)
    found = told(*command, "--mission", tmp_path)
    first = {"mission": f"first={later_dive}", "labels": later_dive / "labels.csv"}
    alone = tokt.compare(command[1:3], workspace=compared.workspace, **first).figures
    for both, one in zip(found["models"], alone["models"], strict=True):
        for name in ("n", "ocean_frames", "false_status", "obstacle_frames", "detected", "unknown"):
            assert both["frames"][name] == 2 * one["frames"][name], name
        assert both["frames"]["sequences"][1:] == one["frames"]["sequences"]
        counts = [np.array(each["patch"]["confusion"]["counts"]) for each in (both, one)]
        assert counts[0].tolist() == (2 * counts[1]).tolist()
    refused("--frames goes with one", *command, "--mission", tmp_path, "--frames", "1-9")


def test_open_ocean_alone_gives_no_verdict_but_false_statuses(
    compared, told, later_dive, open_page, tmp_path
):
    page = tmp_path / "ocean.html"
    options = ("--mission", later_dive, "--labels", later_dive / "labels.csv", "-o", page)
    options = (*options, "--frames", "109-111", "--workspace", compared.workspace)
    found = told("compare", "tiny-lbp", "tiny-thesis", *options)
    assert found["pairs"] == [] and found["words"][0].startswith("Cannot tell which")
    assert [model["frames"]["ocean_frames"] for model in found["models"]] == [3, 3]
    assert open_page(page).locator('[data-is="falseStatus"]').first.inner_text() == "0 / 3"


@pytest.fixture(scope="module")
def open_page(browser):
    """Open a report from disk; any console error, dialog or request of it fails the test."""
    faults, asked = [], []
    context = browser.new_context(offline=True, viewport={"width": 390, "height": 800})

    def start(path):
        page = context.new_page()
        page.on("console", lambda message: faults.append(message.text))
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("dialog", lambda dialog: (faults.append(dialog.message), dialog.dismiss()))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        return page

    yield start
    context.close()
    assert not faults
    assert all(url.startswith(("file:", "data:")) for url in asked), asked


def _shown(form):
    names = ("precision", "recall", "f1", "falseStatus", "detected", "first")
    return {name: form.locator(f'[data-is="{name}"]').inner_text() for name in names}


def _expected(judged, index, rule):
    predictions = judged.models[index]
    patch = obstacle_metrics(judged.truth, predictions.score - rule.margin)
    frames = frame_figures(judged.series, judged.status(replace(predictions, fold_rules=[rule])))
    (sequence,) = frames["sequences"]
    first = "none" if sequence["first_detection"] is None else str(sequence["first_detection"])
    return {
        **{
            name: "–" if patch[name] is None else f"{patch[name]:.3f}"
            for name in ("precision", "recall", "f1")
        },
        "falseStatus": f"{frames['false_status']} / {frames['ocean_frames']}",
        "detected": f"{frames['detected']} / {frames['obstacle_frames']}",
        "first": first + (" (before any labelled obstacle)" if sequence["false"] else ""),
    }


def test_the_slider_moves_the_figures_as_python_counts_them(compared, open_page):
    page = open_page(compared.page)
    for index, predictions in enumerate(compared.judged.models):
        form = page.locator("[data-model]").nth(index)
        slider = form.locator('[data-is="slider"]')
        assert form.get_attribute("data-model") == predictions.label
        # It opens at the model's operating point, and says so.
        assert "operating point" in form.locator('[data-is="margin"]').inner_text()
        assert _shown(form) == _expected(compared.judged, index, predictions.rule)
        thresholds = compared.json["explorer"]["models"][predictions.label]["thresholds"]
        assert 0.0 in thresholds and predictions.rule.margin in thresholds
        if predictions.label == THESIS:
            continue  # which sees nothing at all here
        seen = set()
        for step in (thresholds.index(0.0), len(thresholds) * 3 // 4):
            for least, hits, window in ((1, 1, 1), (1, 2, 2), (2, 2, 3), (3, 3, 5)):
                form.locator('[data-is="least"]').fill(str(least))
                form.locator('[data-is="window"]').fill(str(window))
                form.locator('[data-is="hits"]').fill(str(hits))
                slider.fill(str(step))
                now = predictions.rule.instant_margin
                now = now if now is None else max(now, thresholds[step])
                rule = MofNRule(thresholds[step], least, hits, window, now)
                assert _shown(form) == _expected(compared.judged, index, rule), rule
                seen.add(str(_shown(form)))
        assert len(seen) > 4
        form.locator('[data-is="own"]').click()
        assert _shown(form) == _expected(compared.judged, index, predictions.rule)
        slider.press("ArrowRight")
        assert "operating point" not in form.locator('[data-is="margin"]').inner_text()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    embedded = page.evaluate("JSON.parse(document.getElementById('comparison').textContent)")
    assert embedded == compared.json


def test_the_box_switches_off_what_is_enough_at_once(compared, open_page, tmp_path):
    """A rule that confirms next to nothing: what it finds, it finds at once."""
    result = json.loads(json.dumps(compared.json))
    (model,) = (model for model in result["models"] if model["model"] == LBP)
    found = result["explorer"]["models"][LBP]
    zero = found["thresholds"].index(0.0)
    rule = MofNRule(0.0, 50, 9, 9, found["thresholds"][zero + 10])
    found["rule"] = model["rule"] = rule.to_json()
    path = tmp_path / "box.html"
    path.write_text(report_html(replace(compared.judged, read_frame=None), result), "utf-8")
    form = open_page(path).locator("[data-model]").first
    assert form.get_attribute("data-model") == LBP
    box, slider = form.locator('[data-is="at-once"]'), form.locator('[data-is="slider"]')
    assert box.is_checked() and _shown(form) == _expected(compared.judged, 0, rule)
    with_it = _shown(form)["detected"]
    box.uncheck()
    assert "operating point" not in form.locator('[data-is="margin"]').inner_text()
    assert _shown(form) == _expected(compared.judged, 0, replace(rule, instant_margin=None))
    assert with_it != _shown(form)["detected"]
    box.check()
    # Beyond what is enough at once the margin takes it along.
    slider.fill(str(zero + 20))
    margin = found["thresholds"][zero + 20]
    assert float(form.locator('[data-is="sudden"]').inner_text()) == pytest.approx(margin, 1e-3)
    beyond = replace(rule, margin=margin, instant_margin=margin)
    assert _shown(form) == _expected(compared.judged, 0, beyond)


def test_names_from_outside_are_words_and_nothing_else(compared, open_page, tmp_path):
    """A dive may be called anything that a folder can be called."""
    evil = "</script><img src=x onerror=\"alert('x')\">{{ 7 * 7 }}&amp;"
    series = compared.judged.series
    patches = compared.judged.patches.assign(mission=evil)
    series = replace(series, table=series.table.assign(mission=evil))
    judged = replace(compared.judged, patches=patches, series=series, read_frame=None)
    text = json.dumps(compared.json).replace('"tiny"', json.dumps(evil))
    result = json.loads(text) | {"what": evil, "words": [evil], "notes": [evil]}
    result["errors"][0]["label"] = evil
    path = tmp_path / "evil.html"
    path.write_text(report_html(judged, result), "utf-8")
    page = open_page(path)
    assert page.locator(".verdict").inner_text() == evil
    assert page.locator("img[src=x]").count() == 0
    assert page.locator("[data-model]").count() == 2


def _random_dives(judged, white):
    """Two cameras of random patches that persist, with missing frames and some not judged."""
    rng = np.random.default_rng(white)
    kept = np.sort(rng.choice(60, 50, replace=False))
    places = {"camera": np.repeat(["left", "right"], 50), "frame": np.tile(kept, 2)}
    table = pd.DataFrame({"mission": "m", **places, "kind": "ocean", "fold": -1})
    persisting = np.repeat(rng.normal(-0.5, 1, (20, 6)), 5, axis=0)
    scores = persisting + rng.normal(0, 0.7, (100, 6))
    scores[rng.random(scores.shape) < 0.1] = -np.inf
    finite = scores[np.isfinite(scores)]
    said = {"score": finite, "on_grid": scores, "judged": rng.random(100) < 0.95}
    models = [replace(judged.models[0], white=white, **said)]
    truth = rng.random(len(finite)) < 0.5
    return replace(judged, truth=truth, models=models, series=FrameSeries.of(table, step=1))


@pytest.mark.parametrize("white", [1, 2])
def test_the_page_follows_any_rule_as_the_runtime_does(compared, open_page, white):
    page = open_page(compared.page)
    judged = _random_dives(compared.judged, white)
    predictions, data = judged.models[0], explorer_data(judged)
    thresholds = data["models"][LBP]["thresholds"]
    rng, rules, asked = np.random.default_rng(7), [], []
    for _ in range(60):
        step, now = np.sort(rng.integers(thresholds.index(0.0), len(thresholds), 2)).tolist()
        window = int(rng.integers(1, 7))
        hits, least = int(rng.integers(1, window + 1)), int(rng.integers(1, 4))
        now = now if rng.random() < 0.5 else None
        counts = {"least_patches": least, "hits": hits, "window": window}
        margin_now = None if now is None else thresholds[now]
        rules.append(MofNRule(thresholds[step], least, hits, window, margin_now))
        asked.append({"step": step, "now": now, **counts})
    program = """([data, asked]) => {
        Object.assign(explorer, data);
        const model = decoded(Object.keys(explorer.models)[0]);
        return asked.map((rule) => statuses(model, rule));
    }"""
    found = page.evaluate(program, [data, asked])
    told = [replace(predictions, fold_rules=[rule]) for rule in rules]
    expected = [judged.status(one).tolist() for one in told]
    assert found == expected
    assert set(np.ravel(expected)) == {-1, 0, 1}


def test_a_patch_on_both_sides_of_a_missing_frame_is_not_confirmed(compared):
    table = compared.judged.series.table
    rule = MofNRule(0.0, 1, 2, 2)
    series = FrameSeries.of(table.drop(index=20))
    (gap,) = np.flatnonzero(series.gaps)
    judged = np.ones(len(series.table), bool)
    status = statuses(series, np.ones((len(judged), 3)), judged, [rule])
    assert gap == 20 and status[0] == status[gap] == -1
    assert (np.delete(status, [0, gap]) == 1).all()
    judged[30] = False
    status = statuses(series, np.ones((len(judged), 3)), judged, [rule])
    assert status[30:33].tolist() == [-1, -1, 1]


def test_a_fold_is_judged_by_its_own_rule_alone(compared):
    """Over the frames before its first one too, whichever fold these are of."""
    table = compared.judged.series.table.iloc[:4].assign(frame=range(4), fold=[0, 0, 1, 1])
    series, judged = FrameSeries.of(table), np.ones(4, bool)
    scores = np.array([[1, -np.inf], [1, -np.inf], [1, 3], [-1, 1.0]])
    rules = [MofNRule(2.0), MofNRule(0.0, 2, 2, 3)]
    assert statuses(series, scores, judged, rules).tolist() == [0, 0, 0, 1]
    assert statuses(series, scores, judged, rules[:1]).tolist() == [0, 0, 1, 0]


def test_ceilings_are_of_the_same_folds(compared, refused, tiny, no_progress):
    """Gradient boosting by hand; a net says so where it is not installed."""
    command = ("compare", "tiny-lbp", "tiny-thesis", "--workspace", compared.workspace)
    refused("leave out --mission", *command, "--mission", tiny.path, "--ceilings")
    boosted, net = compared.json["ceilings"]
    assert (boosted["model"], net["missing"][:13]) == (LBP, "not installed")
    dataset, table = compared.judged.dataset, compared.judged.patches
    setting = set_up(compared.judged.models[0], dataset, compared.workspace, no_progress)
    place = ["mission", "camera", "frame", "row", "col"]
    found = dataset.patches[place].assign(score=np.nan)
    for fold in setting.split.cut(dataset.patches, setting.targets):
        booster = HistGradientBoostingClassifier(random_state=0)
        booster.fit(setting.features[fold.train], setting.targets[fold.train])
        shares = booster.predict_proba(setting.features[fold.test])[:, 1]
        found.loc[fold.test, "score"] = 2 * shares - 1
    score = table[place].merge(found, on=place).score.to_numpy()
    by_hand = obstacle_metrics(compared.judged.truth, score)
    assert by_hand == {name: boosted["patch"][name] for name in by_hand}


def test_a_small_net_on_the_pixels_learns(compared, told):
    pytest.importorskip("torch", reason="torch is no dependency: development only")
    found = told("compare", *(LBP, THESIS), "--ceilings", "--workspace", compared.workspace)
    assert found["ceilings"][-1]["patch"]["average_precision"] > 0.9


def test_no_false_status_among_no_ocean_frames_is_neither_good_nor_bad(compared):
    def shown(false, ocean):
        result = json.loads(json.dumps(compared.json))
        for model in result["models"]:
            model["frames"] |= {"false_status": false, "ocean_frames": ocean}
        page = report_html(replace(compared.judged, read_frame=None), result)
        return re.search(rf"<td[^>]*>{false} / {ocean}</td>", page)[0]

    assert shown(0, 0) == "<td>0 / 0</td>"
    assert shown(0, 3) == '<td class="good">0 / 3</td>'
    assert shown(1, 3) == '<td class="bad">1 / 3</td>'
