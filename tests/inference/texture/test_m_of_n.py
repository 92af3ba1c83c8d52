"""The frame rule at run time: detector, policies, loop, datagrams and log."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.calls import succeeds
from tests.inference.conftest import NoiseScorer
from tests.inference.logged_runs import lines, variant
from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import EitherPolicy, FallbackPolicy, SinglePolicy
from tokt.inference.sources.files import open_source
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN, Detection
from tokt.models.operating_point import MofNRule, MofNState, OperatingPoint

PICTURE = np.random.default_rng(1).integers(0, 20, (60, 60), np.uint8) + np.arange(
    60, dtype=np.uint8
)


class Script(NoiseScorer):
    """A scorer that gives, frame by frame, what it was told to; an exception is raised."""

    def __init__(self, rule: MofNRule, answers: list[Any], grid: Grid = Grid(2, 2, 60)) -> None:  # noqa: B008 - frozen
        super().__init__("script/1", grid, ((60, 60),), operating_point=OperatingPoint(rule))
        self._answers = iter(answers)

    def features(self, frame: Any, pictures: Any = None, threads: int = 1) -> Any:
        answer = next(self._answers)
        if isinstance(answer, Exception):
            raise answer
        return np.asarray(answer, np.float64)[:, None]

    def values_of(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        return features


def frames(missed: list[int]) -> list[Frame]:
    return [Frame(i, 0.0, PICTURE, None, missed=gap) for i, gap in enumerate(missed)]


VALUES = st.lists(st.sampled_from([-1.0, 0.25, 1.0, 3.0]), min_size=4, max_size=4)
STEPS = st.tuples(VALUES | st.just(ValueError("broken")), st.sampled_from([0, 0, 0, 1, 2, 9]))


@settings(max_examples=scaled(60))
@given(
    st.sampled_from([1, 2, 3]),
    st.integers(1, 3),
    st.sampled_from([None, 2.0]),
    st.lists(STEPS, max_size=10),
    st.data(),
)
def test_verdicts_are_the_rule_s(window, least, now, steps, data):
    rule = MofNRule(0.5, least, data.draw(st.integers(1, window)), window, now)
    policy = SinglePolicy(TextureDetector(Script(rule, [answer for answer, _ in steps])))
    state = MofNState(rule)

    for (answer, missed), frame in zip(steps, frames([gap for _, gap in steps]), strict=True):
        verdict = policy.judge(frame).verdict
        scores = None if isinstance(answer, Exception) else np.array(answer)
        state.skip(missed)
        assert verdict.status == state.add(scores)
        assert (verdict.mean is None) == (verdict.status == UNKNOWN)
        assert (verdict.status == OBSTACLE) == (verdict.mean is not None and verdict.mean > 0.345)
        if verdict.status == OBSTACLE:
            assert verdict.mean == 255 * np.mean((scores > 0) | state.confirmed)
        if verdict.status == CLEAR:
            assert verdict.mean == 0 and verdict.box is None
        over = scores is not None and bool((scores > 0.5).any())
        told = "frame rule" in verdict.health
        # Unknown with scores is the rule's doing, also where this frame alone shows nothing.
        decided = verdict.status == UNKNOWN or (verdict.status == OBSTACLE) != over
        assert told == (scores is not None and decided)


def test_one_patch_of_a_fine_grid_is_no_status_for_the_rule_either():
    """Its mean is below the thesis's limit: what v1 calls 0 is no alarm."""
    few, many = np.full(900, -1.0), np.full(900, -1.0)
    few[7], many[7:9] = 1, 1
    grid = Grid(30, 30, 90)
    policy = SinglePolicy(TextureDetector(Script(MofNRule(m=2, n=2), [many, few, many], grid)))
    verdicts = [policy.judge(frame).verdict for frame in frames([0, 0, 0])]
    assert [verdict.status for verdict in verdicts] == [UNKNOWN, CLEAR, CLEAR]


class Says:
    method = "disparity"

    def __init__(self, white: bool) -> None:
        self.mask = np.full((60, 60), 255 * white, np.uint8)

    def detect(self, frame: Frame) -> Detection:
        return Detection(self.mask, self.method)


@pytest.mark.parametrize("policy", [EitherPolicy, FallbackPolicy])
@pytest.mark.parametrize(("white", "status"), [(False, UNKNOWN), (True, OBSTACLE)])
def test_no_other_detector_s_clear_stands_against_a_waiting_alarm(policy, white, status):
    texture = TextureDetector(Script(MofNRule(m=2, n=3), [[1, 1, 1, 1]]))
    verdict = policy(texture, Says(white)).judge(frames([0])[0]).verdict
    assert verdict.status == status
    assert "frame rule waits, frames before are not known: 4 patches over" in verdict.health


def test_the_loop_applies_the_rule_across_a_frame_that_cannot_be_read(
    make_mission, bundle_file, receiver, tmp_path
):
    """2 of 3: nothing, patch, same patch, unreadable, same, nothing, nothing, (gap) twice."""
    seen = [[], [(4, 4)], [(4, 4)], [(0, 0)], [(4, 4)], [], [], [(1, 1)], [(1, 1)], [(1, 1)]]
    folder = make_mission(seen)
    (folder / "Left" / "t_L_4.jpg").write_bytes(b"no picture")
    log = tmp_path / "log.jsonl"
    file = variant(bundle_file, tmp_path / "ruled.tokt", rule=MofNRule(0, 1, 2, 3))
    ran = succeeds(
        *("run", "--bundle", file, "--source", folder, "--policy", "texture", "--json"),
        *("--frames", "1-7,9-10", "--udp", f"127.0.0.1:{receiver.getsockname()[1]}"),
        *("--log", log),
    )
    assert "in 2 of 3 frames; a status comes 1 frame after" in ran.err
    summary = json.loads(ran.out)
    assert (summary["latency_frames"], summary["frame_rule"]["window"]) == (1, 3)
    said = lines(log)
    # Frame 2 alarms first, and only what was before the run could still make it a status; so
    # could frame 4, had it been read, in frame 6.
    assert [line["status"] for line in said] == [0, -1, 1, -1, 1, -1, 0, -1, 1]
    assert [(line["mean"] or 0) > 0.345 for line in said] == [line["status"] == 1 for line in said]
    assert "waits" in said[1]["health"] and said[2]["health"] == "ok"
    heard = [receiver.recv(4096).split(b",")[1].strip() for _ in range(5)]
    assert heard == [b"0", b"1", b"1", b"0", b"1"]


def test_a_source_counts_missing_frames_by_their_place_and_not_by_their_numbers(
    make_mission, hand_clock
):
    folder = make_mission([[]] * 6)
    for camera, letter in (("Left", "L"), ("Right", "R")):
        for number in range(6, 0, -1):
            file = folder / camera / f"t_{letter}_{number}.jpg"
            file.rename(file.with_name(f"t_{letter}_{5 * number}.jpg"))
        (folder / camera / f"t_{letter}_20.jpg").unlink()

    def missed(*frames: int) -> list[int]:
        source = open_source(str(folder), hand_clock, frames or None, stereo=False)
        return [frame.missed for frame in source]

    assert missed() == [0, 0, 0, 0, 0]
    assert missed(10, 30) == [0, 2]
