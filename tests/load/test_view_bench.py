"""The bench of the live view in small: every condition has its frames, and what failed is said."""

import json

from tests.load.view import latency
from tests.load.view.latency import CLIENTS, NONE, VIEW


def test_all_conditions_are_measured_by_turns(run_load, tmp_path, monkeypatch):
    monkeypatch.setattr(latency, "ASKED", 1000.0)
    ran = run_load("view", "--quick", "--out", tmp_path, "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert json.loads((tmp_path / "view.json").read_text()) == found
    counts = {each["name"]: each["count"] for each in found["times"]}
    assert counts == {NONE: 8, VIEW: 8, CLIENTS: 8, "handing over": 16}
    assert all(each["p50_ms"] > 0 for each in found["times"])
    assert list(found["growth"]) == [VIEW, CLIENTS] and found["told"] == []
    assert len(found["growth"][CLIENTS]["all"]) == 2
    assert found["extent"]["stalled"] == 1 and found["holds"]


def test_a_latency_that_grew_is_a_fault(run_load, tmp_path, monkeypatch):
    monkeypatch.setattr(latency, "ASKED", -2.0)
    ran = run_load("view", "--quick", "--rounds", 1, "--out", tmp_path, "--json")
    assert ran.code == 1 and "grew by more than asked" in ran.err
