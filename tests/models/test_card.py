from __future__ import annotations

from typing import Any

from tokt.models.card import model_card

RECIPE: dict[str, Any] = {
    "extractor_name": "lbp",
    "dim": 12,
    "grid": {"rows": 1, "cols": 1, "width": None},
    "thresholds": [0.25],
    "classes": [
        {"name": "ocean", "obstacle": False},
        {"name": "tower", "obstacle": True},
    ],
    "metrics": {
        "split": "five folds by blocks of 20 frames",
        "patch": {
            "f1": 0.87654,
            "precision": 1.0,
            "recall": 0.5,
            "average_precision": None,
            "macro_f1": 0.75,
        },
        "folds": [{"f1": 0.25}, {"f1": None}],
        "frames": {"false_status": 3, "ocean_frames": 99},
    },
}


def test_card_states_what_was_measured() -> None:
    card = model_card("tower/3", RECIPE, {"mlflow_run_id": "abc", "dataset": "dive@12"})
    assert card.startswith("# tower/3\n")
    assert "ocean (clear), tower (obstacle)" in card
    for line in (
        "| obstacle patches: F1 | 0.877 |",
        "| macro-F1 over the classes | 0.750 |",
        "| precision | 1.000 |",
        "| average precision | undefined |",
        "| F1 of the folds | 0.250, undefined |",
        "| open-ocean frames with a false status | 3 of 99 |",
        "five folds by blocks of 20 frames",
        "- dataset: dive@12",
        "- mlflow_run_id: abc",
        "- extractor: `lbp`, 12 features a patch",
        "- decision thresholds: 0.25",
    ):
        assert line in card.splitlines(), line


def test_card_is_the_same_at_each_export() -> None:
    first = model_card("tower/3", RECIPE, {"a": 1, "b": 2})
    assert first == model_card("tower/3", RECIPE, {"b": 2, "a": 1})
