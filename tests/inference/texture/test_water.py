"""What the detector makes of the water's state, and of patches that were never learnt."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.calls import refuses, succeeds
from tests.inference.logged_runs import lines
from tests.inference.texture.test_m_of_n import Script, frames
from tests.models.conftest import small_content
from tokt.features.extractors.extractor import build_extractor
from tokt.features.frames.image_file import decode_image
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import SinglePolicy, judge_image
from tokt.inference.reason import Reason
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes, read_bundle
from tokt.models.linear import LinearModel, moved
from tokt.models.nystroem import NystroemMap
from tokt.models.operating_point import MofNRule, OperatingPoint
from tokt.models.water import WaterPrior, WaterState

PRIOR = WaterPrior(-1.2, 1.2, 0.5, 0.9, 0.3)
RULE = MofNRule(m=2, n=3)


class Moving(Script):
    """A scorer with a prior."""

    obstacle = (False, True)

    def __init__(self, answers, prior=PRIOR):
        super().__init__(RULE, answers)
        object.__setattr__(self, "operating_point", OperatingPoint(RULE, water=prior))

    def is_gray(self, features):
        return False


def test_the_detector_judges_by_the_boundary_of_the_last_frames():
    rng = np.random.default_rng(1)
    answers = [rng.normal(-0.4, 0.3, 4) for _ in range(12)]
    gaps = [0, 0, 0, 2, 0, 0, 9, 0, 0, 0, 1, 0]
    detector, state = TextureDetector(Moving(answers)), WaterState(PRIOR)
    fixed = TextureDetector(Moving(answers, None))
    seen = set()
    for frame, gap, answer in zip(frames(gaps), gaps, answers, strict=True):
        state.begin(gap)
        boundary = state.judge(answer)
        found = detector.detect(frame)
        assert found.boundary == boundary
        np.testing.assert_array_equal(found.decision_values[:, 0], answer - boundary)
        as_it_is = fixed.detect(frame)
        assert as_it_is.boundary is None
        np.testing.assert_array_equal(as_it_is.decision_values[:, 0], answer)
        seen.add(boundary)
    assert len(seen) > 3
    assert (detector.window_frames, fixed.window_frames) == (7, 3)


@pytest.mark.parametrize("level", [0.35, 0.8, 3.0])
def test_an_obstacle_that_fills_the_view_for_hundreds_of_frames_is_never_clear(level):
    values = np.full(4, level)
    policy = SinglePolicy(TextureDetector(Moving([values] * 300)))
    said = [policy.judge(frame).verdict.status for frame in frames([0] * 300)]
    assert said[0] == UNKNOWN and set(said[1:]) == {OBSTACLE}


def test_a_frame_that_is_not_judged_is_a_gap():
    answers = [np.full(4, -0.4)] * 4 + [ValueError("broken")] * 5 + [np.full(4, -1.2)]
    detector = TextureDetector(Moving(answers))
    for frame in frames([0] * 9):
        SinglePolicy(detector).judge(frame)
    assert detector.detect(frames([0])[0]).boundary == PRIOR.boundary(np.full(4, -1.2))


def test_of_several_classes_the_obstacles_values_are_less():
    values = np.array([[0.5, 0.1, -1.0], [-1.0, 2.0, 1.0]])
    model = LinearModel(
        np.zeros((3, 1)), np.zeros(3), np.zeros(3), ("ocean", "pipe", "wall"), (False, True, True)
    )
    less = moved(values, 0.25, model.obstacle)
    np.testing.assert_array_equal(model.obstacle_score(less), model.obstacle_score(values) - 0.25)


def with_map(unlike=None, water=None):
    """A bundle whose landmarks are the patches of its golden frame."""
    plain = small_content()
    golden = [decode_image(png, "golden") for png in plain.golden.frames]
    extractor = build_extractor(plain.extractor_spec)
    learnt = np.vstack([extractor.describe(each, plain.grid) for each in golden])
    scale = 1 / (learnt.std(axis=0) + 1e-9)
    offset = -learnt.mean(axis=0) * scale
    landmarks = np.clip(learnt * scale + offset, -1.5, 1.5)
    mapped = NystroemMap(scale, offset, 1.5, landmarks, 0.3 / learnt.shape[1])
    weights = np.zeros((1, len(landmarks)))
    model = LinearModel(weights, np.array([-0.5]), np.zeros(1), *two_sides(plain), mapped)
    values = np.stack([model.decision_values(extractor.describe(g, plain.grid)) for g in golden])
    content = replace(
        plain,
        model=model,
        golden=replace(plain.golden, decision_values=values, obstacle=values[:, :, 0] > 0),
        operating_point=OperatingPoint(water=water, unlike=unlike),
        distribution=None,
    )
    return bundle_from_bytes(bundle_bytes(content), "mapped")


def two_sides(content):
    return content.model.classes, content.model.obstacle


def test_a_patch_unlike_all_that_was_learnt_makes_a_clear_unknown():
    known = with_map()
    frame = decode_image(known.golden.frames[0], "golden")
    strange = frame.copy()
    strange[: len(frame) // 4, : frame.shape[1] // 4] = (
        np.indices((len(frame) // 4, frame.shape[1] // 4)).sum(0)[(..., *[None] * (frame.ndim - 2))]
        % 2
        * 240
    )
    far = [known.model.map.distance(known.features(each)).max() for each in (frame, strange)]
    assert far[0] < 1.5 < far[1]
    assert judge_image(known, strange).verdict.status == CLEAR, "the model itself sees nothing"
    limited = with_map(unlike=float(np.mean(far)))
    assert judge_image(limited, frame).verdict.status == CLEAR
    verdict = judge_image(limited, strange).verdict
    assert (verdict.status, verdict.reason) == (UNKNOWN, Reason.NOVEL)
    assert f"distance {far[1]:.2f}, limit {np.mean(far):.2f}" in verdict.health


def test_in_a_bundle_and_out_again():
    bundle = with_map(2.5, PRIOR)
    assert bundle.operating_point == OperatingPoint(water=PRIOR, unlike=2.5)
    told = json.loads(json.dumps(bundle.operating_point.to_json()))
    assert OperatingPoint.from_json(told) == bundle.operating_point
    frame = decode_image(bundle.golden.frames[0], "golden")
    alone = TextureDetector(bundle).detect(Frame(1, 0.0, frame, None)).decision_values
    np.testing.assert_array_equal(bundle.values_alone(bundle.features(frame)), alone)
    np.testing.assert_allclose(
        with_map().values_alone(bundle.features(frame)),
        alone + (PRIOR.boundary(bundle.values_of(bundle.features(frame))[:, 0])),
        atol=1e-12,
    )


def test_a_bundle_with_a_fixed_boundary_is_the_same_but_for_the_prior():
    moving, still = with_map(2.5, PRIOR), with_map(2.5)
    fixed = moving.with_fixed_boundary()
    assert fixed.operating_point == still.operating_point
    assert (fixed.sha256, fixed.data, fixed.label) == (moving.sha256, moving.data, moving.label)
    features = moving.features(decode_image(moving.golden.frames[0], "golden"))
    np.testing.assert_array_equal(fixed.values_alone(features), still.values_alone(features))


def test_a_boundary_that_would_silence_the_model_is_told(bundle_file):
    """Its weakest golden obstacle is less than the boundary may move."""
    content = read_bundle(bundle_file).content
    for prior, silent in (
        (WaterPrior(-0.3, 0.1, 0.08, 0.08, 0.1, limit=0.02), False),
        (PRIOR, True),
    ):
        made = replace(content, operating_point=OperatingPoint(water=prior))
        fault = bundle_from_bytes(bundle_bytes(made), "made").deployment_fault
        assert ("it warns of no golden frame" in fault) == silent


def test_what_does_not_fit_the_model_is_refused():
    plain = small_content()
    no_map = replace(plain, operating_point=OperatingPoint(unlike=2.0))
    refuses("no landmarks", bundle_from_bytes, bundle_bytes(no_map), "no map")
    sides = replace(plain.model, obstacle=(False, False))
    one_side = replace(plain, model=sides, operating_point=OperatingPoint(water=PRIOR))
    refuses("classes of one side", bundle_from_bytes, bundle_bytes(one_side), "one side")
    for wrong in (0, -1.0, "2", True, 1e300):
        refuses("a distance to landmarks is above 0", OperatingPoint, unlike=wrong)


def test_a_run_logs_the_boundary_and_a_replay_gives_it_again(make_mission, bundle_file, tmp_path):
    """With the switch too: the log knows it."""
    folder, file = make_mission([[], [(4, 4)], [(4, 4)], [], [(1, 1)], []]), tmp_path / "m.tokt"
    content = read_bundle(bundle_file).content
    prior = WaterPrior(-0.3, 0.1, 0.08, 0.08, 0.1, limit=0.02)
    file.write_bytes(bundle_bytes(replace(content, operating_point=OperatingPoint(water=prior))))
    shown = {}
    for name, more in (("moving", ()), ("fixed", ("--fixed-boundary",))):
        log = tmp_path / f"{name}.jsonl"
        succeeds(
            *("run", "--bundle", file, "--source", folder, "--policy", "texture", *more),
            *("--udp", "127.0.0.1:9", "--log", log, "--log-values"),
        )
        shown[name] = lines(log)
        assert json.loads(succeeds("replay", log, "--json").out)["same_to_the_bit"] == 6
    state, seen = WaterState(prior), set()
    for moving, fixed in zip(shown["moving"], shown["fixed"], strict=True):
        state.begin()
        boundary = state.judge(np.array(fixed["decision_values"])[:, 0])
        assert moving["boundary"] == boundary and fixed["boundary"] is None
        seen.add(boundary)
    assert len(seen) > 1
