"""Figures 3.1 to 3.7: lines that are straight or bent, and rows that agree or do not."""

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tokt.training.rig.calibrate.matching import FrameMatches
from tokt_studies.baselines.thesis_stereo import LEFT_CAMERA, in_thesis_view
from tokt_studies.thesis.exhibits import calibration_figures, disparity_figures
from tokt_studies.thesis.exhibits.calibration_figures import bend_claim, edge_bends
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement

CAMERAS = {"straight": None, "as printed": calibration_figures._PRINTED, "as read": LEFT_CAMERA}


def stripes(camera: Any, degrees: float) -> np.ndarray:
    """Straight stripes as a camera with that distortion sees them; None is one without."""
    row, column = np.mgrid[:1024, :1360].astype(np.float64)
    places = np.stack([column, row], axis=-1).reshape(-1, 2)
    if camera is not None:
        places = in_thesis_view(places, camera)
    along = places @ [np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]
    bright = 60 + 100 * (np.floor(along / 110) % 2).reshape(row.shape)
    return cv2.GaussianBlur(bright, (0, 0), 2).astype(np.uint8)


@pytest.mark.parametrize(
    ("camera", "agreement"), [("straight", "NO"), ("as printed", "YES"), ("as read", "YES")]
)
def test_lines_that_the_printed_lens_bends_are_straightened_and_no_others(camera, agreement):
    pictures = {1: stripes(CAMERAS[camera], 12), 2: stripes(CAMERAS[camera], 80)}
    mission = SimpleNamespace(read=lambda number, camera: pictures[number])
    bends = edge_bends(SimpleNamespace(mission=mission), [1, 2])  # type: ignore[arg-type]
    assert len(bends) >= calibration_figures.FEW_EDGES
    before = np.median(bends, axis=0)[0]
    assert before < 1e-3 if camera == "straight" else before > 2e-3
    assert bend_claim(bends).agreement is ClaimAgreement[agreement]


def test_rows_of_matched_points(monkeypatch, reproduced):
    """Points one row apart are one row apart; the thesis's step moves those far from its corner."""
    places = np.stack(np.meshgrid([60.0, 300.0], [60.0, 200.0]), axis=-1).reshape(-1, 2)
    none = np.empty((0, 128), np.float32)
    found = FrameMatches(9, places, np.add(places, [0, 1]), none, none)
    monkeypatch.setattr(disparity_figures, "match_frame", lambda *_: found)
    rows = calibration_figures.row_differences(reproduced)
    assert rows["raw"].to_numpy() == pytest.approx(1024 / 271, rel=1e-6)
    assert (rows["thesis"] != rows["raw"]).all()
    assert (rows["matches"] == 4).all()
