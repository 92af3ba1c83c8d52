"""Tables 5.1 to 5.4: what is timed is the method itself, and each row is its own method's."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tokt.features.frames.mission import LEFT, RIGHT
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy, judge_image
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.verdict import verdict_from_mask
from tokt_studies.baselines.thesis_texture import GRID
from tokt_studies.thesis.exhibits import runtime_tables
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement, StudyContext
from tokt_studies.thesis.exhibits.runtime_tables import (
    HALF_SIZE,
    REST,
    STAGES,
    EncodedPair,
    Laps,
    StageTimes,
    TimedMethod,
    slic_texture,
    thesis_model_with_kernels,
    thesis_texture,
    tokt_stereo,
    tokt_texture,
)

pytestmark = pytest.mark.xdist_group("reproduce")


def encoded(context: StudyContext, number: int) -> EncodedPair:
    mission = context.mission
    return EncodedPair(number, mission.encoded(number, LEFT)[0], mission.encoded(number, RIGHT)[0])


def same(one: Any, other: Any) -> bool:
    return (one.status, one.mean, one.box, one.x, one.y) == (
        *(other.status, other.mean, other.box, other.x, other.y),
    )


def test_stages_add_up_to_the_thesiss_verdict(reproduced):
    item, frame = encoded(reproduced, 12), reproduced.left(12)
    for model in reproduced.thesis.values():
        laps = Laps()
        expected = model.judge(frame).verdict
        assert expected.status == 1
        assert same(thesis_texture(model).run(item, laps), expected)
        assert same(thesis_model_with_kernels(model).run(item, Laps()), expected)
        used = {stage for stage, seconds in laps.seconds.items() if seconds}
        assert used == {"decode", "resize", "features", "predict", REST}


def test_stages_of_slic_add_up_to_its_verdict(reproduced):
    slic = reproduced.superpixel_methods.textures[0]
    laps = Laps()
    method = slic_texture(slic)
    verdict = method.run(encoded(reproduced, 12), laps)
    assert same(verdict, verdict_from_mask(slic.mask(reproduced.left(12)), slic.name))
    assert verdict.mean
    for stage in ("decode", "resize", "superpixels", "features", "predict"):
        assert laps.seconds[stage] > 0, stage


def test_ours_are_timed_as_the_runtime_judges(reproduced):
    bundle = reproduced.tokt_model[0]
    item, left = encoded(reproduced, 12), reproduced.left(12)
    texture = tokt_texture(bundle.extractor, bundle.model).run(item, Laps())
    assert same(texture, judge_image(bundle, left).verdict)
    assert texture.status == 1
    calibration = load_calibration(reproduced.mission.path / "calibration.yml")
    right = reproduced.right(12)
    policy = SinglePolicy(DisparityDetector(calibration, GRID))
    laps = Laps()
    stereo = tokt_stereo(calibration).run(item, laps)
    assert same(stereo, policy.judge(Frame(12, 12.0, left, right)).verdict)
    assert stereo.distance_m is not None
    assert laps.seconds["undistort"] > 0 and laps.seconds["match"] > 0


def made_up(ratios: dict[str, float]) -> dict[str, StageTimes]:
    """Times of ways, as multiples of LBP's 30 ms, on 2 frames of which the second takes twice."""
    found = {}
    for key, ratio in ratios.items():
        seconds = np.zeros((2, len(STAGES)))
        seconds[:, STAGES.index("features")] = np.array([0.03, 0.06]) * ratio
        method = TimedMethod(key, key, "x", lambda item, laps: None)
        found[key] = StageTimes(method, seconds)
    return found


def claims_of(found: dict[str, StageTimes]) -> dict[str, Any]:
    return {claim.what.split()[0]: claim for claim in runtime_tables._claims(found)}


def test_ratios_are_judged_against_the_printed_ones():
    ratios = {"slic_lbp_10_5": 19.7, "lbp_10_5": 1.0, "haralick": 1.726}
    # Of 45 ms the median frame: 20 ms for pushbroom are printed, and 2.3 s for thirds.
    cited = {"pushbroom": 0.4, "thirds": 52.0, "tokt_stereo": 1.0, HALF_SIZE: 3.0}
    claims = claims_of(made_up({**ratios, **cited, "disparity": 1.19}))
    assert {claim.agreement for claim in claims.values()} == {ClaimAgreement.YES}
    assert "19.7" in claims["SLIC"].printed and claims["SLIC"].found.startswith("19.7")
    slow = {"pushbroom": 1.0, "thirds": 80.0, "tokt_stereo": 1.0, HALF_SIZE: 0.9}
    swapped = claims_of(made_up({**ratios, **slow, "slic_lbp_10_5": 1.19, "disparity": 19.7}))
    assert swapped["SLIC"].agreement is swapped["disparity"].agreement is ClaimAgreement.NO
    assert swapped["Haralick"].agreement is ClaimAgreement.YES
    assert swapped["pushbroom"].agreement is swapped["a"].agreement is ClaimAgreement.NO
    assert swapped["thirds"].agreement is ClaimAgreement.PARTLY
    assert "1.55 times as long" in swapped["thirds"].found
    fast = claims_of(made_up({**ratios, **cited, "pushbroom": 0.25, "thirds": 0.3}))
    assert fast["pushbroom"].agreement is ClaimAgreement.PARTLY
    assert fast["thirds"].agreement is ClaimAgreement.NO
    assert fast["thirds"].found.endswith("172 times as fast")
    assert "features takes" in swapped["disparity"].why
    assert claims_of(made_up(ratios))["disparity"].agreement is ClaimAgreement.UNAVAILABLE


def test_the_exhibit_has_each_methods_profile(reproduced, monkeypatch):
    def timed(methods: list[TimedMethod], frames: Any) -> list[StageTimes]:
        rows = made_up({method.key: 1.0 + at for at, method in enumerate(methods)})
        return [replace(rows[method.key], method=method) for method in methods]

    monkeypatch.setattr(runtime_tables, "time_stages", timed)
    exhibit = runtime_tables.runtime_tables(reproduced)
    tables = {table.name: table.frame for table in exhibit.tables}
    rows = tables["run_times"].set_index("method")
    assert rows.loc["SLIC + LBP (10, 5)", "median ms"] == pytest.approx(45)
    assert rows.loc["LBP (10, 5), 10x10 patches", "median ms"] == pytest.approx(135)
    stereo = list(rows.index).index("tokt stereo, a pair") + 1
    assert rows.loc["tokt stereo, a pair", "times LBP"] == pytest.approx(stereo / 3)
    assert {"tokt texture", "Haralick, tokt's kernels"} <= set(rows.index)
    printed = tables["printed_rows"].set_index(["table", "row"])
    lbp = printed.loc["5.2 LBP"]
    assert lbp.loc["module", "thesis s"] == 58.5 and lbp.loc["module", "s"] == pytest.approx(
        33.1, 0.01
    )
    assert lbp.loc["describe", "part of it"] == pytest.approx(0.30, abs=0.005)
    assert lbp.loc["describe", "part"] == 1.0 and lbp.loc["imread", "s"] == 0.0
    copied = printed.loc[("5.3 disparity", "disparityCalc")]
    assert copied["here"] == "copied by mistake" and pd.isna(copied["part of it"])
    assert "not measured" in exhibit.claims[1].found
    assert exhibit.plots[0].png.startswith(b"\x89PNG")
