"""Models of several names: which is better on the same held-out frames, and which is deployed."""

import json
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from tests.calls import call_tokt
from tokt.models.registry.registry import Registry
from tokt.training.evaluation.metrics import obstacle_metrics

LBP, THESIS = "tiny-lbp/1", "rough/1"
FIGURE = r"\d\.\d{3}"


@pytest.fixture(scope="module")
def two(trained, done, tmp_path_factory):
    """Two models of one dataset, and names of their own."""
    workspace = tmp_path_factory.mktemp("names") / ".tokt"
    shutil.copytree(trained, workspace)
    options = ("--extractor", "lbp", "--preset", "thesis", "--name", "rough", "--folds", 3)
    done("train", "tiny", *options, "--embargo", 1, "--workspace", workspace)
    return workspace


@pytest.fixture
def named(two, tmp_path):
    """A copy of them, and commands on it."""
    workspace = tmp_path / ".tokt"
    shutil.copytree(two, workspace)

    def run(*arguments):
        ran = call_tokt(*arguments, "--workspace", workspace)
        print(ran.out, ran.err)
        return ran

    def listed():
        rows = json.loads(run("models", "list", "--json").out)["models"]
        return {f"{row['name']}/{row['version']}": row for row in rows}

    return SimpleNamespace(path=workspace, registry=Registry(workspace), run=run, listed=listed)


def f1_of(registry, label):
    """On the frames of both: the thesis's model learnt from one, which is left out."""
    table, thesis = registry.held_out(label), registry.held_out(THESIS)
    table = table[(table.fold >= 0) & table.frame.isin(thesis.frame[thesis.fold >= 0])]
    return obstacle_metrics((table.target == 1).to_numpy(), table.obstacle_score.to_numpy())["f1"]


def test_a_promotion_is_told_beside_champions_of_other_names(named):
    first = named.run("models", "promote", LBP)
    assert first.code == 0 and "is the champion" not in first.out
    ran = named.run("models", "promote", THESIS)
    assert ran.code == 0 and f"{THESIS} is now rough@champion" in ran.out
    scores = rf"F1 {FIGURE}, AP {FIGURE}"
    said = rf"{LBP} is the champion of tiny-lbp: {scores} on the same 39 frames of tiny; "
    assert re.search(rf"{said}this one {scores}\n", ran.out)
    assert "none of these was deployed from this registry" in ran.out
    # Asked anew, by another alias: each is held against the same alias of others.
    found = json.loads(named.run("models", "promote", LBP, "--to", "trial", "--json").out)
    assert found["others"] == [] and found["outcome"] == "promoted"
    named.run("models", "alias", LBP, "next")
    (other,) = json.loads(named.run("models", "promote", THESIS, "--to", "next", "--json").out)[
        "others"
    ]
    for which, label in (("model", LBP), ("candidate", THESIS)):
        found = other["figures"][which]
        assert found["f1"] == pytest.approx(f1_of(named.registry, label))
        assert found["frames"] == 39 and list(found["dives"]) == ["tiny"]


def test_the_list_has_figures_of_the_same_frames(named):
    ran = named.run("models", "list")
    said = rf"F1 {FIGURE}, AP {FIGURE} on the same 39 frames of tiny\n"
    assert re.search(rf"^rough/1 @challenger  lbp on tiny@\w+  {said}", ran.out, re.M)
    rows = named.listed()
    for label, other in ((LBP, THESIS), (THESIS, LBP)):
        found = rows[label]["held_out"]
        assert found["f1"] == pytest.approx(f1_of(named.registry, label))
        assert (found["frames"], found["with"]) == (39, [other])


def test_what_cannot_be_measured_has_a_dash_and_why(named, trained):
    alone = call_tokt("models", "list", "--workspace", trained)
    said = rf"F1 {FIGURE}, AP {FIGURE} on its own \d+ frames of \w+, which no other model"
    assert re.search(said, alone.out)
    run_id = named.registry.find(THESIS).run_id
    (table,) = named.path.glob(f"mlartifacts/{run_id}/**/held_out.parquet")
    table.unlink()
    ran = named.run("models", "list")
    assert ran.code == 0 and len(re.findall(r"F1 -: ", ran.out)) == 1
    assert "held_out.parquet is missing" in ran.out
    named.run("models", "alias", LBP, "champion")
    ran = named.run("models", "promote", THESIS)
    assert ran.code == 0
    assert f"{LBP} is the champion of tiny-lbp; not compared: model " in ran.out


def test_damaged_datasets_and_records_end_no_list(named):
    named.registry.client.set_model_version_tag("rough", "1", "tokt.deployment.1", "{")
    (info,) = named.path.glob("datasets/*/*/dataset.json")
    info.write_text("{")
    ran = named.run("models", "list")
    assert ran.code == 0 and ran.out.count("is damaged or not a dataset") == 2
    assert "where it was deployed is not known: model rough/1: its tag tokt.deploy" in ran.out


def test_several_dives_are_told_one_by_one(named, monkeypatch):
    def halved(registry, reference, whole=Registry.held_out):
        table = whole(registry, reference)
        return table.assign(mission=np.where(table.frame > 19, "b", "a"))

    shutil.rmtree(named.path / "datasets")
    monkeypatch.setattr(Registry, "held_out", halved)
    named.run("models", "alias", LBP, "champion")
    ran = named.run("models", "promote", THESIS)
    assert "on the same 39 frames, mean of 2 dives; this one F1" in ran.out
    scores = rf"F1 {FIGURE}, AP {FIGURE}"
    each = re.findall(rf"^    (\w): {scores}; this one {scores} on (\d+) frames$", ran.out, re.M)
    assert each == [("a", "18"), ("b", "21")]


def test_a_deployment_is_remembered(named, tmp_path):
    store, other = tmp_path / "ship", tmp_path / "staging"
    assert named.listed()[LBP]["deployments"] == []
    assert named.run("deploy", LBP, store, "--reason", "dive 12", "--accept-blind").code == 0
    (found,) = named.listed()[LBP]["deployments"]
    assert (found["store"], found["why"], found["active"]) == (str(store), "dive 12", True)
    assert re.search(
        rf"\n  deployed to {store} on \d{{4}}-\d\d-\d\d, active there\n",
        named.run("models", "list").out,
    )
    named.run("models", "alias", LBP, "champion")
    assert f"  {LBP} deployed to {store} on" in named.run("models", "promote", THESIS).out
    # The store itself says what is active: also of what was rolled back, or is gone.
    named.registry.record_deployment(THESIS, store, "0" * 64, "")
    (found,) = named.listed()[THESIS]["deployments"]
    assert found["active"] is False and found["words"].endswith(f"not active there: {LBP} is")
    assert named.run("deploy", LBP, other, "--accept-blind").code == 0
    shutil.rmtree(store)
    gone, there = named.listed()[LBP]["deployments"]
    assert gone["active"] is None and gone["words"].endswith("that store cannot be read now")
    assert there["active"] is True


def test_a_registry_that_cannot_be_written_ends_no_deployment(named, tmp_path):
    long = "x" * 200_000
    ran = named.run("deploy", LBP, tmp_path / "ship", "--reason", long, "--accept-blind")
    assert ran.code == 0 and "note: the registry may not remember this deployment: " in ran.err
    assert "Traceback" not in ran.err
