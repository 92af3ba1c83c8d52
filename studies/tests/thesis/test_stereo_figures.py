"""Figures 3.8 to 3.10, 5.1, 6.1 and the trend: on a rendered dive, and with each method broken."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.inference.policy.temporal_cues import GROWING, SHRINKING, STEADY
from tokt_studies.baselines.slic import SlicTexture
from tokt_studies.baselines.thesis_models import thesis_model
from tokt_studies.simulation.rendering.synthetic_mission import MissionScene
from tokt_studies.thesis.exhibits import (
    disparity_figures,
    superpixel_figure,
    synchrony_figure,
    trend_figure,
)
from tokt_studies.thesis.exhibits.disparity_figures import KINDS
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement, Exhibit
from tokt_studies.thesis.exhibits.synchrony_figure import offset_of
from tokt_studies.thesis.exhibits.trend_figure import depth_trend, score, trend_against_depth
from tokt_studies.thesis.methods.curves import Curves
from tokt_studies.thesis.methods.mission_models import SuperpixelMethods

WIDTH, SCENE_FRAMES = 480, 120
OPEN = (3, 5)
ROW = tuple(range(82, 89))
"""Successive frames, some 3 m from the tower."""
APART = 97
SHOWN = [*OPEN, *ROW, APART]


@pytest.fixture(scope="session")
def dive(tmp_path_factory):
    """Open water, a row of successive frames of the tower, and one from elsewhere."""
    folder = tmp_path_factory.mktemp("stereo-figures") / "dive"
    for part in ("Left", "Right", "masks", "depth"):
        (folder / part).mkdir(parents=True)
    scene = MissionScene.draw(1, SCENE_FRAMES, WIDTH)
    scene.rig.write(folder / "calibration.yml")
    for number in SHOWN:
        scene.render(folder, number)
    return folder


@pytest.fixture
def context(dive, context_of):
    """The dive's context, one for each test."""
    return context_of(dive)


@pytest.fixture
def few(monkeypatch):
    """Fewer frames than on a whole mission."""
    for name, count in (("EXCHANGED_FRAMES", 2), ("MATCHED_FRAMES", 1)):
        monkeypatch.setattr(disparity_figures, name, count)


def agreement_of(exhibit: Exhibit, what: str) -> ClaimAgreement:
    return next(claim.agreement for claim in exhibit.claims if claim.what == what)


def test_disparity_needs_both_pictures_and_the_thesis_s_does_not(context, dive, few):
    found = disparity_figures.disparity_figures(context)
    numbers = dict(found.tables[1].frame.to_numpy())
    # A rendered tower is more like itself upside down than the real one is.
    assert numbers["ours_matched_own_median"] > 0.05 > 4 * numbers["ours_matched_wrong_most"]
    assert numbers["thesis_pixels_changed_most"] < 0.01
    assert numbers["matched_points"] > 20 and numbers["points_searched"] == 0
    assert agreement_of(found, "the map shows disparities of the two pictures") is ClaimAgreement.NO
    shown = int(numbers["shown_frame"])
    truth = cv2.imread(str(dive / "depth" / f"L_{shown}.png"), cv2.IMREAD_UNCHANGED) / 1000
    points = disparity_figures._shown(context, shown).points_m
    assert np.median(points[:, 2]) == pytest.approx(np.median(truth[truth > 0]), rel=0.05)
    assert abs(numbers["rank_correlation"]) < 0.5
    table = found.tables[0].frame
    assert list(table["right"].unique()) == list(KINDS)
    assert all(plot.png.startswith(b"\x89PNG") for plot in found.plots)


def test_without_a_calibration_it_is_said_what_is_missing(context):
    context.__dict__["_cameras"] = (None, "none was given")
    for make in (
        disparity_figures.disparity_figures,
        synchrony_figure.synchrony_figure,
        trend_figure.trend_exhibit,
    ):
        with pytest.raises(ToktError, match=r"calibration.*none was given"):
            make(context)


def test_cameras_are_synchronous_and_a_late_one_is_late(context):
    found = synchrony_figure.synchrony_figure(context)
    offsets = found.tables[0].frame
    own, shifted = offsets["offset, frames"]
    # Its picture moves by ten rows a frame, the sea trial's by seventy.
    assert own == pytest.approx(0, abs=0.05) and shifted == pytest.approx(1, abs=0.08)
    assert 0 < offsets["95 % interval, +-"][0] < 0.1
    assert len(found.claims) == 1


def rows_moved_by(offset: float, seed: int = 3) -> pd.DataFrame:
    """Points of ten frames that move by some rows a frame, the right camera late."""
    rng = np.random.default_rng(seed)
    frame = np.repeat(np.arange(10), 30)
    moved, bent = (rng.normal(0, size, 10)[frame] for size in (12, 3))
    place = rng.uniform(-0.5, 0.5, (300, 2))
    here = rng.uniform(0, 500, 300)
    right = here + offset * moved + offset**2 * bent + 0.3 + place @ [0.5, -1.0]
    left = {"before": here - moved + bent, "here": here, "after": here + moved + bent}
    right += rng.normal(0, 0.3, 300)
    return pd.DataFrame(
        {"frame": frame, **left, "right": right, "x": place[:, 0], "y": place[:, 1]}
    )


@pytest.mark.parametrize("true", [-1.0, -0.2, 0.0, 0.5])
def test_an_offset_is_measured_and_one_that_is_large_is_told(true):
    found = offset_of(rows_moved_by(true))
    assert abs(found.frames - true) < max(2 * found.half_width, 0.01) < 0.05
    control = replace(found, frames=found.frames + 1)
    pair = {synchrony_figure.AS_IT_IS: found, synchrony_figure.ON_PURPOSE: control}
    wanted = ClaimAgreement.YES if true == 0 else ClaimAgreement.NO
    assert synchrony_figure.claim_of(pair).agreement is wanted


def test_superpixels_and_grid_see_the_same_with_one_classifier(context, monkeypatch):
    monkeypatch.setattr(superpixel_figure, "SLIC", ("lbp_10_5",))
    model = thesis_model("lbp_10_5", context.ocean, context.other)
    slic = SlicTexture.train(context.ocean.image, context.other.image, model.describe, model.name)
    methods = SuperpixelMethods((slic,), (), 1, "", "")
    given = {"structure_frame": APART, "scored": [APART], "thesis": {"lbp_10_5": model}}
    context.__dict__ |= {**given, "superpixel_methods": methods}
    found = superpixel_figure.superpixel_figure(context)
    frames = {APART: context.picture(APART)}
    summary = superpixel_figure.compare(frames, slic, model, context.labelled)
    assert summary["overlap"] > 0.5
    assert found.claims == (superpixel_figure.mask_claim(summary),)
    turned = SlicTexture(model.describe, Opposite(slic), "turned")
    assert superpixel_figure.compare(frames, turned, model, context.labelled)["overlap"] < 0.1


class Opposite:
    """A classifier that says the opposite of a trained one."""

    def __init__(self, texture: SlicTexture) -> None:
        self._classifier = texture.classifier

    def predict(self, rows: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.asarray(1 - self._classifier.predict(rows))


FRAMES = list(range(1, 61))
STEP_S = 0.35


def approach() -> pd.Series:
    """Depths by frame: to 5.4 m at 0.5 m/s, a rest, and back."""
    depths = np.concatenate(
        [9.8 - 0.175 * np.arange(25), np.full(15, 5.425), 5.425 + 0.175 * np.arange(20)]
    )
    return pd.Series(depths, pd.Index(FRAMES, name="frame"))


def means(depth_m: pd.Series, power: float = -2.0) -> pd.DataFrame:
    """An area that goes with a power of the depth."""
    return pd.DataFrame({"mean": 20 * (depth_m / 5) ** power, "whole": True})


def test_a_thing_wholly_in_view_has_the_depth_s_trend_and_time():
    depth = approach()
    found = score(trend_against_depth(means(depth), depth))
    assert found["sign_agreement"] == 1 and found["same_sign"] > 25 and found["opposite_sign"] == 0
    assert found["rank_correlation"] == pytest.approx(-1, abs=1e-3)
    assert found["contacts"] > 10
    assert found["contact_ratio_50"] == pytest.approx(1, abs=0.05)


def test_how_the_depth_changes():
    t = np.arange(12) * STEP_S
    for speed, trend in ((-0.5, GROWING), (0.5, SHRINKING), (0.02, STEADY)):
        found = depth_trend(t, 5 + speed * (t - t[-1]))
        assert found[0] == trend and (found[1] is None) == (trend != GROWING)
    assert depth_trend(t, 5 - 0.5 * (t - t[-1])) == (GROWING, pytest.approx(10))
    assert depth_trend(t, np.where(t == t[-1], np.nan, 5.0)) == (None, None)
    assert depth_trend(t[-3:], np.full(3, 5.0)) == (None, None)


@pytest.fixture
def followed(context, monkeypatch):
    """The trend's exhibit of a dive whose mean goes with a power of the depth."""
    depth = approach()

    def make(power: float) -> Exhibit:
        nothing = pd.DataFrame(index=pd.Index(FRAMES, name="frame"))
        context.__dict__["curves"] = Curves(nothing, nothing, {}, distance_m=depth)
        context.__dict__["pairs"] = FRAMES
        given = means(depth, power), depth
        monkeypatch.setattr(trend_figure, "means_of_stereo", lambda *_: given)
        return trend_figure.trend_exhibit(context)

    return make


def test_the_trend_s_exhibit(followed, monkeypatch):
    what = "a growing mean is a thing that comes nearer"
    found = followed(-2.0)
    assert agreement_of(found, what) is ClaimAgreement.YES
    (row,) = found.tables[0].frame.to_dict("records")
    assert row["same sign"] > 10 and row["opposite sign"] == 0
    monkeypatch.setattr(trend_figure, "png_of", lambda _: b"")
    turned = followed(2.0)
    assert agreement_of(turned, what) is ClaimAgreement.NO
    assert agreement_of(turned, "the mean value is a relative distance") is ClaimAgreement.NO
