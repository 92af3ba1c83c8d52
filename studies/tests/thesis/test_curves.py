"""Curves by frame: each method's own, ours held out, and what they are scored with."""

import shutil
from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from tokt.features.common.errors import ToktError
from tokt.features.frames.image_file import pixel_sha256
from tokt.inference.verdict import verdict_from_mask
from tokt.models.bundle.bundle import frame_id
from tokt.training.datasets.dive_positions import DivePositions
from tokt.training.fitting.presets import settings_named
from tokt_studies.baselines.lab_colour import LabColour
from tokt_studies.baselines.thesis_models import ThesisModel, thesis_model
from tokt_studies.baselines.thesis_texture import GRID, ThesisTextureResult
from tokt_studies.thesis.exhibits import curve_figures as curve_exhibit
from tokt_studies.thesis.exhibits.curve_figures import (
    alike_claim,
    curve_figures,
    score_methods,
    steepest,
)
from tokt_studies.thesis.exhibits.exhibit import ClaimAgreement, StudyContext
from tokt_studies.thesis.exhibits.training_image_figures import EXTRACTORS
from tokt_studies.thesis.methods import mission_models
from tokt_studies.thesis.methods.curves import Curves, Method, _model_method
from tokt_studies.thesis.methods.mission_models import TOKT_TEXTURE
from tokt_studies.thesis.patch_scores import pooled_score

pytestmark = pytest.mark.xdist_group("reproduce")

BEST = settings_named("best")
SETTINGS = replace(BEST, penalties=(0.1,), changes=BEST.changes[:1])
"""The preset with little to search for and little to learn from: for time."""


def judged_by_kernels(model: ThesisModel, frame: NDArray[np.uint8]) -> ThesisTextureResult:
    """What `ThesisModel.judge` says, by tokt's kernels of the same features, for time."""
    obstacle = model.classifier.predict(EXTRACTORS[model.name].describe(frame, GRID)) == 1
    mask = GRID.paint(obstacle, *GRID.resized(*frame.shape[:2]))
    return ThesisTextureResult(obstacle, verdict_from_mask(mask, "thesis"))


@pytest.fixture(scope="module")
def judged(reproduced):
    """Features and sizes of the frames on the way to the curves, which are made here."""
    kept: list[Any] = []
    own = mission_models.held_out_texture

    def keep(context: StudyContext, features: Any, sizes: Any, settings: Any) -> Any:
        kept.extend((features, sizes))
        return own(context, features, sizes, settings)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mission_models, "EXAMPLES", 2)
        patch.setattr("tokt.training.fitting.presets.settings_named", lambda _: SETTINGS)
        patch.setattr("tokt_studies.thesis.methods.curves.held_out_texture", keep)
        patch.setattr(ThesisModel, "judge", judged_by_kernels)
        assert len(reproduced.curves.mean) == len(reproduced.frames) - 1
    return kept


@pytest.fixture(scope="module")
def curves(reproduced, judged):
    return reproduced.curves


def test_each_curve_is_its_own_methods(reproduced, curves):
    frame = reproduced.left(12)
    means = {}
    for name, model in reproduced.thesis.items():
        verdict = model.judge(frame).verdict
        assert curves.mean.loc[12, name] == verdict.mean
        assert curves.status.loc[12, name] == verdict.status
        means[name] = verdict.mean
    assert len(set(means.values())) == len(means), "curves of other methods would not be noticed"


def test_what_was_learnt_from_is_not_scored(reproduced, curves):
    assert reproduced.ocean.frame == 1
    assert 1 not in curves.mean.index
    assert 1 not in reproduced.spread()


def test_a_file_that_is_a_frame_is_not_scored(reproduce_mission, context_of, tmp_path):
    copy = tmp_path / "elsewhere.jpg"
    shutil.copy(reproduce_mission / "Left" / "sim_L_5.jpg", copy)
    context = context_of(reproduce_mission, ocean=copy)
    assert 5 not in context.scored
    assert 1 in context.scored


def test_shuffled_features_lose(reproduced, judged, curves):
    found = pooled_score(curves.patches[TOKT_TEXTURE], reproduced.truths).f1
    rng = np.random.default_rng(1)
    features, sizes = judged
    mixed = {n: [rng.permutation(one) for one in tables] for n, tables in features.items()}
    broken = mission_models.held_out_texture(reproduced, mixed, sizes, SETTINGS)
    assert found is not None and found > 0.8
    assert (pooled_score(broken.patches, reproduced.truths).f1 or 0.0) < found / 2


def test_no_model_judges_what_it_learnt_from(reproduced, judged, monkeypatch):
    number_of = {id(tables[0]): number for number, tables in judged[0].items()}
    datasets, learnt, checked = [], {}, []
    make, teach, values = (
        mission_models._dataset,
        mission_models.fit_rows,
        mission_models.decision_values,
    )

    def dataset(*given: Any) -> Any:
        datasets.append(make(*given))
        return datasets[0]

    def learn(table: Any, targets: Any, rows: Any, *more: Any) -> Any:
        made = teach(table, targets, rows, *more)
        learnt[id(made)] = made, set(datasets[0][0].patches.frame.to_numpy()[rows].tolist())
        return made

    def decide(pipeline: Any, features: NDArray[np.float64]) -> Any:
        number = number_of[id(features)]
        checked.append(number)
        assert number not in learnt[id(pipeline)][1]
        return values(pipeline, features)

    monkeypatch.setattr(mission_models, "_dataset", dataset)
    monkeypatch.setattr(mission_models, "fit_rows", learn)
    monkeypatch.setattr(mission_models, "decision_values", decide)
    mission_models.held_out_texture(reproduced, *judged, SETTINGS)
    assert sorted(checked) == reproduced.scored


def test_a_frame_without_labels_is_judged_from_afar(monkeypatch):
    numbers = [1, 1, 20, 20, 40, 40, 60, 60]
    patches = pd.DataFrame({"frame": numbers, "position": numbers})
    counted = DivePositions({number: number for number in range(100)})
    monkeypatch.setattr(mission_models, "dive_positions", lambda mission: counted)
    dataset = type("D", (), {"patches": patches})()
    folds = [
        mission_models.Fold(np.array([2, 3, 4, 5, 6, 7]), np.array([0, 1])),
        mission_models.Fold(np.array([0, 1, 4, 5, 6, 7]), np.array([2, 3])),
    ]
    judges = mission_models._judges(dataset, folds, [1, 4, 20, 21, 41], None, 5)
    # 4 is 3 frames from frame 1 that the second learnt from; 41 is one from 40 for both.
    assert judges == {1: 0, 4: 0, 20: 1, 21: 1}


def test_a_left_camera_alone_in_gray_without_labels(
    reproduce_mission, context_of, tmp_path, monkeypatch
):
    monkeypatch.setattr(curve_exhibit, "png_of", lambda figure: b"")
    monkeypatch.setattr(mission_models, "SLIC", ())
    (tmp_path / "gray").mkdir()
    for number in (2, 12, 13):
        frame = cv2.imread(str(reproduce_mission / "Left" / f"sim_L_{number}.jpg"), 0)
        cv2.imwrite(str(tmp_path / "gray" / f"{number}.png"), frame)
    (tmp_path / "gray" / "14.png").write_bytes(b"no picture")
    context = context_of(tmp_path / "gray")
    name = "haralick"
    context.__dict__["thesis"] = {name: thesis_model(name, context.ocean, context.other)}
    exhibit = curve_figures(context)
    assert context.curves.unreadable == (14,)
    assert list(context.curves.mean.index) == [12, 13]
    assert context.labels is None and context.calibration is None
    assert context.structure_frame in (12, 13)
    assert {claim.agreement for claim in exhibit.claims} == {ClaimAgreement.UNAVAILABLE}
    left_out = " ".join(context.curves.left_out)
    assert "no right frames" in left_out and "no labels" in left_out
    assert len(exhibit.plots) >= 2


def test_the_exhibit_tells_of_each_method(reproduced, curves):
    exhibit = curve_figures(reproduced)
    assert not any(".." in words for words in exhibit.words)
    scores = next(table.frame for table in exhibit.tables if table.name == "scores")
    scores = scores.set_index("method")
    for name, model in reproduced.thesis.items():
        patches = curves.patches[name]
        assert np.array_equal(patches[11], model.judge(reproduced.left(11)).obstacle)
        assert scores.loc[model.title, "patch F1"] == pooled_score(patches, reproduced.truths).f1
    means = next(table.frame for table in exhibit.tables if table.name == "means")
    assert means.set_index("frame").loc[12, "haralick"] == curves.mean.loc[12, "haralick"]
    assert {plot.name for plot in exhibit.plots} >= {
        "figure_5_3_strip",
        "figure_5_4_normalised",
        "figure_5_5_zoomed",
    }
    assert scores.loc["tokt texture, held out", "detected"] >= 7


def made_up(means: dict[str, list[float]], distance: list[float] | None = None) -> Curves:
    index = pd.Index(range(1, len(next(iter(means.values()))) + 1), name="frame")
    mean = pd.DataFrame(means, index=index)
    methods = {name: Method(name.upper(), "the thesis's", "made up") for name in means}
    status = (mean > 0.345).astype(int)
    near = pd.Series(distance if distance else np.nan, index=index, dtype=float)
    return Curves(mean, status, methods, {}, near)


def test_scores_count_what_the_labels_say(context_of, reproduce_mission, monkeypatch):
    monkeypatch.setattr(curve_exhibit, "png_of", lambda figure: b"")
    never, always, right = ([0.0] * 16, [9.0] * 16, [0.0] * 7 + [9.0] * 9)
    given = made_up({"never": never, "always": always, "right": right})
    context = context_of(reproduce_mission, {"curves": given})
    scores = score_methods(context).to_dict("index")
    assert (scores["never"]["detected"], scores["never"]["false status"]) == (0, 0)
    assert scores["always"]["false status"] == scores["always"]["of ocean frames"] == 6
    assert (scores["right"]["detected"], scores["right"]["of obstacle frames"]) == (9, 9)
    assert scores["right"]["false status"] == 0
    assert scores["right"]["first detection"] == 8
    claim = curve_figures(context).claims[0]
    assert claim.agreement is ClaimAgreement.PARTLY
    assert "1 of 3" in claim.found and "ALWAYS" in claim.why and "RIGHT" not in claim.why


def test_a_model_that_learnt_from_any_frame_is_told(reproduced, monkeypatch):
    """From one that is not in the sample, too; and one that says nothing is not held out."""
    number = 9
    assert number not in reproduced.spread()
    learnt = frame_id(pixel_sha256(reproduced.left(number)))
    for known, words in (
        ([learnt], "NOT held out: it learnt from 1 of these frames"),
        ([learnt + np.uint64(1)], "none of these frames"),
        ([], "may not be held out"),
    ):
        content = SimpleNamespace(trained_on=np.array(known, np.uint64))
        bundle = SimpleNamespace(label="m/1", content=content)
        monkeypatch.setattr("tokt_studies.thesis.methods.curves.read_bundle", lambda _, b=bundle: b)
        assert words in _model_method(reproduced).words


def test_curves_are_alike_if_they_rise_together_and_as_fast():
    rise = [0.0] * 10 + [float(n) for n in range(21)]
    late = [0.0] * 18 + [1.6 * n for n in range(13)]
    gone = rise[::-1]

    def judged(disparity):
        return alike_claim(made_up({"lbp_10_5": rise, "haralick": rise, "disparity": disparity}))

    assert judged([3 * one for one in rise]).agreement is ClaimAgreement.YES
    assert judged(late).agreement is ClaimAgreement.PARTLY
    assert judged(gone).agreement is ClaimAgreement.NO
    assert alike_claim(made_up({"lbp_10_5": rise})).agreement is ClaimAgreement.UNAVAILABLE
    assert steepest(pd.Series(rise) / 20) == pytest.approx(1 / 20, rel=0.12)


def test_the_right_camera_s_frames_are_judged_where_it_is_asked_for(
    reproduce_mission, context_of, monkeypatch
):
    monkeypatch.setattr(mission_models, "SLIC", ())
    context = context_of(reproduce_mission, camera="right")
    name = "haralick"
    context.__dict__["thesis"] = {name: thesis_model(name, context.ocean, context.other)}
    context.__dict__["scored"] = [10, 12, 14]
    means = context.curves.mean[name]
    model = context.thesis[name]
    for number in (10, 12, 14):
        right = context.right(number)
        assert np.array_equal(context.picture(number), right)
        assert means[number] == model.judge(right).verdict.mean
    assert any(means[n] != model.judge(context.left(n)).verdict.mean for n in (12, 14))
    with pytest.raises(ToktError, match=r"no camera 'up': left, right"):
        context_of(reproduce_mission, camera="up")


def test_colours_never_learn_from_their_own_half(reproduced, monkeypatch):
    learnt: list[list[int]] = []

    def example(frame: Any, truth: Any) -> int:
        return next(n for n in reproduced.frames if np.array_equal(reproduced.left(n), frame))

    def train(examples: Iterable[int]) -> LabColour:
        learnt.append(list(examples))
        return LabColour.__new__(LabColour)

    monkeypatch.setattr(mission_models, "labelled_example", example)
    monkeypatch.setattr(mission_models.LabColour, "train", train)
    monkeypatch.setattr(mission_models.SlicTexture, "train", lambda *given: given[-1])
    found = mission_models.train_superpixel_methods(reproduced)
    assert len(learnt) == 2 and all(learnt)
    for number in reproduced.scored:
        method = found.of(number)[-1]
        half = learnt[[method is one for one in found.colours].index(True)]
        assert number not in half
        assert all(other // found.block_frames != number // found.block_frames for other in half)
