"""`tokt simulate --closed-loop` from the command to its folder."""

import json

import pandas as pd
import pytest

from tests.calls import refused, succeeds
from tokt.studies.simulation import default_model, study
from tokt.studies.simulation.default_model import train_default_model
from tokt.studies.simulation.loop import flight, scenes

pytestmark = pytest.mark.xdist_group("closed_loop")


SMALL = {
    **{"SEEDS": (900_001, 900_002), "FRAMES": 30, "DRIFT_SEEDS": (900_101,), "DRIFT_FRAMES": 8},
    **{"FOLDS": 2, "EMBARGO_FRAMES": 2, "PRESET": "plain"},
}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The default model's own way, on short missions."""
    path = tmp_path_factory.mktemp("model") / "small.tokt"
    said = []
    with pytest.MonkeyPatch.context() as patch:
        for name, value in SMALL.items():
            patch.setattr(default_model, name, value)
        bundle = train_default_model(path, 360, lambda items, *_: items, said.append, jobs=1)
    assert said == ["-- train a model on 3 rendered missions (--model FILE spares it)"]
    assert bundle.data == path.read_bytes() and bundle.name == default_model.NAME
    assert "open-water-900101 8" in bundle.content.card
    return path


def test_a_study(model, tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "START_M", -7.0)
    monkeypatch.setattr(flight, "MAX_S", 13.0)  # into the tower, or beside it by then
    out = tmp_path / "out"
    command = ["simulate", out, "--closed-loop", "--scenes", "tower", "--methods", "texture,none"]
    ran = succeeds(*command, "--seed", 1001, "--runs", 1, "--model", model, "--jobs", 1, "--json")
    said, written = json.loads(ran.out), json.loads((out / "results.json").read_text())
    assert said == written and said["format"] == 1 and said["seeds"] == [1001, 1001]
    texture, none = said["table"]
    assert (texture["method"], texture["runs"], texture["collided"]) == ("texture", 1, 0)
    assert (none["method"], none["runs"], none["collided"]) == ("none", 1, 1)
    avoided, deaf = said["runs"]
    assert avoided["avoidances"] >= 1 and deaf["avoidances"] == deaf["frames"] == 0
    assert deaf["clearance_m"] < 0 < avoided["clearance_m"]
    assert (out / "model.tokt").read_bytes() == model.read_bytes()
    assert list(pd.read_csv(out / "runs.csv").collided) == [False, True]
    assert said["tuned_on_seeds_from"] == 1000
    page = (out / "report.html").read_text()
    assert "Some of these are among them: no test." in page
    assert 'src="http' not in page and (out / "maps" / "tower-texture.png").is_file()


def test_methods_without_a_model_need_none_and_the_seeds_are_said(tmp_path, monkeypatch):
    monkeypatch.setattr(flight, "MAX_S", 0.5)
    monkeypatch.setattr(study, "train_default_model", None)
    about = []
    monkeypatch.setattr(study, "write_report", lambda *given: about.extend(given[-1]))
    out = tmp_path / "out"
    command = ["simulate", out, "--closed-loop", "--scenes", "empty", "--methods", "none"]
    ran = succeeds(*command, "--runs", 2, "--seed", 999, "--jobs", 1)
    split = "Seeds 999 to 1000; planner and scenes were worked out on seeds from 1000 on. Some of"
    assert split in ran.out and about[0].startswith("No model.") and about[1].startswith(split)
    assert json.loads((out / "results.json").read_text())["model"] is None
    assert not (out / "model.tokt").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "disparity,none", "--model", "x.tokt"], "is used by disparity, none"),
        (["--scenes", "reef"], "unknown scene 'reef' (choose from tower,"),
        (["--scenes", "tower,tower"], "name each scene once"),
        (["--scenes", ","], "name each scene once, and at least one"),
        (["--methods", "sonar"], "unknown method 'sonar' (choose from texture,"),
        (["--runs", 0], "at least one run is needed, not 0"),
        (["--seed", -1], "a seed is 0 or more, not -1"),
        (["--width", 90], "frames are 120 to 1360 pixels wide, not 90"),
        (["--frames", 10], "--frames is for a mission, not for --closed-loop"),
        (["--model", "none.tokt"], "none.tokt"),
        (["--jobs", 0], "--jobs"),
    ],
)
def test_what_cannot_be_flown(options, words, tmp_path):
    refused(words, "simulate", tmp_path / "out", "--closed-loop", *options)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_there(tmp_path):
    refused("is there already", "simulate", tmp_path, "--closed-loop")


@pytest.mark.parametrize("name", ["scenes", "methods", "runs", "model"])
def test_options_of_the_closed_loop_alone(name, tmp_path):
    refused(f"--{name} is for --closed-loop", "simulate", tmp_path / "out", f"--{name}", 3)
