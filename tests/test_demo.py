"""The demo: the whole chain on a rendered mission, and on the real one where it is there."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tokt.labels.synthetic.mission import simulate_mission

ROOT = Path(__file__).resolve().parents[1]
MISSION = Path(os.environ.get("TOKT_MISSION", ROOT.parent / "shared" / "mission" / "approach"))


def _demo(*arguments: object) -> dict:
    command = [sys.executable, "-m", "tokt", "demo", "--json", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def _check(result: dict, out: Path) -> None:
    held = result["replay"]
    assert held["frames"] == held["datagrams"] > 0
    assert held["disagreements"] == 0
    assert held["max_abs_difference_of_decision_values"] <= 1e-9
    for figures in result["held_back"].values():
        assert figures["seen_in_training"] == 0
    report = (out / "report.html").read_text("utf-8")
    assert "<script" not in report
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", report), "the report needs other files"
    assert report.count("data:image/jpeg") >= 4 and report.count("data:image/png") == 4
    active = json.loads((out / "store" / "active").read_text())
    assert active["name"] == result["champion"]
    cv = result["cross_validation"]
    best = max(("tower-lbp", "tower-haralick"), key=lambda name: cv[name]["patch"]["f1"])
    assert result["champion"] == best


@pytest.mark.slow
def test_rendered_demo(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = _demo("--out", out, "--frames", 60, "--width", 680)
    _check(result, out)
    assert result["rendered"]
    champion = result["held_back"][result["champion"]]
    assert champion["frames"]["detected"] > 0.8 * champion["frames"]["obstacle_frames"] > 0
    assert "A rendered mission" in (out / "report.html").read_text("utf-8")


def test_demo_empties_only_its_own_folder(tmp_path: Path) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("keep me")
    command = [sys.executable, "-m", "tokt", "demo", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("tokt: error: ") and done.stderr.count("\n") == 1
    assert precious.read_text() == "keep me"


def _refused(*arguments: object) -> str:
    command = [sys.executable, "-m", "tokt", "demo", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("tokt: error: ") and done.stderr.count("\n") == 1
    return done.stderr


def test_an_earlier_demo_survives_a_wrong_command(tmp_path: Path) -> None:
    out = tmp_path / "out"
    mission = out / "synthetic"
    simulate_mission(mission, n_frames=40, width=160)
    (out / "made-by-tokt-demo").write_text("")
    (out / "report.html").write_text("earlier")
    labels = mission / "labels.csv"
    assert "lies in" in _refused("--mission", mission, "--labels", labels, "--out", out)
    elsewhere = tmp_path / "sea"
    mission.rename(elsewhere)
    given = ("--mission", elsewhere, "--out", out)
    assert "does not exist" in _refused(*given, "--labels", tmp_path / "none.csv")
    assert (out / "report.html").read_text() == "earlier"


@pytest.mark.slow
@pytest.mark.mission
@pytest.mark.skipif(not MISSION.is_dir(), reason=f"no real mission at {MISSION} (TOKT_MISSION)")
def test_real_demo(tmp_path: Path) -> None:
    out = tmp_path / "out"
    # Half of the labelled frames: water, the first sight of the tower, its closest view.
    labels = tmp_path / "labels.csv"
    lines = (MISSION / "labels.csv").read_text().splitlines(keepends=True)
    wanted = {*range(60, 100), *range(132, 192)}
    labels.write_text("".join(x for x in lines if x[:3] == "mis" or int(x.split(",")[2]) in wanted))
    result = _demo("--mission", MISSION, "--labels", labels, "--out", out)
    _check(result, out)
    assert not result["rendered"]
    champion = result["held_back"][result["champion"]]
    assert champion["patch"]["f1"] > 0.75
