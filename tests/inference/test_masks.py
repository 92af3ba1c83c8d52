"""What is no view in a run: said on the command line, beside the frames, or kept with the model."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.calls import call_tokt, refused, succeeds
from tests.inference.conftest import draw, sight_of_drawn
from tests.inference.logged_runs import lines
from tests.inference.stereo.plain_rig import PLAIN, lit_sea
from tokt.features.frames.grid import DEFAULT_GRID, Grid
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import CameraMasks, ViewMask, parse_masks, write_masks
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.config import Limits
from tokt.inference.frame import Frame
from tokt.inference.freshness.frozen_frames import StuckFrameDetector
from tokt.inference.monitoring.fixed_marks_watch import FixedMarksWatch
from tokt.inference.policy.assembly import StereoSetup, assemble
from tokt.inference.policy.policy import SinglePolicy
from tokt.inference.recording.run_log import events_path
from tokt.inference.report import Report
from tokt.inference.sight import SightMeter
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.texture.detector import TextureDetector
from tokt.inference.verdict import CLEAR, OBSTACLE, UNKNOWN
from tokt.models.bundle.bundle import read_bundle
from tokt.models.sight import hides_too_much, measure_sight

from .conftest import NoiseScorer
from .test_faults import hold_row

CLOCK = [(0, 8), (0, 9)]  # patches with noise in each frame, as a clock that runs
MASK = ("--mask", "0.8,0,0.2,0.1")


@pytest.fixture
def dive(make_mission):
    return make_mission([[*CLOCK, *more] for more in ([], [], [(5, 5)], [], [])])


@pytest.fixture
def run(bundle_file, tmp_path):
    """Run policy texture; the verdicts as the log has them."""

    def log(source, *options):
        file = tmp_path / f"run{len([*tmp_path.glob('run*.jsonl')])}.jsonl"
        where = ("--bundle", bundle_file, "--source", source, "--policy", "texture")
        ran = succeeds("run", *where, "--log", file, *options)
        return lines(file), ran.err, file

    return log


def statuses(verdicts):
    return [line["status"] for line in verdicts]


def test_a_masked_patch_is_neither_obstacle_nor_clear(run, dive):
    seen, _, _ = run(dive)
    assert statuses(seen) == [OBSTACLE] * 5
    seen, said, _ = run(dive, *MASK)
    assert statuses(seen) == [CLEAR, CLEAR, OBSTACLE, CLEAR, CLEAR]
    x, _, wide, _ = seen[2]["box"]
    assert x + wide <= 6 * 36, "only the obstacle is in the box"
    assert seen[0]["sight"] == {"seen": [0.98], "masked": [0.02]}
    assert "masked as no view: 2.0 % of the left view" in said
    # Of one camera alone, and by a file.
    assert statuses(run(dive, "--mask", "right:0.8,0,0.2,0.1")[0]) == [OBSTACLE] * 5
    config = dive.parent / "run.toml"
    for mask in (
        '["left:0.8,0,0.2,0.1"]',
        "[[0.8, 0, 0.2, 0.1]]",
        "[0.8, 0, 0.2, 0.1]",
        '"0.8,0,0.2,0.1"',
    ):
        config.write_text(f"[source]\nmask = {mask}\n")
        assert statuses(run(dive, "--config", config)[0]) == statuses(seen)


def test_the_mask_of_a_dive_is_used_told_and_replayed(run, dive):
    write_masks(dive, parse_masks(["left:0.8,0,0.2,0.1"]))
    seen, said, log = run(dive)
    assert statuses(seen) == [CLEAR, CLEAR, OBSTACLE, CLEAR, CLEAR] and "masked as no view" in said
    start = lines(events_path(log))[0]
    assert start["masks"] == {"format": 1, "left": [[0.8, 0.0, 0.2, 0.1]]}
    # A replay goes by what the run had, whatever is beside the frames now.
    write_masks(dive, CameraMasks())
    ran = succeeds("replay", log, "--json")
    assert json.loads(ran.out)["same"]
    write_masks(dive, parse_masks(["left:0.8,0,0.2,0.1"]))
    seen, said, _ = run(dive, "--mask", "none")
    assert statuses(seen) == [OBSTACLE] * 5 and "is not used" in said


def test_masks_that_cannot_be_meant_are_refused(dive, bundle_file):
    where = ("run", "--bundle", bundle_file, "--source", dive, "--policy", "texture")
    refused("At most 80 %", *where, "--mask", "0,0,1,0.8")
    refused("nothing was masked", *where, "--mask", "model")
    refused("a mask is a picture", *where, "--mask", "clock")


def test_a_recording_keeps_the_mask(run, dive, tmp_path):
    run(dive, *MASK, "--record", tmp_path / "kept")
    (recording,) = (path for path in (tmp_path / "kept").iterdir() if path.is_dir())
    mission = open_mission(recording)
    assert mission.masks == parse_masks(["0.8,0,0.2,0.1"])
    # Its pictures are as the camera gave them.
    frame = mission.frames()[-1]
    np.testing.assert_array_equal(mission.read(frame), open_mission(dive).read(frame))
    assert call_tokt("replay", recording, "--json").code == 0


def test_marks_that_never_move_are_named_with_the_words_that_mask_them(run, tmp_path):
    folder = tmp_path / "clock"
    folder.mkdir()
    for number in range(1, 46):
        picture = draw([], number)
        picture[:27, 288:] = draw(CLOCK, 1)[:27, 288:]  # the same in each frame
        cv2.imwrite(str(folder / f"a_{number}.png"), picture)
    seen, said, log = run(folder)
    assert statuses(seen).count(OBSTACLE) == 45
    (event,) = (line for line in lines(events_path(log)) if line["event"] == "fixed_marks")
    assert event["camera"] == "left" and event["obstacles"] == event["frames"] == 40
    assert event["words"] in said and "40 of 40 frames were called an obstacle" in said
    options = " ".join(re.findall(r"--mask left:\S+", event["words"])).split()
    seen, said, _ = run(folder, *options)
    assert statuses(seen) == [CLEAR] * 45 and "never moved" not in said


def clock(picture, number):
    cv2.putText(picture, f"12:{number:02d}", (290, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 2)


def reflection(picture, number):
    cv2.circle(picture, (300, 40), 22, 200, 2)
    cv2.circle(picture, (300, 40), 6, 255, -1)


def horizon(picture, number):
    rise, pitch = round(12 * np.sin(number / 4)), 135 + round(8 * np.sin(number / 3))
    cv2.line(picture, (100, pitch - rise), (260, pitch + rise), 255, 1)


def free_water(number):
    """Water without the edges that `draw` has in each frame."""
    return np.random.default_rng(number).normal(40, 2, (271, 360)).astype(np.uint8)


@pytest.mark.parametrize(
    ("fault", "box"), [(clock, "0.8,0,0.2,0.1"), (reflection, "0.7,0,0.3,0.3"),
                       (horizon, "0.2,0.4,0.6,0.2")]
)  # fmt: skip
def test_what_is_drawn_on_the_picture_is_an_obstacle_until_it_is_masked(fault, box):
    told = []
    for masks in (None, parse_masks([box])):
        policy, watch = (
            SinglePolicy(TextureDetector(NoiseScorer())),
            FixedMarksWatch(SYSTEM_CLOCK, told.append),
        )
        said = set()
        for number in range(1, 45):
            picture = free_water(number)
            fault(picture, number)
            frame = Frame(number, float(number), picture, None, masks=masks)
            judgement = policy.judge(frame)
            said.add(judgement.verdict.status)
            report = Report(number, number, frame.t, None, judgement.verdict)
            watch.judged(frame, judgement, report)
        assert said == {OBSTACLE if masks is None else CLEAR}
    moves = fault is horizon
    assert len(told) == (0 if moves else 1)
    hold_row(
        "a thin horizon that rolls, without a mask"
        if moves
        else "a clock, or a lamp's reflection in the dome, without a mask",
        "obstacle",
        "nothing" if moves else "event `fixed_marks`",
    )
    hold_row("a clock, a reflection or a horizon that is masked", "as without it", "nothing")


def test_a_label_over_much_of_the_view_is_frozen_unless_it_is_masked():
    label = np.random.default_rng(0).integers(0, 255, (36, 360), np.uint8)
    masks = parse_masks(["0,0,1,0.14"])
    for known, still, frozen in (
        (None, False, True),  # much of the picture never changes
        (masks, False, False),
        (masks, True, True),  # what is seen stands still, and the label runs on
    ):
        detector = StuckFrameDetector(Limits())
        gone = 0
        for number in range(1, 30):
            picture = free_water(1 if still else number)
            picture[:36] = np.roll(label, number, 1) if still else label
            frame = Frame(number, float(number), picture, None, masks=known)
            seen = detector.remove(frame)
            assert seen.left is None or seen.left is picture, "it stays as the camera gave it"
            gone += seen.left is None
            detector.prepare()
        assert (gone > 15) == frozen and (gone == 0) != frozen


def test_a_grid_of_which_each_patch_is_masked_sees_nothing():
    """Stripes that leave most of a finer grid."""
    masks = parse_masks(["0.1,0,0.05,1", "0.45,0,0.05,1", "0.8,0,0.05,1"])
    for grid, status in ((Grid(3, 3, 360), UNKNOWN), (DEFAULT_GRID, CLEAR)):
        policy = SinglePolicy(TextureDetector(NoiseScorer(grid=grid)))
        verdict = policy.judge(Frame(1, 0.0, free_water(1), None, masks=masks)).verdict
        assert verdict.status == status
        assert status == CLEAR or "each patch of the model's grid is masked" in verdict.health


def test_a_frame_is_covered_and_measured_once_for_all_who_look_at_it(monkeypatch):
    covered, measured = [], []
    own_cover, own_measure = ViewMask.cover, SightMeter._measured
    monkeypatch.setattr(
        ViewMask, "cover", lambda mask, picture: covered.append(1) or own_cover(mask, picture)
    )
    monkeypatch.setattr(
        SightMeter, "_measured", lambda *given: measured.append(1) or own_measure(*given)
    )
    scorer = NoiseScorer(frame_sizes=((1024, 1360),))
    scorer.sight = sight_of_drawn()
    policy = assemble("fallback", lambda: scorer, StereoSetup(PLAIN)).policy
    stuck = StuckFrameDetector(Limits())
    for seed in range(1, 4):
        frame = Frame(seed, seed / 10, *clocked(lit_sea(seed), ()), timed=True)
        frame = stuck.remove(replace(frame, masks=parse_masks(["0.8,0,0.2,0.1"])))
        assert "texture" in policy.judge(frame).verdict.health, "stereo was asked as well"
    assert len(covered) == 2 * 3, "left and right of each frame"
    assert len(measured) == 2 * 3, "left and right of each frame, by whoever comes first"


def test_exchanged_colour_channels_are_nothing_to_a_model_that_looks_at_gray(bundle_file):
    model = read_bundle(bundle_file)
    for patches, status in (([], CLEAR), ([(4, 5)], OBSTACLE)):
        picture = draw(patches, 7)
        coloured = np.dstack([picture, picture, cv2.add(picture, 6)])
        for one in (coloured, np.ascontiguousarray(coloured[..., ::-1])):
            policy = SinglePolicy(TextureDetector(model))
            assert policy.judge(Frame(1, 0.0, one, None)).verdict.status == status
    row = "colour channels exchanged, for a model that looks at gray"
    hold_row(row, "as without it", "nothing")


def judged(masks, picture, number=1):
    frame = Frame(number, float(number), picture, None, masks=masks)
    scorer = NoiseScorer()
    scorer.sight = sight_of_drawn()
    return SinglePolicy(TextureDetector(scorer)).judge(frame)


def test_what_is_beside_a_mask_is_seen():
    """A rim of the lens hides nothing of what is inside it, and spoils no measure of it."""
    rows, columns = np.mgrid[:271, :360]
    rim = np.hypot(rows - 135, columns - 180) > 150
    masks = CameraMasks(ViewMask.of_picture(rim.astype(np.uint8) * 255))
    picture = draw([], 3)
    picture[rim] = 0
    assert judged(None, picture).verdict.status != CLEAR
    found = judged(masks, picture)
    assert found.verdict.status == CLEAR and found.verdict.sight["masked"][0] > 0.1
    assert found.verdict.sight["masked"][0] + found.verdict.sight["seen"][0] > 0.97
    inside = picture.copy()
    inside[draw([(5, 4)], 3) > 60] = 200
    assert judged(masks, inside).verdict.status == OBSTACLE


def test_masked_patches_say_nothing_of_what_training_frames_show():
    masks = parse_masks(["0,0,0.3,1"])
    frames = [draw([], seed) for seed in range(12)]
    dark = [frame.copy() for frame in frames]
    for frame in dark:
        frame[:, :108] = 0
    (spoilt,) = measure_sight(dark)
    (good,) = measure_sight((masks.left.cover(one) for one in dark), [masks.left] * len(dark))
    (whole,) = measure_sight(frames)
    assert spoilt.darkest == 0.0 < good.darkest
    np.testing.assert_allclose(good.limits, whole.limits, atol=0.3)


def test_a_frame_is_clear_by_the_part_of_it_that_is_view():
    unseen, masked = np.zeros((10, 10), bool), np.zeros((10, 10), bool)
    unseen[0, ::2] = unseen[9, ::2] = True  # 10 of 100, scattered
    assert not hides_too_much(unseen)
    masked[:, :2] = True
    unseen[5, 2] = True  # 8 that are in view, of 80, and one more
    assert hides_too_much(unseen, masked)
    unseen[:, :] = masked
    assert not hides_too_much(unseen, masked)
    meter = SightMeter(sight_of_drawn())
    frame = Frame(1, 0.0, draw([], 1), None, masks=parse_masks(["0.8,0,0.2,0.1"])).covered
    found = meter.of(frame)
    assert found.masked.sum() == 2 and found.share < 0.99 and not found.fault


def clocked(views, cameras):
    pictures = [np.clip(np.rint(view), 0, 255).astype(np.uint8) for view in views]
    for camera in cameras:
        for line in range(4):
            at = 60, 120 + 90 * line
            cv2.putText(pictures[camera], "DIVE 7 12:07:31", at, 0, 2.4, 255, 6)
    return pictures


@pytest.mark.parametrize("detector", [DisparityDetector, PushbroomDetector])
@pytest.mark.parametrize("cameras", [(0,), (1,), (0, 1)])
def test_stereo_looks_past_what_is_masked(detector, cameras):
    masks = parse_masks(["0.02,0,0.6,0.42"])
    looks = {"free": (None, ()), "marked": (None, cameras), "masked": (masks, cameras)}
    found = {}
    for name, (what, on) in looks.items():
        eye = detector(PLAIN, DEFAULT_GRID)
        for seed in range(1, 4):
            frame = Frame(seed, float(seed), *clocked(lit_sea(seed), on), masks=what)
            found[name] = SinglePolicy(eye).judge(frame).verdict
    assert found["free"].status == CLEAR, found["free"].health
    assert found["marked"].status != CLEAR
    assert found["masked"].status == CLEAR, found["masked"].health
