"""Conflicts about a class that left the taxonomy are seen and settled like any other."""

import pytest

from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord, utc_now
from tokt.labels.store.store import LabelStore

SAID = {0: ("ocean", "ocean"), 1: ("reef", "kelp"), 2: ("kelp", "kelp"), 3: ("kelp", "sand")}


@pytest.fixture(scope="module")
def server(page_server, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kelp") / ".tokt"
    with LabelStore(folder / "labels.db") as store:
        store.add(
            LabelRecord("tiny", "left", 1, Grid(), 0, cell, label, who, utc_now())
            for cell, labels in SAID.items()
            for who, label in zip(("anna", "ben"), labels, strict=True)
        )
    return page_server("--annotator", "anna", workspace=folder)


def test_the_page_shows_the_figures_and_settles(server, browse):
    page = browse(server, "#/agreement/anna/ben")
    page.locator(".conflicts .tile").first.wait_for()
    assert page.locator(".conflicts .tile").count() == 2
    rows = page.locator(".figures dl").inner_text()
    assert "not in the taxonomy: kelp" in rows
    assert page.locator(".confusion").inner_text().count("kelp") >= 1
    page.keyboard.press("Control+a")
    page.keyboard.press("2")
    page.locator('.tile[aria-label*="settled as"]').nth(1).wait_for()
    page.locator("#save-state[data-state=saved]").wait_for()
    found = server.get("/api/agreement", a="anna", b="ben")
    assert len([one for one in found["conflicts"] if one["settled"]]) == 2


def test_the_answer(server):
    found = server.get("/api/agreement", a="anna", b="ben")
    assert found["obstacle"] is None and found["unknown"] == ["kelp"]
    assert found["agreement"] == 0.5 and found["n_both"] == 4
    assert [(one["a"], one["b"]) for one in found["conflicts"]] == [SAID[1], SAID[3]]
