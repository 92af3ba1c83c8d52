"""The tables of the page of waters are made from the product's answers."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def maker():
    return runpy.run_path(str(DOCS / "make_waters_page.py"))


def dive(f1, ap, obstacles, n=100):
    return {
        **{"f1": f1, "average_precision": ap, "precision": 0.5, "recall": 0.25},
        **{"obstacles": obstacles, "n": n},
    }


DIVES = {"sea": dive(0.8, 0.9, 40), "tank": dive(0.6, 0.7, 50), "wall": dive(1.0, 1.0, 100)}


def test_a_dive_without_water_has_no_f1_and_counts_in_no_mean(maker):
    better, worse = ({**DIVES, "sea": dive(f1, f1 + 0.1, 40)} for f1 in (0.9, 0.7))
    lines = maker["dives_table"](DIVES, better, worse, {"sea": "deep"})
    assert "| `sea` | deep | 0.80 / 0.90 | 0.50 | 0.25 | 0.90 / 1.00 | 0.70 / 0.80 |\n" in lines
    assert "| `wall` |  | - / - | 0.50 | 0.25 | - / - | - / - |\n" in lines
    means = "0.70 / 0.80 |  |  | 0.75 / 0.85 | 0.65 / 0.75"
    assert f"| mean | of the 2 that have water | {means} |\n" in lines


def test_changes_that_training_draws_are_told_from_others(maker):
    darker = {"sea": dive(0.6, 0.8, 40), "tank": dive(0.4, 0.6, 50), "wall": dive(0, 0, 100)}
    lines = maker["changes_table"](
        DIVES, {"gain_0.5": {"dives": DIVES}, "snow_9": {"dives": darker}}
    )
    assert "| `gain_0.5` | 0.70 / 0.80 | yes |\n| `snow_9` | 0.50 / 0.70 | no |\n" in lines
    assert lines.endswith("does not draw | 0.50 / 0.70 | no |\n")


def test_adapted_dives_have_a_column_for_each_number_of_frames(maker):
    row = {"times": 0.5, "mean": 0.01, "worst": -0.02, "worst_dive": "sea"}
    rows = [
        {**row, "labelled": 3, "mission": "b", "before": [0.5, 0.6], "after": [0.7, 0.8]},
        {**row, "labelled": 3, "mission": "a", "before": [0.4, 0.6], "after": [0.4, 0.6]},
        {**row, "labelled": 1, "mission": "a", "before": [0.5, 0.6], "after": [0.5, 0.6]},
    ]
    rows[2] |= {"times": 0, "worst": 0.0, "worst_dive": "refused"}
    head, _, *lines = maker["adapted_table"](rows).splitlines()
    assert head == "| new dive | 0 frames | 1 | 3 |"
    assert lines == [
        "| `a` | 0.50 / 0.60 | refused | +0.00 / +0.00; -0.020 |",
        "| `b` | 0.50 / 0.60 |  | +0.20 / +0.20; -0.020 |",
        "| mean, worst of all |  | refused | +0.10 / +0.10; -0.020 |",
    ]


def test_tables_come_between_their_marks_and_all_are_on_the_page(maker):
    page = (DOCS / "explanation" / "waters.md").read_text("utf-8")
    marks = {"dives": "D\n", "changes": "C\n", "adapted": "A\n", "begun": "B\n"}
    filled = maker["filled"](page, marks)
    for name, table in marks.items():
        assert filled.count(f"<!-- table {name} -->\n{table}<!-- end -->\n") == 1
        assert f"<!-- table {name} -->\n| " in page
