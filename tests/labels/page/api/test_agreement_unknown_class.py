"""Conflicts about a class that left the taxonomy are seen and settled like any other."""

from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.store import LabelStore

SAID = {0: ("ocean", "ocean"), 1: ("reef", "kelp"), 2: ("kelp", "kelp"), 3: ("kelp", "sand")}


def test_conflicts_of_a_class_that_is_gone_are_told_and_settled(page_server, tmp_path):
    with LabelStore(tmp_path / "labels.db") as store:
        store.add(
            LabelRecord("tiny", "left", 1, Grid(), 0, cell, label, who, utc_now())
            for cell, labels in SAID.items()
            for who, label in zip(("anna", "ben"), labels, strict=True)
        )
    server = page_server("--annotator", "anna", workspace=tmp_path)
    found = server.get("/api/agreement", a="anna", b="ben")
    assert found["unknown"] == ["kelp"] and "kelp" in found["labels"]
    assert [(one["cell"], one["a"], one["b"]) for one in found["conflicts"]] == [
        (1, "reef", "kelp"),
        (3, "kelp", "sand"),
    ]
    server.paint("s-1", 1, [1, 3], "sand", kind="settle", source="settled")
    found = server.get("/api/agreement", a="anna", b="ben")
    assert [one["settled"] for one in found["conflicts"]] == ["sand", "sand"]
