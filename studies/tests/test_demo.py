"""The demo: the whole chain on a rendered mission, and on the real one where it is there."""

import json
import re

from tests.calls import refused, succeeds


def _check(result, out):
    held = result["replay"]
    # v1 has no word for unknown: a frame rule's wait after a gap between held-back blocks.
    assert held["frames"] == held["datagrams"] + held["unknown"]
    assert held["datagrams"] > 0.7 * held["frames"]
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


def test_rendered_demo(tmp_path):
    out = tmp_path / "out"
    ran = succeeds("demo", "--json", "--out", out, "--frames", 60, "--width", 360)
    result = json.loads(ran.out)
    _check(result, out)
    assert result["rendered"]
    frames = result["held_back"][result["champion"]]["frames"]
    assert frames["detected"] > 0.5 * frames["obstacle_frames"] > 0
    # A k-of-n rule calls the first alarm after a gap unknown, and not clear.
    assert frames["detected"] + frames["unknown"] > 0.8 * frames["obstacle_frames"]
    assert "A rendered mission" in (out / "report.html").read_text("utf-8")


def test_demo_empties_only_its_own_folder(tmp_path):
    precious = tmp_path / "precious.txt"
    precious.write_text("keep me")
    assert refused("", "demo", "--out", tmp_path).count("\n") == 1
    assert precious.read_text() == "keep me"


def test_an_earlier_demo_survives_a_wrong_command(own_tiny, tmp_path):
    out = tmp_path / "out"
    mission = out / "synthetic"
    out.mkdir()
    own_tiny.path.rename(mission)
    (out / "made-by-tokt-demo").write_text("")
    (out / "report.html").write_text("earlier")
    labels = mission / "labels.csv"
    inside = ("--mission", mission, "--labels", labels, "--out", out)
    assert refused("lies in", "demo", *inside).count("\n") == 1
    named = ("--mission", f"dive={mission}", *inside[2:])
    assert refused("lies in", "demo", *named).count("\n") == 1
    elsewhere = tmp_path / "sea"
    mission.rename(elsewhere)
    given = ("--mission", elsewhere, "--out", out)
    said = refused("does not exist", "demo", *given, "--labels", tmp_path / "none.csv")
    assert said.count("\n") == 1
    assert (out / "report.html").read_text() == "earlier"
