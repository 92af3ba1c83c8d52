"""A model learns a new dive too: old and new together, told by what it had not seen."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mlflow
import numpy as np
import pandas as pd
import pytest

from tests.calls import call_tokt, refuses
from tests.fixtures import quiet, write_labels
from tokt.models.registry.registry import Registry
from tokt.training.datasets.dataset import open_dataset
from tokt.training.datasets.feature_cache import cached_features
from tokt.training.datasets.folds import Dives
from tokt.training.evaluation.metrics import obstacle_metrics
from tokt.training.fitting import adapt
from tokt.training.fitting.adapt import adaptation, adapted_request, known_model
from tokt.training.fitting.classifier import decision_values, fit_rows
from tokt.training.fitting.train import fit_and_measure

FRAMES = (2, 3, 9, 13, 17, 21, 26, 30, 34, 38)
FIGURES = ("f1", "average_precision", "precision", "recall", "false_positive", "false_negative")


@pytest.fixture(scope="module")
def three(tiny_dive, begun, done, told, tmp_path_factory):
    """A model of two dives, which are gone since; a third dive of which some frames are labelled.

    The workspace, what `tokt adapt` told, the new dive, and the old version's dataset.
    """
    folder = tmp_path_factory.mktemp("adapt")
    where = ("--workspace", begun(folder / ".tokt"))
    asked = {"one": (1.0, None), "two": (1.4, None), "night": (0.6, FRAMES)}
    *old, new = (
        (folder / name, tiny_dive(folder / name, range(1, 41), *how)) for name, how in asked.items()
    )

    def build(name, *missions):
        given = [text for path, file in missions for text in ("--mission", path, "--labels", file)]
        return told("dataset", "build", name, *given, "--block", 4, *where)

    before = build("old", *old)
    whole = build("whole", *old, new)
    train = ("--extractor", "lbp", "--preset", "plain", "--embargo", 1, "--confidence", 0.7)
    done("train", "old", *train, "--frame-rule", "2/3", "--name", "tower", *where)
    done("models", "alias", "tower", "champion", *where)
    for path, _ in old:
        shutil.rmtree(path)
    files = folder / "page.html", folder / "tower-1.tokt", folder / "again.tokt"
    done("export", "tower/1", "-o", files[1], *where)
    given = ("--mission", new[0], "--labels", new[1], "--draws", 4, "-o", files[0], *where)
    found = told("adapt", "tower@champion", *given)
    done("export", "tower/1", "-o", files[2], *where)
    return {
        **{"workspace": folder / ".tokt", "found": found, "new": new, "before": before},
        **{"whole": whole, "files": files},
    }


@pytest.fixture
def adapted(three, tmp_path):
    """A copy of its workspace that a test may change."""
    return shutil.copytree(three["workspace"], tmp_path / ".tokt")


@pytest.fixture(scope="module")
def again(three):
    """The same by the functions: the old model, the dataset, what was trained on it, and how."""
    workspace = three["workspace"]
    known = known_model(Registry(workspace), "tower/1", workspace / "datasets")
    data = open_dataset("old", workspace / "datasets")
    times = three["found"]["adaptation"]["times"]
    request = adapted_request(known, data, added={"night": times})
    trained = fit_and_measure(request, workspace / "cache", quiet, 1)
    return known, data, trained, workspace / "cache"


def test_the_new_version_is_of_the_old_frames_and_the_new(three, told):
    workspace, found = three["workspace"], three["found"]
    assert found["dataset_hash"] == three["whole"]["hash"] != three["before"]["hash"]
    names = [f"old@{one}" for one in (three["before"]["hash"][:8], found["dataset_hash"][:8])]
    diff = told("dataset", "diff", *names, "--workspace", workspace)
    assert diff["missions"]["added"] == ["night"] and diff["missions"]["gone"] == []
    added = {
        "frames_added": len(FRAMES),
        "patches_added": found["adaptation"]["labelled"]["patches"],
    }
    assert diff["missions"]["changes"] == {"night": added}
    assert diff["sources"]["gone"] == [] and "mission night" in diff["sources"]["added"]


def test_the_old_model_is_as_it_was_and_the_next_is_trained_as_it_was(three):
    page, before, after = three["files"]
    assert before.read_bytes() == after.read_bytes()
    registry = Registry(three["workspace"])
    new, old = registry.find("tower/2"), registry.find("tower/1")
    assert (old.aliases, new.aliases) == (("champion",), ("challenger",))
    was, now = registry.parameters(old), registry.parameters(new)
    free = {"dataset", "dataset_hash", "penalty_chosen", *(one for one in now if "rule_" in one)}
    free = free - {"target_frame_rule"} | {"split_added"}
    assert {name: was[name] for name in was if name not in free} == {
        name: now[name] for name in now if name not in free
    }
    assert was["target_confidence"] == "0.7" and was["split_by"] == "dive"
    times = three["found"]["adaptation"]["times"]
    assert (was["split_added"], now["split_added"]) == ("{}", f"{{'night': {times}}}")
    assert f"night {times:g} times that" in registry.recipe(new)["metrics"]["split"]
    client = mlflow.MlflowClient(f"sqlite:///{three['workspace']}/mlflow.db")
    kept = Path(client.download_artifacts(new.run_id, "tokt", str(page.parent)))
    assert json.loads((kept / "adaptation.json").read_text()) == three["found"]["adaptation"]
    assert (kept / "adaptation.html").read_text("utf-8") == page.read_text("utf-8")
    assert "WORSE" in page.read_text("utf-8") or "fell by 0.01 in none" in page.read_text("utf-8")


def test_split_and_sites_are_the_models_unless_asked_otherwise(again):
    known, data, trained, _ = again
    assert replace(trained.request.split, added={}) == known.split
    asked = adapted_request(known, data, "block", ["fjord=one,night"]).split
    assert (asked.by, asked.sites) == ("block", {"one": "fjord", "night": "fjord"})
    known = replace(known, split=replace(known.split, sites={"two": "fjord"}))
    assert adapted_request(known, data).split.sites == {"two": "fjord"}
    fewer = SimpleNamespace(classes=lambda: ("clear",))
    refuses("tower/1 does not tell obstacle", adapted_request, replace(known, dataset=fewer), data)


def test_without_a_labelled_frame_it_is_the_old_model(three, again):
    """Fitted anew to the old dives, with its own C, and by the figures of the product."""
    known, data, _, cache = again
    features = cached_features(data, known.bundle.extractor.spec, cache, quiet, 1)
    mission, targets = data.patches.mission.to_numpy(), data.targets()
    rows = np.flatnonzero(mission != "night")
    dives = Dives.of(mission)
    model = fit_rows(features, targets, rows, known.choice, known.settings, (), dives)
    new = mission == "night"
    figures = obstacle_metrics(targets[new] == 1, decision_values(model, features[new])[:, 0])
    first, gained = three["found"]["adaptation"]["curve"][0], three["found"]["adaptation"]["gained"]
    assert {first[key] for key in ("mean", "worst", "before", "queue")} == {figures["f1"]}
    assert gained["before"] == {key: figures[key] for key in FIGURES}


def test_nothing_is_tested_on_what_it_learnt_from(three, again, monkeypatch):
    """Of the new dive neither a frame, its neighbour nor its copy; of the old ones no fold."""
    known, data, _, cache = again
    tasks = []

    def spy(function, given, jobs):
        tasks.extend(given)
        return map(function, given)

    monkeypatch.setattr(adapt, "mapped", spy)
    found = adaptation(known, data, "night", cache, quiet, 4, 1).told
    told = three["found"]["adaptation"]
    assert found == {name: told[name] for name in found if name != "words"} | {
        "words": told["words"][:-1]  # the last one is of the operating point
    }
    mission, frame = data.patches.mission.to_numpy(), data.patches.frame.to_numpy()
    counts = set()
    for fold in (task[2] for task in tasks):
        tested = set(mission[fold.test])
        learnt, seen = (np.unique(frame[rows][mission[rows] == "night"]) for rows in
                        (fold.train, fold.test))  # fmt: skip
        if tested == {"night"}:
            assert np.abs(learnt[:, None] - seen).min() > 1
            assert {"one", "two"} <= set(mission[fold.train])
            counts.add(len(learnt))
        else:
            # Without the new dive first, and then with all of it.
            assert not tested & set(mission[fold.train]) and set(learnt) in (set(), set(FRAMES))
    assert counts >= {1, 2, 3, 5, 8, 9}  # 2 and 3 are neighbours: one of them is left out with both
    assert {choice for _, _, _, choice, *_ in tasks} <= {known.choice, *known.fold_choices}


def test_gained_and_lost_are_what_a_fit_of_ones_own_says(three, again):
    known, data, _, cache = again
    features = cached_features(data, known.bundle.extractor.spec, cache, quiet, 1)
    patches, targets = data.patches, data.targets()
    mission, frame = patches.mission.to_numpy(), patches.frame.to_numpy()
    times = three["found"]["adaptation"]["times"]
    dives = Dives.of(mission, {"night": times})

    def figures(test, left_out, choice):
        rows = np.flatnonzero(~left_out)
        model = fit_rows(features, targets, rows, choice, known.settings, (), dives)
        values = decision_values(model, features[test])[:, 0]
        found = obstacle_metrics(targets[test] == 1, values)
        return {key: found[key] for key in FIGURES}

    told = three["found"]["adaptation"]
    new = mission == "night"
    assert [one["frame"] for one in told["gained"]["frames"]] == [*FRAMES]
    for one in told["gained"]["frames"]:
        left_out = new & (abs(frame - one["frame"]) <= 1)
        assert one["after"] == figures(new & (frame == one["frame"]), left_out, known.choice)
    for name, choice in zip(("one", "two"), known.fold_choices, strict=True):
        assert told["lost"][name]["after"] == figures(mission == name, mission == name, choice)
    held_out = Registry(three["workspace"]).held_out("tower/1")
    one = held_out[held_out.mission == "one"]
    before = obstacle_metrics((one.target == 1).to_numpy(), one.obstacle_score.to_numpy())
    assert told["lost"]["one"]["before"] == {key: before[key] for key in FIGURES}
    # Of what was tried, the most at which the old dives lose little enough.
    held = [one["times"] for one in told["tried"] if not one["worse"]]
    assert told["times"] == max(held) and told["worse"] == []


def test_mislabelled_frames_are_refused_and_forced_with_a_reason(
    three, adapted, tiny_truth, tmp_path, told, refused
):
    """Frames whose classes are swapped: the old dives would lose, and nothing is registered."""
    swapped = {"ocean": "subsea_installation"}
    rows = [
        [*row[:5], swapped.get(row[5], "ocean")]
        for row in tiny_truth.labels("night")
        if row[2] in FRAMES
    ]
    labels, page = write_labels(tmp_path / "swapped.csv", rows), tmp_path / "page.html"
    given = ("--mission", three["new"][0], "--labels", labels, "--draws", 1, "-o", page)
    given += ("--workspace", adapted)
    ran = call_tokt("adapt", "tower/1", *given)
    fault = ran.err.splitlines()[-1]
    assert ran.code == 2 and fault.startswith("tokt: error: no version was registered, because")
    assert "Check the labels of night, or give --force WHY" in fault
    assert "WORSE" in ran.out and "TOO MUCH IS LOST where night counts 1 times" in ran.out
    assert "labels that contradict tower/1" in fault
    assert "tower (refused)" in page.read_text("utf-8")
    registry = Registry(adapted)
    assert [one.label for one in registry.versions("tower")] == ["tower/2", "tower/1"]
    refused("--force needs the reason", "adapt", "tower/1", *given, "--force", " ")
    found = told("adapt", "tower/1", *given, "--force", "a test")["adaptation"]
    assert found["forced"] == "a test" and found["worse"]
    assert [one["times"] for one in found["tried"]] == [1]
    assert registry.find("tower").label == "tower/3"
    # The gate sees the same, on the old dives.
    ran = call_tokt("models", "promote", "tower/3", "--max-ms", 60_000, "--workspace", adapted)
    assert ran.code == 2 and "old dives lose too much: " in ran.err


def test_labels_of_one_side_alone_count_enough_to_show_what_they_cost(
    three, adapted, tiny_truth, tmp_path, refused
):
    """Frames with obstacles of which each patch was labelled as water."""
    rows = [[*row[:5], "ocean"] for row in tiny_truth.labels("night") if row[2] in FRAMES[-5:]]
    labels = write_labels(tmp_path / "wet.csv", rows)
    given = ("--mission", three["new"][0], "--labels", labels, "--draws", 1, "--json")
    ran = call_tokt("adapt", "tower/1", *given, "--workspace", adapted)
    assert ran.code == 2 and "because of what would be lost" in ran.err
    found = json.loads(ran.out)["adaptation"]
    assert min(one["times"] for one in found["tried"]) == 1 and found["worse"]


def test_an_adapted_version_stands_beside_the_old_one_on_the_old_dives(three, told, tmp_path):
    """Their datasets differ; both held out whole dives."""
    where = ("--workspace", three["workspace"])
    found = told("compare", "tower/2", "tower/1", *where, "-o", tmp_path / "page.html")
    assert any("learnt from different datasets" in note for note in found["notes"])
    new, old = found["models"]
    assert set(new["dives"]) == set(old["dives"]) == {"one", "two"}
    lost = three["found"]["adaptation"]["lost"]
    for name in ("one", "two"):
        assert old["dives"][name]["f1"] == lost[name]["before"]["f1"]
        # Its C was chosen anew; `lost` has that of the old folds.
        assert new["dives"][name]["f1"] == pytest.approx(lost[name]["after"]["f1"], abs=0.02)


def test_its_rate_is_unknown_as_its_water_frames_are_not_in_a_row(three):
    assert three["found"]["operating_point"]["chosen"]["rate_unknown_in"] == ["night"]
    assert three["found"]["adaptation"]["rate_unknown"]
    assert "unknown" in three["found"]["adaptation"]["words"][-1]


def test_a_program_measures_what_adapting_gains(three, tiny_truth, tmp_path, told):
    """Docs' table has its lines: before and after are what `tokt evaluate` says of other frames."""
    path, labels = three["new"]
    program = Path(__file__).parents[3] / "docs" / "measure_adaptation.py"
    ran = subprocess.run(
        [sys.executable, program, "tower/1", path, labels, "4,99", three["workspace"]],
        **{"capture_output": True, "text": True, "check": False},
    )
    assert ran.returncode == 0, ran.stderr
    (line,) = ran.stdout.splitlines()  # of 99 frames there are too few
    found = json.loads(line)
    assert (found["mission"], found["labelled"]) == ("night", 4) and found["times"] > 0
    assert found["worst_dive"] in ("one", "two") and found["worst"] <= found["mean"]
    learnt = np.random.default_rng(7).permutation(FRAMES)[:4]
    rows = [one for one in tiny_truth.labels("night") if one[2] in {*FRAMES} - {*learnt.tolist()}]
    others = write_labels(tmp_path / "others.csv", rows)
    given = ("--mission", path, "--labels", others, "--workspace", three["workspace"])
    patch = told("evaluate", "tower/1", *given)["patch"]
    assert found["before"] == [patch["f1"], patch["average_precision"]] != found["after"]


def test_two_neighbour_frames_tell_nothing(three, adapted, tiny_truth, tmp_path, done):
    rows = [row for row in tiny_truth.labels("night") if row[2] in (5, 6)]
    labels = write_labels(tmp_path / "few.csv", rows)
    given = ("--mission", three["new"][0], "--labels", labels, "--draws", 1)
    said = done("adapt", "tower/1", *given, "--workspace", adapted).out
    assert "which did not learn of night" in said
    assert "Gained on night: cannot be told" in said and "labelled frames   F1: mean" in said
    assert "too few frames are labelled" in said


def test_what_the_new_dive_shares_with_the_old_is_not_tested(
    three, adapted, tiny, tiny_dive, tmp_path, told
):
    """Frame 9 is a picture of dive `one`: its block has been learnt from, as good as."""
    path = tmp_path / "copy"
    labels = tiny_dive(path, range(1, 41), 0.6, labelled=FRAMES)
    shutil.copyfile(tiny.path / "Left" / "tiny_L_9.png", path / "Left" / "copy_L_9.png")
    shutil.copyfile(path / "Left" / "copy_L_30.png", path / "Left" / "copy_L_17.png")
    given = ("--mission", path, "--labels", labels, "--draws", 1, "--workspace", adapted)
    found = told("adapt", "tower/1", *given, "--force", "of no consequence")["adaptation"]
    assert found["labelled"]["of_old_blocks"] == 1  # frame 9 alone of block 8 to 11
    tested = [one["frame"] for one in found["gained"]["frames"]]
    assert tested == [frame for frame in FRAMES if frame != 9]
    data = open_dataset("old", adapted / "datasets")
    groups = data.frames.set_index(["mission", "frame"]).group
    assert groups["copy", 9] == groups["one", 9] and groups["copy", 17] == groups["copy", 30]


def test_what_cannot_be_adapted_is_refused_in_one_line(three, adapted, tiny, tmp_path, refused):
    where, (path, labels) = ("--workspace", adapted), three["new"]
    first = f"label six of its frames: tokt label {path} --model tower. Key q"
    refused("no label store", "adapt", "tower", "--mission", path, *where)
    refused(first, "adapt", "tower", "--mission", path, *where)
    other = write_labels(tmp_path / "o.csv", [["other", "left", 1, 0, 0, "ocean"]])
    elsewhere = ("--mission", path, "--labels", tiny.labels, "--labels", other, *where)
    named = "(labels are of other, tiny: if one is meant, give NAME=DIR): label some, or import a"
    refused(f"{named} file (tokt labels import); {first}", "adapt", "tower", *elsewhere)
    unsure = write_labels(tmp_path / "u.csv", [["night", "left", 1, 0, 0, "unsure"]])
    refused("no patch of mission 'night' has a sure label; label six",
            "adapt", "tower", "--mission", path, "--labels", unsure, *where)  # fmt: skip
    given = ("--mission", path, "--labels", labels, *where)
    refused("has frames of mission 'night' already", "adapt", "tower/2", *given)
    refused("no model 'none'", "adapt", "none", *given)
    twice = tmp_path / "missions.toml"
    twice.write_text("".join(f'[[mission]]\nname = "{n}"\ndir = "{path}"\nlabels = "{labels}"\n'
                             for n in ("a", "b")))  # fmt: skip
    refused("one new dive at a time", "adapt", "tower", "--mission", twice, *where)
    (table,) = (adapted / "datasets" / "old").glob(f"{three['before']['hash'][:16]}/patches.*")
    pd.read_parquet(table).replace("ocean", "reef").to_parquet(table)
    refused("has been changed on disk", "adapt", "tower/1", *given)


def test_a_model_of_one_dive_learns_a_second(workspace, three, told):
    """Then whole dives are held out; what is lost is told of the blocks that it held out."""
    given = ("--mission", three["new"][0], "--labels", three["new"][1], "--draws", 1)
    given += ("--workspace", workspace)
    before = Registry(workspace).recipe(Registry(workspace).find("tiny-lbp"))["metrics"]["patch"]
    found = told("adapt", "tiny-lbp", *given)
    assert "whole dives" in found["cv"]["split"] and found["model"]["version"] == "2"
    assert found["adaptation"]["lost"]["tiny"]["before"]["f1"] == before["f1"]
