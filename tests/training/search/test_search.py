"""`tokt search`: the rule, the space, and a search that is stopped, or killed, and goes on."""

import json
import math
import os
import shutil
import signal
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import f1_score

from tests.calls import refuses
from tests.forking import ForkHost
from tests.tiers import scaled
from tests.waiting import MAX_S
from tokt.features.common.errors import ToktError
from tokt.features.extractors.extractor import build_extractor, extractor_named
from tokt.models.registry.registry import Registry
from tokt.training.fitting.presets import Hyperparameters, extractor_for, settings_named
from tokt.training.search.mlflow_runs import SEARCH_TAG, TRIAL_TAG
from tokt.training.search.score import (
    MAX_GIVEN_UP,
    BlockConfusion,
    f1_of_counts,
    honest_score,
    ranked,
    winner,
)
from tokt.training.search.search import Budget, budget_from
from tokt.training.search.space import BUILT_IN, Trial, read_space
from tokt.training.search.state import opened_state, read_finished

SPACE = """
format = 1
penalties = [1.0]
class_weights = ["none"]

[extractors]
fine = { name = "lbp", version = 1, points = 4, radius = 1, border = "patch", image = PLAIN }
coarse = "lbp"
both = "lbp_10_5+haralick"
dead = "spec:dead.json"
""".replace("PLAIN", '{ resize = "area", gray = "bt601" }')
DULL = {
    **{"resize": "area_deep", "gray": "bt601", "smooth": 1, "gain": 1e-6, "levels": 32},
    "flatten": {"window": 9, "by": "frame"},
}
DEAD = {"name": "haralick", "version": 1, "ignore_zeros": False, "image": DULL}
"""Sees every picture as the same gray."""
SPLIT = ("--folds", 3, "--embargo", 1)


@pytest.fixture(scope="module")
def space_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("space") / "space.toml"
    path.write_text(SPACE, "utf-8")
    (path.parent / "dead.json").write_text(json.dumps(DEAD), "utf-8")
    return path


def test_a_space_goes_from_simple_to_rich(space_file):
    space = read_space(space_file)
    simple_to_rich = [("fine", 6, 1), ("coarse", 12, 1), ("dead", 13, 1), ("both", 25, 1)]
    assert [(t.name, t.features, t.pictures) for t in space.trials] == simple_to_rich
    assert space.settings.choices == (Hyperparameters(1.0, None),)
    assert space.trials[2].spec == build_extractor(DEAD).spec
    assert space.trials[3].spec == extractor_named("lbp_10_5+haralick").spec


def test_the_built_in_space_has_preset_best_in_it():
    space = read_space(BUILT_IN)
    costs = [trial.cost for trial in space.trials]
    assert costs == sorted(costs)
    specs = [trial.spec for trial in space.trials]
    assert extractor_for("haralick", "best").spec in specs
    assert replace(space.settings, preset="best") == settings_named("best")


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("format = 1", "format = 2", "format = 1"),
        ("penalties = [1.0]", "penalties = []", "penalties is a list"),
        ("penalties = [1.0]", "penalties = [nan]", "penalties: a number above 0"),
        ("penalties = [1.0]", "penalties = " + "[" * 3000, "not a TOML file"),
        ("penalties = [1.0]", "", "missing: penalties"),
        ('["none"]', '["heavy"]', "class_weights is a list"),
        ("[extractors]", "[extractor]", "extractor"),
        ('coarse = "lbp"', 'coarse = "lpb"', "extractor coarse: unknown extractor 'lpb'"),
        ("spec:dead.json", "spec:none.json", "none.json"),
        ('coarse = "lbp"', 'coarse = "lbp"\nagain = "lbp_10_5"', "are the same"),
        ("points = 4", "points = 3", "extractor fine: lbp: 3 points"),
        ("[extractors]", 'changes = ["gain"]\n[extractors]', "no picture change 'gain'"),
        ("[extractors]", "landmarks = -1\n[extractors]", "landmarks: a whole number"),
    ],
)
def test_a_wrong_space_is_one_line(tmp_path, before, after, said):
    assert before in SPACE
    (tmp_path / "dead.json").write_text(json.dumps(DEAD), "utf-8")
    path = tmp_path / "space.toml"
    path.write_text(SPACE.replace(before, after), "utf-8")
    assert said in refuses(r"space\.toml", read_space, path)


def test_budgets():
    asked = {"30m": Budget(1800.0), "2h": Budget(7200.0), "12": Budget(None, 12), None: Budget()}
    assert {text: budget_from(text) for text in asked} == asked
    for text in ("", "0", "1.5h", "10d", "٣m"):
        refuses("budget", budget_from, text)


@settings(max_examples=scaled(50))
@given(st.integers(2, 4), st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=30))
def test_f1_is_scikit_learns(classes, pairs):
    counts = np.zeros((classes, classes), np.int64)
    pairs = [(truth % classes, said % classes) for truth, said in pairs]
    for truth, said in pairs:
        counts[truth, said] += 1
    truths, saids = [truth for truth, _ in pairs], [said for _, said in pairs]
    if classes == 2:
        expected = f1_score(truths, saids, zero_division=math.nan) if pairs else math.nan
    else:
        present = sorted(set(truths))
        each = {"labels": present, "average": "macro", "zero_division": 0.0}
        expected = f1_score(truths, saids, **each) if pairs else math.nan
    assert f1_of_counts(counts) == pytest.approx(expected, nan_ok=True)


def made(hits, missed, folds=None):
    """A tally with a block an entry: so many obstacle patches found and missed."""
    counts = np.array([[[10, 0], [miss, hit]] for hit, miss in zip(hits, missed, strict=True)])
    blocks = np.arange(len(hits))
    return BlockConfusion(blocks, np.array(folds or [0] * len(hits)), counts, len(hits))


def trial(name, features):
    return Trial(name, {"name": name}, features, 1)


BEST = made([9, 10, 8, 10, 9, 10], [1, 0, 2, 0, 1, 0])
EQUAL_BUT_FOR_NOISE = made([10, 9, 9, 9, 9, 10], [0, 1, 1, 1, 1, 0])
WORSE = made([7, 8, 6, 8, 7, 8], [3, 2, 4, 2, 3, 2])


def test_the_simplest_within_one_standard_error_wins():
    tallies = {trial("rich", 50): BEST, trial("middle", 20): EQUAL_BUT_FOR_NOISE}
    ranks = ranked({**tallies, trial("poor", 5): WORSE})
    assert [rank.trial.name for rank in ranks] == ["poor", "middle", "rich"]
    assert [rank.within for rank in ranks] == [False, True, True]
    assert winner(ranks).trial.name == "middle"
    one, other = trial("a", 5), trial("b", 5)  # the order does not matter
    assert winner(ranked({other: BEST, one: BEST})).trial == one


def test_a_shortfall_that_is_the_same_in_every_block_is_no_noise():
    """Blocks differ from each other by far more than the trials do: it is paired."""
    hits, missed = [50, 10, 90, 30], [50, 90, 10, 70]
    less = made([hit - 2 for hit in hits], [miss + 2 for miss in missed])
    ranks = ranked({trial("simple", 5): less, trial("rich", 50): made(hits, missed)})
    simple = ranks[0]
    assert simple.shortfall < simple.standard_error / 2
    assert simple.shortfall > simple.shortfall_error
    assert winner(ranks).trial.name == "rich"


def test_a_large_standard_error_buys_no_large_shortfall():
    """Few blocks that go either way: within one standard error, and yet far below."""
    simple, rich = made([10, 5, 10], [0, 5, 0]), made([9, 10, 9], [1, 0, 1])
    ranks = ranked({trial("simple", 5): simple, trial("rich", 50): rich})
    assert MAX_GIVEN_UP < ranks[0].shortfall < ranks[0].shortfall_error
    assert winner(ranks).trial.name == "rich"


def test_the_standard_error_is_that_of_whole_blocks():
    """Patches of a block agree with each other: counting patches alone would say much less."""
    blocks = [100, 0] * 10
    told = made(blocks, blocks[::-1])
    recalls = np.array(blocks) / 100
    of_mean = recalls.std(ddof=1) / math.sqrt(len(recalls))
    # F1 with no false alarm is 2r / (1 + r): its slope at r = 1/2 is 8/9.
    assert told.standard_error == pytest.approx(8 / 9 * of_mean, rel=0.15)
    assert BlockConfusion.from_json(json.loads(json.dumps(told.to_json()))).score == told.score


def test_the_honest_score_takes_what_each_training_part_chose():
    """Inside fold 0 `b` looks better, inside fold 1 `a`; each is then scored where it is worse."""
    a, b = trial("a", 5), trial("b", 6)
    whole = {a: made([10, 2], [0, 8], [0, 1]), b: made([4, 10], [6, 0], [0, 1])}
    inside = [{a: WORSE, b: BEST}, {a: BEST, b: WORSE}]
    honest = honest_score(whole, inside)
    assert honest["chosen"] == ["b", "a"]
    assert honest["score"] == pytest.approx(2 * 6 / (2 * 6 + 14))


def test_by_dive_the_score_is_the_mean_of_the_dives():
    """A long dive, a short one, and one without water, which has no score of its own."""
    counts = np.array([[[80, 0], [20, 80]], [[4, 4], [2, 2]], [[0, 0], [50, 1]]])
    told = BlockConfusion(np.arange(3), np.array([0, 1, 2]), counts, 3, by_dive=True)
    assert told.score == pytest.approx((160 / 180 + 4 / 10) / 2)
    assert BlockConfusion.from_json(json.loads(json.dumps(told.to_json()))).score == told.score
    assert set(np.round(told.replicates()[np.isfinite(told.replicates())], 3)) >= {0.4, 0.889}
    a, b = trial("a", 5), trial("b", 6)
    better = replace(told, counts=counts[[0, 0, 2]])
    inside = [{a: BEST, b: WORSE}, {a: WORSE, b: BEST}, {a: BEST, b: WORSE}]
    honest = honest_score({a: told, b: better}, inside)
    assert honest["score"] == pytest.approx(160 / 180)


FORMAT_1 = """{
 "format": 1,
 "choices": [[0.1, null], [1.0, "balanced"]],
 "seconds": 1.5,
 "tally": {"n_blocks": 3, "blocks": [0, 2], "folds": [0, 1],
  "counts": [[[5, 1], [2, 2]], [[7, 0], [0, 1]]]}
}
"""


def test_a_trial_of_format_1_is_read(tmp_path):
    path = tmp_path / "trial.json"
    path.write_text(FORMAT_1, "utf-8")
    finished = read_finished(path)
    assert finished.choices == (Hyperparameters(0.1), Hyperparameters(1.0, "balanced"))
    assert finished.tally.score == pytest.approx(2 * 3 / (2 * 3 + 1 + 2))
    assert finished.tally.folds.tolist() == [0, 1] and not finished.tally.by_dive


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('"format": 1', '"format": 2', "newer than this tokt reads"),
        ("{", "", "damaged"),
        ('"blocks": [0, 2]', '"blocks": [0, 3]', "damaged"),
        ("[[5, 1], [2, 2]]", "[[5, 1], [2, -2]]", "damaged"),
        ('"seconds": 1.5,', "", "damaged"),
    ],
)
def test_a_trial_that_is_not_whole_is_one_line(tmp_path, before, after, said):
    assert before in FORMAT_1
    path = tmp_path / "trial.json"
    path.write_text(FORMAT_1.replace(before, after, 1), "utf-8")
    refuses(said, read_finished, path)


def test_state_belongs_to_one_question_and_one_process(tmp_path):
    def opened(question, fresh=False):
        return opened_state(tmp_path, {"asked": question}, "sea", fresh=fresh)

    with opened("one") as state:
        state.trial_file("x").parent.mkdir()
        state.trial_file("x").write_text(FORMAT_1, "utf-8")
        with pytest.raises(ToktError, match="another process is at this search"), opened("one"):
            pass
        with opened("another") as other:
            assert other.folder != state.folder
    with opened("one") as again:
        assert again == state
        assert again.trial_file("x").exists()
    with opened("one", fresh=True) as new:
        assert new.id != state.id
        assert not new.trial_file("x").exists()


def test_state_of_a_newer_tokt_is_one_line(tmp_path):
    with opened_state(tmp_path, {}, "sea", fresh=False) as state:
        header = state.folder / "search.json"
    header.write_text(header.read_text().replace('"format": 1', '"format": 2'), "utf-8")
    again = opened_state(tmp_path, {}, "sea", fresh=False)
    refuses("newer than this tokt reads", again.__enter__)


def begin_with_tiny(begun, trained, workspace):
    """A new workspace with the tiny dataset."""
    shutil.copytree(trained / "datasets", begun(workspace) / "datasets")


@pytest.fixture(scope="module")
def searched(begun, trained, tmp_path_factory, done, told, space_file):
    """A search of the tiny mission in two runs, stopped by its budget in between."""
    workspace = tmp_path_factory.mktemp("searched") / ".tokt"
    begin_with_tiny(begun, trained, workspace)
    command = ("search", "tiny", "--space", space_file, *SPLIT, "--workspace", workspace)
    first = done(*command, "--budget", 1)
    return workspace, command, first, told(*command, "--nested")


def search_runs(workspace):
    registry = Registry(workspace)
    return list(registry.client.search_runs([registry.experiment_id()]))


def test_a_budget_stops_and_an_extractor_that_cannot_be_tried_stops_no_other(searched):
    """One that sees every picture as the same gray has nothing to learn from."""
    _, _, first, result = searched
    assert "1 of 4 tried; the same command tries the rest" in first.out
    assert "trials: 1/1" in first.err
    assert (result["tried"], result["trials"]) == (3, 4)
    assert set(result["faults"]) == {"dead"}
    assert {rank["extractor"] for rank in result["ranks"]} == {"fine", "coarse", "both"}


def test_the_winner_is_registered_with_where_it_comes_from(searched):
    workspace, _, _, result = searched
    label = f"{result['model']['name']}/{result['model']['version']}"
    assert label.startswith("tiny-search/")
    assert result["model"]["aliases"] == ["challenger"]
    registry = Registry(workspace)
    recipe = registry.recipe(registry.find(label))
    assert recipe["provenance"]["search"] == result["search"]
    assert recipe["provenance"]["preset"] == "search"
    assert recipe["extractor"] == result["winner"]["spec"]
    assert "CHOSEN ON THESE FOLDS" in recipe["metrics"]["split"]
    assert "3 tried" in recipe["metrics"]["split"]
    # What a trial is scored by is what training measures: the same folds, the same choices.
    assert result["winner"]["score"] == pytest.approx(result["cv"]["patch"]["f1"], abs=1e-12)
    spec_file = extractor_named(f"spec:{result['winner_file']}")
    assert spec_file.spec == result["winner"]["spec"]


def test_the_rule_is_written_down_before_a_trial_is_run(searched):
    _, _, _, result = searched
    folder = Path(result["folder"])
    header = folder / "search.json"
    assert json.loads(header.read_text("utf-8"))["question"]["rule"] == result["rule"]
    trials = list((folder / "trials").iterdir())
    assert len(trials) == 3
    assert header.stat().st_mtime_ns <= min(path.stat().st_mtime_ns for path in trials)


def test_runs_are_parent_and_children_once(searched, told):
    workspace, command, _, result = searched
    before = search_runs(workspace)
    repeated = told(*command, "--nested")
    assert repeated["model"] == result["model"]
    assert repeated["ranks"] == result["ranks"]
    runs = search_runs(workspace)
    assert len(runs) == len(before)
    mine = [run for run in runs if run.data.tags.get(SEARCH_TAG) == result["search"]]
    (parent,) = [run for run in mine if TRIAL_TAG not in run.data.tags]
    children = [run for run in mine if TRIAL_TAG in run.data.tags]
    assert parent.info.run_id == result["parent_run_id"]
    assert parent.data.params["rule"] == result["rule"]
    assert parent.data.metrics["winner_score"] == result["winner"]["score"]
    assert {run.data.params["extractor"] for run in children} == {"fine", "coarse", "both"}
    assert len(children) == 3
    below = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert {run.info.run_id for run in children} < {run.info.run_id for run in below}
    assert result["run_id"] in {run.info.run_id for run in below}
    assert {run.info.status for run in mine} == {"FINISHED"}


def finished_trials(folder):
    """What is kept of each trial, but how long it took."""
    found = {}
    for path in sorted(folder.glob("trials/[!.]*.json")):
        found[str(path.relative_to(folder))] = json.loads(path.read_text("utf-8"))
        found[str(path.relative_to(folder))].pop("seconds")
    return found


def model_bytes(workspace, result):
    model = Registry(workspace).bundle(result["model"]["name"]).content.model
    return model.weights.tobytes(), model.bias.tobytes()


@pytest.mark.process
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_twice_it_ends_the_same(searched, begun, trained, tmp_path, preload):
    """SIGKILL after the first trial, and before the winner is trained."""
    workspace, command, _, expected = searched
    other = tmp_path / ".tokt"
    begin_with_tiny(begun, trained, other)
    words = [str(word).replace(str(workspace), str(other)) for word in command]
    codes = []
    with closing(ForkHost(preload)) as host:
        for awaited in ("*/trials/[!.]*.json", "*/winner.json", None):
            run = host.start(*words, "--json", "--jobs", 1)
            while awaited and run.poll() is None:
                if list((other / "searches").glob(awaited)):
                    run.kill()
                time.sleep(0.002)
            with run.stdout, run.stderr:
                result = run.stdout.read()
                codes.append(run.wait(MAX_S))
    assert codes == [-signal.SIGKILL, -signal.SIGKILL, 0]
    result = json.loads(result)
    for same in ("search", "winner", "ranks", "faults"):
        assert result[same] == expected[same]
    assert finished_trials(Path(result["folder"])) == finished_trials(Path(expected["folder"]))
    assert not list(other.rglob(".partial-*.json"))
    assert model_bytes(other, result) == model_bytes(workspace, expected)
    runs = [run for run in search_runs(other) if run.data.tags.get(SEARCH_TAG) == result["search"]]
    assert len(runs) == 1 + 3
    assert {run.info.status for run in runs} == {"FINISHED"}
