"""Figures 5.6 to 5.8: a picture in bad light that is given, or rendered; and low light."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt_studies.thesis.exhibits import light_figures
from tokt_studies.thesis.exhibits.dot_figures import MethodPrediction, said_by_patches
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement, Exhibit
from tokt_studies.thesis.exhibits.light_figures import bad_lighting, river_claim, training_claim
from tokt_studies.thesis.light_scene import BLUE, BRIGHT, BadPicture, LitScene, by_lamp
from tokt_studies.thesis.methods.curves import THESIS
from tokt_studies.thesis.patch_scores import score_patches, truth_by_mask

pytestmark = pytest.mark.xdist_group("reproduce")

WIDTH = 360


@pytest.fixture(scope="module")
def scene():
    """A tower, and no fish."""
    return LitScene(WIDTH, light_figures.SEED)


@pytest.fixture(scope="module")
def lit(scene):
    """A rendered pair in half the light."""
    return scene.at(by_lamp(0.5))


def _write(folder: Path, pair: BadPicture, mask: NDArray[np.uint8]) -> dict[str, Path]:
    files = {"picture": folder / "picture.png", "picture_mask": folder / "mask.png"}
    cv2.imwrite(str(files["picture"]), pair.left)
    cv2.imwrite(str(files["picture_mask"]), mask)
    return files


Judge = Callable[..., Exhibit]


@pytest.fixture
def judge(judged, context_of, monkeypatch):
    """Bad lighting by what was asked, with models that are made already, in one light more."""
    monkeypatch.setattr(light_figures, "LIGHTS", (0.03,))
    shared = ("curves", "thesis", "ocean", "other", "labels")
    given = {name: getattr(judged, name) for name in shared}
    return lambda **asked: bad_lighting(context_of(judged.mission.path, given, **asked))


def test_bad_lighting_by_a_given_image(judged, lit, tmp_path, judge):
    """Scored by the mask given: a mask that is shifted by three patches scores worse."""
    exhibit = judge(**_write(tmp_path, lit, lit.mask))
    truth = truth_by_mask(lit.mask)
    verdict = judged.thesis["haralick"].judge(lit.left)
    expected = score_patches(verdict.obstacle, truth)
    table = exhibit.tables[0].frame.set_index("method")
    assert table.loc["Haralick", "precision"] == expected.precision
    assert table.loc["Haralick", "f1"] > 0.6
    assert exhibit.claims[1].agreement is ClaimAgreement.UNAVAILABLE
    assert table.loc["tokt stereo", "status"] == "unknown"
    assert np.isnan(table.loc["tokt stereo", "f1"])
    shifted = np.roll(lit.mask, 3 * 36, axis=1)
    worse = judge(**_write(tmp_path, lit, shifted))
    scored = worse.tables[0].frame.set_index("method")
    assert scored.loc["Haralick", "f1"] < 0.5 * table.loc["Haralick", "f1"]


def test_bad_lighting_of_a_frame_of_the_mission(judged, judge):
    """Its labels stand in for a mask, its right picture makes it a pair.

    Our texture may not learn from the frames near it, which in so short a mission are all those
    with the tower: then it does not judge.
    """
    number = judged.structure_frame
    file = judged.mission.path / "Left" / f"sim_L_{number}.jpg"
    exhibit = judge(picture=file)
    assert f"frame {number}" in exhibit.words[0]
    table = exhibit.tables[0].frame.set_index("method")
    said = judged.thesis["haralick"].judge(judged.left(number)).obstacle
    expected = score_patches(said, judged.truth(number))
    assert table.loc["Haralick", "recall"] == expected.recall > 0
    assert table.loc["tokt stereo", "f1"] > 0.4
    assert table.loc["tokt texture", "status"] == "unknown"
    assert "no labels of both" in table.loc["tokt texture", "not judged"]


def test_bad_lighting_without_a_mask_scores_nothing(lit, tmp_path, judge):
    """Predictions are shown; there is no figure of merit, and a black frame is not clear to us."""
    black = replace(lit, left=np.zeros_like(lit.left))
    files = _write(tmp_path, black, lit.mask)
    exhibit = judge(picture=files["picture"])
    assert "no mask" in exhibit.claims[0].why
    table = exhibit.tables[0].frame.set_index("method")
    assert table["f1"].isna().all()
    assert table.loc["tokt texture", "status"] == "unknown"
    assert "dark: 100 of 100" in table.loc["tokt texture", "not judged"]


def test_bad_lighting_rendered(judge, monkeypatch):
    """Without an image a bright one with its exact mask, said so, and the lamp going down."""
    monkeypatch.setattr(light_figures, "LIGHTS", (1.0, 0.03))
    exhibit = judge()
    assert "Rendered" in exhibit.words[0]
    river, training, low = exhibit.claims
    scores = exhibit.tables[0].frame.set_index("method")
    assert f"recall {scores.loc['LBP (10, 5)', 'recall']:.2f}" in river.found
    assert training.agreement is not ClaimAgreement.UNAVAILABLE
    assert low.agreement is not ClaimAgreement.UNAVAILABLE
    sweep = exhibit.tables[1].frame
    assert sweep["grey level"].is_monotonic_decreasing
    assert sweep["Haralick"][0] > 0.7
    assert np.isnan(sweep["tokt texture"][1])
    assert np.isnan(sweep["tokt stereo"][1])


def test_the_mask_is_of_what_is_in_the_picture(lit):
    """The tower is where the water differs from open water; fish add to it, open water is empty."""
    water = LitScene(WIDTH, light_figures.SEED, tower=False).at(BLUE)
    assert not water.mask.any()
    bright = LitScene(WIDTH, light_figures.SEED).at(BLUE).left.astype(float)
    differs = np.abs(bright - water.left).mean(axis=2) > 8
    assert (lit.mask[differs] > 0).mean() > 0.9
    fish = LitScene(WIDTH, light_figures.SEED, fish=True).at(BRIGHT)
    assert (fish.mask >= lit.mask).all() and fish.mask.sum() > 1.2 * lit.mask.sum()
    assert fish.left.mean() > 4 * bright.mean()


def said(title: str, patches: NDArray[np.bool_], picture: BadPicture) -> MethodPrediction:
    return said_by_patches(title, title, THESIS, "", patches, picture.left)


@pytest.mark.parametrize(
    ("lbp", "haralick", "agreement"),
    [(1.0, 0.3, "YES"), (1.0, 1.0, "PARTLY"), (0.5, 0.3, "PARTLY"), (0.3, 0.9, "NO")],
)
def test_lbp_finds_nearly_everything_or_not(lit, lbp, haralick, agreement):
    there = np.flatnonzero(lit.truth == 1)
    both = [
        said(title, np.isin(np.arange(100), there[: int(share * len(there))]), lit)
        for title, share in (("LBP (10, 5)", lbp), ("Haralick", haralick))
    ]
    assert river_claim(both, lit).agreement is ClaimAgreement[agreement]
    unmarked = replace(lit, truth=None)
    assert river_claim(both, unmarked).agreement is ClaimAgreement.UNAVAILABLE
    better = {one.title: 1.0 for one in both}
    worse = dict.fromkeys(better, 0.0)
    helped = ClaimAgreement.PARTLY if 1.0 in (lbp, haralick) else ClaimAgreement.YES
    if (lbp, haralick) != (1.0, 1.0):
        assert training_claim(both, lit, better).agreement is helped
    assert training_claim(both, lit, worse).agreement is ClaimAgreement.NO
    assert training_claim(both, lit, None).agreement is ClaimAgreement.UNAVAILABLE
