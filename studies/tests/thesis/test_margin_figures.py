"""The false line, the sweep of disparities and the cut margin: found, and found to be untrue."""

import numpy as np
import pandas as pd
import pytest

from tokt_studies.baselines.thesis_stereo import CROP_PX, N_DISPARITIES_PX, disparity_map
from tokt_studies.thesis.exhibits import margin_figures
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement
from tokt_studies.thesis.exhibits.margin_figures import (
    SWEEP,
    edge_claim,
    matched_by_number,
    seen_at_the_edges,
)
from tokt_studies.thesis.exhibits.margin_figures import margin_figures as margin_exhibit

SIZE = 1024, 1360


def test_the_sweep_is_of_the_thesiss_block_matching():
    """With its own number it gives the thesis's map."""
    rng = np.random.default_rng(3)
    left = np.zeros(SIZE, np.uint8)
    left[300:500, 500:800] = rng.integers(0, 255, (200, 300))
    right = np.roll(left, -30, axis=1)
    sweep = matched_by_number([(left, right)])
    white = disparity_map(left, right) > 0
    # The least disparity found is stretched to 0, which is also what is not matched.
    assert sweep[N_DISPARITIES_PX][0] == pytest.approx(100 * white.mean(), abs=0.1)
    assert sweep[N_DISPARITIES_PX][0] > 1


def mirrored(context, monkeypatch, thesis_map) -> pd.DataFrame:
    monkeypatch.setattr(margin_figures, "thesis_map", thesis_map)
    monkeypatch.setattr(margin_figures, "MIRRORED_FRAMES", 2)
    monkeypatch.setattr(margin_figures, "in_map", in_place)
    return seen_at_the_edges(context)


def in_place(patches: np.ndarray) -> np.ndarray:
    there = (patches == 1).reshape(10, 10)
    return np.kron(there, np.ones((102, 136), bool))


def test_an_obstacle_at_the_right_edge_is_cut_off(reproduced, monkeypatch):
    """A map that is white all over loses what lies in the margin, and only at the right edge."""
    seen = mirrored(reproduced, monkeypatch, lambda *_: np.full((1020, 1360), 255, np.uint8))
    assert (seen["left"] == 1).all()
    assert seen["right"].to_numpy() == pytest.approx(1 - seen["right, in the margin"])
    assert (seen["right, in the margin"] > 0.1).all()
    assert edge_claim(seen).agreement is ClaimAgreement.YES
    same = seen.assign(right=seen["left"])
    assert edge_claim(same).agreement is ClaimAgreement.PARTLY
    outside = same.assign(**{"right, in the margin": 0.0})
    assert edge_claim(outside).agreement is ClaimAgreement.NO
    assert edge_claim(seen[:0]).agreement is ClaimAgreement.UNAVAILABLE


def test_the_exhibit(reproduced, monkeypatch):
    for name, count in (("OPEN_FRAMES", 1), ("SWEPT_FRAMES", 1), ("MIRRORED_FRAMES", 2)):
        monkeypatch.setattr(margin_figures, name, count)
    exhibit = margin_exhibit(reproduced)
    assert len(exhibit.claims) == 3
    sweep, edges = (table.frame for table in exhibit.tables)
    assert list(sweep.columns) == list(SWEEP) and len(edges) == 2
    assert CROP_PX == 200
