"""Verdicts under grey changes, rotation and noise: shares that are counted, claims both ways."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tokt.features.common.errors import ToktError
from tokt_studies.thesis.exhibits import invariance as exhibit_of
from tokt_studies.thesis.exhibits.invariance import (
    GAIN,
    GAMMA,
    NOISE,
    QUARTER,
    SMALL,
    changed_shares,
    invariance,
)

pytestmark = pytest.mark.xdist_group("reproduce")
ROWS = [GAMMA, GAIN, QUARTER, *SMALL, NOISE]


class Bright:
    """Calls a patch other whose mean grey level is above a limit; the same for every extractor."""

    def __init__(self, limit: float) -> None:
        self.limit = limit

    def predict(self, rows: np.ndarray) -> np.ndarray:
        return (rows[:, 0] > self.limit).astype(int)


def grey(picture: np.ndarray, grid: Any) -> dict[str, np.ndarray]:
    means = grid.cells(picture).reshape(grid.n_patches, -1).mean(axis=1)[:, None]
    return {"lbp_10_5": means, "lbp_24_8": means, "haralick": means}


def context_with(limit: float) -> Any:
    """Two kinds of patches, of grey level 40 and 100, labelled as clear and as an obstacle."""
    truth = (np.arange(100) % 2).astype(np.int8)
    frame = np.repeat(np.repeat((40 + 60 * truth).reshape(10, 10), 27, 0), 36, 1).astype(np.uint8)
    models = dict.fromkeys(grey(frame, exhibit_of.GRID), SimpleNamespace(classifier=Bright(limit)))
    return SimpleNamespace(
        thesis=models, truth=lambda number: truth, decoded=lambda ns: ((n, frame) for n in ns)
    )


def test_only_what_changes_a_verdict_is_counted(monkeypatch):
    """By brightness: gain and gamma make clear water other, a turn leaves each patch as it is."""
    monkeypatch.setattr(exhibit_of, "described", lambda picture, grid: grey(picture, grid))
    shares = changed_shares(context_with(70), [1, 2])["haralick"]
    assert shares.index.tolist() == ROWS
    assert shares[GAIN] == shares[GAMMA] == 0.5
    assert shares[[QUARTER, *SMALL, NOISE]].max() == 0
    assert changed_shares(context_with(300), [1]).max().max() == 0
    with pytest.raises(ToktError, match="can be read"):
        changed_shares(context_with(70), [])


def test_the_exhibit(judged, context_of, monkeypatch):
    monkeypatch.setattr(exhibit_of, "FRAMES", 2)
    found = invariance(judged)
    table = found.tables[0].frame.set_index("change")
    assert table.index.tolist() == ROWS
    assert ((table >= 0) & (table <= 1)).all(axis=None)
    assert table["LBP (10, 5)"].max() > 0
    with pytest.raises(ToktError, match="labelled"):
        invariance(context_of(judged.mission.path, {"labels": None}))
