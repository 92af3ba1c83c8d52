"""The learning curve's verdict follows its interval."""

from __future__ import annotations

from typing import Any

import pytest

from tokt.training.compare.learning import learning_words


def _curve(low: float | None, high: float | None) -> dict[str, Any]:
    half = {"difference": 0.05, "low": 0.01, "high": 0.09}
    last = {"difference": 0.02, "low": low, "high": high}
    stretch = {"mission": "m", "obstacle": 3, "low": -0.01, "high": 0.03, "help": 0.01}
    return {
        "measure_title": "F1",
        "points": [{"fraction": fraction} for fraction in (0.25, 0.5, 0.75, 1.0)],
        "gains": [half, last],
        "by_label": [
            {"label": "ocean", "n": 90, "wrong": [0.02, 0.01, 0.01, 0.01]},
            {"label": "kelp", "n": 10, "wrong": [0.5, 0.4, 0.3, 0.2]},
        ],
        "stretches": [
            stretch | {"frames": "1-9"},
            stretch | {"frames": "20-29", "help": -0.1, "low": -0.2, "high": -0.02},
        ],
    }


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (0.005, 0.04, "More labels of this kind would probably still help"),
        (-0.004, 0.004, "More labels of this kind would hardly help"),
        (-0.01, 0.05, "Cannot tell whether"),
        (None, None, "Too few blocks to say"),
    ],
)
def test_the_last_blocks_decide(low: float | None, high: float | None, said: str) -> None:
    assert learning_words(_curve(low, high))[0].startswith(said)


def test_classes_and_stretches_are_named() -> None:
    _, classes, best, luck, harm = learning_words(_curve(0.1, 0.2))
    assert "kelp is judged wrong most often (20.0% of 10" in classes
    assert "fell by 20.0 percentage points" in classes
    assert "frames 1-9 of m" in best and "none helps beyond doubt" in luck
    assert "frames 20-29 of m made the other blocks worse by 0.100" in harm


def test_a_best_stretch_that_harms_is_not_said_to_have_lowered_anything() -> None:
    curve = _curve(0.1, 0.2)
    curve["stretches"] = curve["stretches"][1:]
    best = learning_words(curve)[2]
    assert "with them F1 is -0.100 from what it is without" in best
