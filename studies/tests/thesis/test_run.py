"""tokt reproduce as a whole: its files, its report, and how it ends when something is wrong."""

import json
import re
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from tokt.features.common.errors import ToktError
from tokt_studies.thesis import run
from tokt_studies.thesis.exhibits.exhibit import (
    Claim,
    ClaimAgreement,
    Exhibit,
    Plot,
    StudyContext,
    Table,
)
from tokt_studies.thesis.inputs import ReproduceRequest
from tokt_studies.thesis.run import Planned, run_reproduce

pytestmark = pytest.mark.xdist_group("reproduce")
PNG = b"\x89PNG\r\n\x1a\n a picture"


def made(context: StudyContext) -> Exhibit:
    """An exhibit that hangs on the mission."""
    found, agreement = str(len(context.scored)), ClaimAgreement.PARTLY
    claim = Claim("so <many> frames", "9 & more", found, "as counted", agreement=agreement)
    frame = pd.DataFrame({"frame": context.scored, "half": [n / 2 for n in context.scored]})
    frame.loc[0, "half"] = float("nan")
    numbers = {"frames": len(context.scored), "share": 0.5, "unknown": None}
    return Exhibit(
        ("how it was done",), (claim,), (Table("halves", "all of them", frame),),
        (Plot("dots", "some dots", PNG),), numbers,
    )  # fmt: skip


def refused(context: StudyContext) -> Exhibit:
    raise ToktError("it needs a second moon")


PLANNED = (
    Planned("counted", "Counted", "figure 9.9", made),
    Planned("moon", "Two moons", "figure 9.10", refused),
)


@pytest.fixture(scope="module")
def reproduced_files(reproduce_mission, tmp_path_factory):
    out = tmp_path_factory.mktemp("files") / "deep" / "out"
    request = ReproduceRequest(reproduce_mission, out, sample=2, jobs=1)
    lines: list[str] = []
    found = run_reproduce(request, lines.append, lambda items, total, what: items, PLANNED)
    assert any("second moon" in line for line in lines)
    return out, found


def test_everything_is_written(reproduced_files):
    out, found = reproduced_files
    names = sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file())
    assert names == ["counted/dots.png", "counted/halves.csv", "report.html", "results.json"]
    assert (out / "counted" / "dots.png").read_bytes() == PNG
    table = pd.read_csv(out / "counted" / "halves.csv")
    assert table.frame.tolist() == list(range(2, 17))
    assert json.loads((out / "results.json").read_text("utf-8")) == found


def test_results_have_what_was_found(reproduced_files):
    _, found = reproduced_files
    assert found["format"] == 2
    assert found["mission"] == {"name": "dive", "frames": 16, "pairs": 16}
    counted, moon = found["exhibits"]
    assert counted["claims"][0]["agreement"] == "agrees in part"
    assert counted["claims"][0]["found"] == "15"
    assert counted["tables"][0]["rows"][:2] == [[2, None], [3, 1.5]]
    assert moon["missing"] == "it needs a second moon" and moon["key"] == "moon"
    assert any("the mission's frame 1" in line for line in found["about"])


def test_the_report_needs_no_other_file(reproduced_files):
    text = (reproduced_files[0] / "report.html").read_text("utf-8")
    links = re.findall(r'\b(?:href|src)="([^"]*)"', text)
    outside = [link for link in links if not link.startswith(("#", "data:"))]
    assert not outside and "http" not in text.replace("http-equiv", "")
    assert [link[1:] for link in links if link.startswith("#")] == ["counted", "moon"]
    assert {"counted", "moon"} <= set(re.findall(r'\bid="([^"]*)"', text))
    assert "Not made: it needs a second moon" in text
    assert "<h3>Halves</h3>" in text
    assert "so &lt;many&gt; frames" in text and "9 &amp; more" in text
    assert re.search(r'class="partly">agrees in part</td><td>as counted', text)


def test_a_run_that_fails_late_leaves_no_results(reproduce_mission, tmp_path, monkeypatch):
    (tmp_path / "results.json").write_text("{}", "utf-8")

    def full(*given: Any) -> None:
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(run, "_write", full)
    request = ReproduceRequest(reproduce_mission, tmp_path, jobs=1)
    with pytest.raises(OSError, match="No space"):
        run_reproduce(request, print, lambda items, total, what: items, PLANNED)
    assert not (tmp_path / "results.json").exists()


def test_mistakes_are_one_line(reproduce_mission, tmp_path, run_tokt):
    (tmp_path / "file").write_text("", "utf-8")
    missing, frame = tmp_path / "missing", reproduce_mission / "Left" / "sim_L_2.jpg"
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), np.zeros((9, 16), np.uint8))
    for arguments, words in (
        ((missing, "-o", tmp_path / "a"), "does not exist"),
        ((reproduce_mission, "-o", tmp_path / "file"), "is not a folder"),
        ((reproduce_mission, "-o", tmp_path / "a", "--picture-mask", missing), "--picture"),
        (
            (reproduce_mission, "-o", tmp_path / "a", "--picture", frame, "--picture-mask", small),
            "16x9",
        ),
        ((reproduce_mission, "-o", tmp_path / "a", "--other", missing), "missing"),
        ((reproduce_mission, "-o", tmp_path / "a", "--model", missing), "missing"),
    ):
        ran = run_tokt("reproduce", *arguments)
        assert ran.code == 2, ran
        assert ran.err.splitlines()[-1].startswith("tokt: error: ")
        assert words in ran.err.splitlines()[-1]
        assert not list(tmp_path.rglob("results.json"))


def test_json_is_one_object(reproduce_mission, tmp_path, run_tokt, monkeypatch):
    asked: list[ReproduceRequest] = []

    def fake(request: ReproduceRequest, say: Any, progress: Any) -> dict[str, Any]:
        asked.append(request)
        return run_reproduce(request, say, progress, PLANNED)

    monkeypatch.setattr(run, "run_reproduce", fake)
    command = ("reproduce", reproduce_mission, "-o", tmp_path / "out", "--sample", 3, "--jobs", 1)
    ran = run_tokt(*command, "--json")
    assert ran.code == 0, ran.err
    assert json.loads(ran.out)["exhibits"][0]["claims"][0]["found"] == "15"
    assert (asked[0].sample, asked[0].jobs) == (3, 1)
    told = run_tokt(*command)
    assert "agrees in part" in told.out and "not made: it needs a second moon" in told.out
