"""Label audit: planted wrong labels come first, and nothing is learnt from them twice."""

import numpy as np
import pytest

from tokt.labels.formats.audit_csv import read_audit
from tokt.labels.formats.label_csv import read_label_csv
from tokt.labels.taxonomy import Taxonomy
from tokt.models.registry.registry import Registry
from tokt.training.datasets.folds import Fold
from tokt.training.fitting.label_audit import believable

PLANTED = [(5, 0, 0), (6, 9, 9), (17, 1, 2), (18, 8, 0), (29, 4, 29 % 8), (30, 5, 30 % 8 + 1)]
"""Frame, row and column: four patches of open water, then two of the tower."""


@pytest.fixture(scope="module")
def planted(tiny, tiny_truth, done, tmp_path_factory):
    """A workspace with dataset `spoilt`: the tiny mission with six wrong labels."""
    folder = tmp_path_factory.mktemp("audit")
    rows = tiny_truth.labels()
    for row in rows:
        if (row[2], row[3], row[4]) in PLANTED:
            row[5] = "ocean" if row[5] == "subsea_installation" else "subsea_installation"
    labels = tiny_truth.write_labels(folder / "spoilt.csv", rows)
    where = ("--labels", labels, "--block", 4, "--workspace", folder / ".tokt")
    done("dataset", "build", "spoilt", "--mission", tiny.path, *where)
    return folder / ".tokt"


def test_planted_wrong_labels_come_first_and_no_label_is_changed(planted, told, tmp_path):
    before = {path: path.read_bytes() for path in (planted / "datasets").rglob("*.parquet")}
    out = tmp_path / "audit.csv"
    options = ("-o", out, "--top", 6, "--folds", 3, "--workspace", planted)
    found = told("labels", "audit", "spoilt", *options)
    assert {(p["frame"], p["row"], p["col"]) for p in found["patches"]} == set(PLANTED)
    margins = [patch["margin"] for patch in found["patches"]]
    assert margins == sorted(margins) and margins[-1] < 0
    tower = next(p for p in found["patches"] if p["frame"] == 29)
    assert (tower["label"], tower["suggested"]) == ("ocean", "subsea_installation")
    assert "takes it for obstacle" in tower["reason"]
    assert "labelled neighbours are subsea_installation" in tower["reason"]
    assert before == {path: path.read_bytes() for path in (planted / "datasets").rglob("*.parquet")}
    kept = read_audit(planted / "audits" / f"{found['name']}.json")
    assert [patch.margin for patch in kept.patches] == margins
    # The list is a label file: what is corrected in it can be imported.
    records = read_label_csv(out, Taxonomy.load())
    places = [(p["frame"], p["row"], p["col"]) for p in found["patches"]]
    assert [(r.frame, r.row, r.col) for r in records] == places


def test_an_obstacle_is_suggested_by_the_name_that_its_neighbours_have(
    tiny, done, told, tiny_truth, tmp_path
):
    rows = tiny_truth.labels()
    for row in rows:
        is_planted = (row[2], row[3], row[4]) in PLANTED
        if row[2] == 29 and row[5] == "subsea_installation":
            row[5] = "ocean" if is_planted else "reef"
    labels = tiny_truth.write_labels(tmp_path / "reef.csv", rows)
    where = ("--workspace", tmp_path / ".tokt")
    built = ("--mission", tiny.path, "--labels", labels, "--block", 4)
    done("dataset", "build", "reef", *built, *where)
    found = told("labels", "audit", "reef", "--folds", 3, *where)
    tower = next(p for p in found["patches"] if p["frame"] == 29 and p["label"] == "ocean")
    assert tower["suggested"] == "reef"
    assert "labelled neighbours are reef" in tower["reason"]


def test_audit_of_a_model_starts_from_its_registered_held_out_values(workspace, told):
    found = told("labels", "audit", "tiny-lbp@challenger", "--workspace", workspace)
    assert found["of"].startswith("model tiny-lbp/1 (tiny@")
    assert found["name"] == "tiny-lbp-1"
    assert "3 folds over whole blocks" in found["rule"]
    table = Registry(workspace).held_out("tiny-lbp/1")
    wrong = table[(table.value_0 > 0) != (table.target == 1)]
    contradicted = set(wrong[["frame", "row", "col"]].itertuples(index=False, name=None))
    listed = {(p["frame"], p["row"], p["col"]) for p in found["patches"]}
    assert len(listed & contradicted) >= 0.8 * len(listed)


def test_second_pass_learns_no_contradicted_label_but_half_of_a_class_at_least():
    targets = np.array([0, 0, 0, 0, 1, 1, 1, 1])
    margins = np.array([1.0, -1.0, 1.0, 1.0, -1.0, -4.0, -3.0, -2.0])
    kept = believable(Fold(np.arange(8), np.arange(0)), margins, targets)
    assert kept.tolist() == [0, 2, 3, 4, 7]


def test_what_cannot_be_audited_is_said(workspace, refused):
    for why, *asked in (
        ("no model 'nothing' in the registry", "nothing"),
        ("model tiny-lbp/1 has its own", "tiny-lbp/1", "--folds", 4),
        ("too few for 50 folds", "tiny", "--folds", 50),
    ):
        refused(why, "labels", "audit", *asked, "--workspace", workspace)
    assert not (workspace / "audits").exists()
