"""The bench of scale: what it renders, what it watches, and what it says of it."""

import io
import json
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.load.scale import run as scale_run
from tests.load.scale import steps as scale_steps
from tests.load.scale.cost import cost_of
from tests.load.scale.steps import Steps
from tokt.training.fitting.presets import settings_named


def in_this_process(command: list[str]) -> dict[str, dict]:
    """`watched` without the seconds that a process of its own takes to start."""
    _, _, _, folder, dives, frames, *steps = command
    said = io.StringIO()
    with redirect_stdout(said):
        Steps(Path(folder), Path(dives), int(frames)).run(steps)
    lines = [json.loads(line) for line in said.getvalue().splitlines()]
    assert [line["step"] for line in lines] == steps
    return {line.pop("step"): cost_of(np.zeros((1, 4)), **line) for line in lines}


def test_every_step_is_measured_on_what_was_rendered(run_load, tmp_path, monkeypatch):
    monkeypatch.setattr(scale_run, "watched", in_this_process)
    monkeypatch.setattr(scale_steps, "EXTRACTOR", "lbp")
    monkeypatch.setattr(scale_steps, "_SETTINGS", replace(settings_named("water"), landmarks=50))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    out = tmp_path / "out"
    ran = run_load("scale", "--quick", "--frames", 100, "--width", 180, "--out", out, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert json.loads((out / "scale.json").read_text()) == found
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # the temporary folder is gone
    steps = {step["name"]: step["sizes"][0] for step in found["steps"]}
    assert list(steps) == ["build", "features_1_job", "features_2_jobs", "fit", "training"]
    patches = steps["build"]["patches"]
    assert 9000 < patches < 10_000  # some are unsure
    assert all(step["patches"] == patches and step["seconds"] > 0 for step in steps.values())
    for name in ("features_1_job", "features_2_jobs"):
        assert steps[name]["table_mb"] == 10_000 * steps[name]["features"] * 8 / 1e6
    assert steps["training"]["tested"] == patches and steps["training"]["f1"] > 0.5
    assert found["extent"]["width"] == 180
    assert {step["exponent"] for step in found["steps"]} == {None}
