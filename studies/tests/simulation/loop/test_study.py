"""`tokt simulate --closed-loop` from the command to its folder."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.calls import refused, refuses, succeeds
from tokt import __version__
from tokt_studies.simulation import default_model, study
from tokt_studies.simulation.default_model import train_default_model
from tokt_studies.simulation.loop import flight, scenes
from tokt_studies.simulation.loop import track as loop_track
from tokt_studies.simulation.loop.track import Track

ROOT = Path(__file__).parents[4]
WIDTH = 240  # pixels: flights of smaller frames cost less
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
        bundle = train_default_model(path, WIDTH, lambda items, *_: items, said.append, jobs=1)
    assert said == ["-- train a model on 3 rendered missions (--model FILE spares it)"]
    assert bundle.data == path.read_bytes() and bundle.name == default_model.NAME
    assert "open-water-900101 8" in bundle.content.card
    return path


def test_a_study(model, tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "START_M", -5.0)
    monkeypatch.setattr(flight, "MAX_S", 10.0)  # into the tower, or beside it by then
    out = tmp_path / "out"
    command = ["simulate", out, "--closed-loop", "--scenes", "tower", "--width", WIDTH]
    command += ["--methods", "texture,none", "--seed", 1001, "--runs", 1, "--model", model]
    ran = succeeds(*command, "--jobs", 1, "--json")
    said, written = json.loads(ran.out), json.loads((out / "results.json").read_text())
    assert said == written and said["format"] == 1 and said["seeds"] == [1001, 1001]
    texture, none = said["table"]
    assert (texture["method"], texture["runs"], texture["collided"]) == ("texture", 1, 0)
    assert (none["method"], none["runs"], none["collided"]) == ("none", 1, 1)
    avoided, deaf = said["runs"]
    assert avoided["avoidances"] >= 1 and deaf["avoidances"] == deaf["frames"] == 0
    assert deaf["clearance_m"] < 0 < avoided["clearance_m"]
    assert (out / "model.tokt").read_bytes() == model.read_bytes()
    assert said["versions"] == [__version__]
    assert list(pd.read_csv(out / "runs.csv").collided) == [False, True]
    assert said["tuned_on_seeds_from"] == 1000
    page = (out / "report.html").read_text()
    assert "Some of these are among them: no test." in page
    assert 'src="http' not in page and (out / "maps" / "tower-texture.png").is_file()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "disparity,none", "--model", "x.tokt"], "is used by disparity, none"),
        (["--scenes", "reef"], "unknown scene 'reef' (choose from tower,"),
        (["--scenes", ","], "name each scene once, and at least one"),
        (["--planner", "helm"], "unknown planner 'helm' (choose from tokt, labview,"),
        (["--scenes", "anchor", "--planner", "labview"], "scene anchor has a planner of its own"),
        (["--runs", 0], "at least one run is needed, not 0"),
        (["--frames", 10], "--frames is for a mission, not for --closed-loop"),
    ],
)
def test_what_cannot_be_flown(options, words, tmp_path):
    refused(words, "simulate", tmp_path / "out", "--closed-loop", *options)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_there(tmp_path):
    refused("is there already", "simulate", tmp_path, "--closed-loop")


def test_a_study_goes_on_where_it_stopped_and_others_join_it(tmp_path, monkeypatch):
    monkeypatch.setattr(flight, "MAX_S", 0.5)
    out, flown = tmp_path / "out", []
    real = study.fly

    def counted(scene, *how):
        flown.append((scene.name, scene.seed))
        return real(scene, *how)

    monkeypatch.setattr(study, "fly", counted)
    command = ["simulate", out, "--closed-loop", "--methods", "none", "--jobs", 1, "--json"]
    succeeds(*command, "--scenes", "empty", "--runs", 2)
    assert flown == [("empty", 1), ("empty", 2)]
    (out / "flights" / "empty-none-2.npz").unlink()
    (out / "results.json").unlink()
    said = json.loads(succeeds(*command, "--scenes", "empty,snow", "--runs", 2).out)
    assert flown[2:] == [("empty", 2), ("snow", 1), ("snow", 2)]
    assert [row["scene"] for row in said["table"]] == ["empty", "snow"]
    # A later command's report is of all that is there.
    said = json.loads(succeeds(*command, "--scenes", "snow", "--runs", 1).out)
    assert len(flown) == 5 and len(said["runs"]) == 4
    refused("360 px wide, not 400", *command[:-1], "--scenes", "snow", "--width", 400)


def test_the_page_has_the_study_s_figures_and_keeps_its_words(tmp_path, monkeypatch):
    monkeypatch.setattr(flight, "MAX_S", 0.5)
    page, path = tmp_path / "page.md", ROOT / "docs" / "make_closed_loop_page.py"
    spec = importlib.util.spec_from_file_location("make_closed_loop_page", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert script.PAGE.read_text(encoding="utf-8").count(script.BEGIN) == 1
    out = tmp_path / "out"
    command = ["simulate", out, "--closed-loop", "--jobs", 1, "--runs", 1]
    command += ["--scenes", "empty,floor", "--width", WIDTH]
    assert "false avoidance in   -" in succeeds(*command, "--methods", "disparity,none").out
    monkeypatch.setattr(script, "PAGE", page)
    monkeypatch.setattr(script, "DEFAULT", "disparity")
    page.write_text(f"Before.\n{script.BEGIN}old\n{script.END}After.\n", encoding="utf-8")
    for _ in range(2):
        script.main(out)
        text = page.read_text(encoding="utf-8")
        assert text.startswith("Before.\n") and text.endswith("After.\n") and "old" not in text
        assert "| 0 of 1 (0.0 to 97.5 %) |" in text and "| 0, 0, 0 of 1 |" in text
        assert "| - |" in text and "| 0, 0, - of 1 |" in text, "the ground is always in view"
        assert f"Seeds from 1 to 1, of frames {WIDTH} pixels wide. tokt {__version__} flew" in text


def test_a_track_of_yesterday_is_read_and_of_tomorrow_refused():
    track = flight.fly(scenes.draw_scene("snow", 3, 360), "none")
    data = track.to_bytes({"width": 360})
    again, about = Track.from_bytes(data)
    assert about == {"width": 360} and again.seed == 3 and again.title == track.title
    assert np.array_equal(again.position, track.position) and again.reached == track.reached
    assert again.to_bytes(about) == data
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_track, "TRACK_FORMAT", 2)
        refuses("of another format than 2", Track.from_bytes, data)


@pytest.mark.parametrize("name", ["scenes", "methods", "runs", "model", "planner"])
def test_options_of_the_closed_loop_alone(name, tmp_path):
    refused(f"--{name} is for --closed-loop", "simulate", tmp_path / "out", f"--{name}", 3)
