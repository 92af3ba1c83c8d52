"""`make page-times`: everything is measured, and what cannot be is told. No speed is tested."""

import json

import pytest

TIMES = [
    *("first_page", "next_frame", "next_frame_fast", "jump"),
    *("acknowledged", "answered", "other_tab"),
    *("first_page_labelled", "next_frame_labelled", "next_frame_fast_labelled"),
    *("acknowledged_labelled", "answered_labelled"),
]


def test_everything_a_person_waits_for_is_measured(tiny, run_load, tmp_path):
    out = tmp_path / "out"
    options = ("--quick", "--json", "--frames", 30, "--mission", tiny.path, "--out", out)
    ran = run_load("page", *options)
    if "no Chromium" in ran.err:
        pytest.skip(ran.err)
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert [time["name"] for time in found["times"]] == TIMES
    for time in found["times"]:
        assert 0 < time["p50_ms"] <= time["p95_ms"] <= time["worst_ms"] < 60_000
        assert (time["holds"] is None) == (time["asked_ms"] is None)
    assert {time["name"]: time["count"] for time in found["times"]}["next_frame"] == 3
    assert found["frames"] == 30 and found["mission"] == "tiny" and found["effort"] == []
    assert json.loads((out / "label.json").read_text("utf-8")) == found
    assert sorted(path.name for path in out.iterdir()) == ["label.json", "label.png"]
