import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.inference.test_faults import hold_row
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import guarded
from tokt.inference.reason import Reason
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.pair_health import open_water_fault
from tokt.inference.stereo.pushbroom import PushbroomDetector
from tokt.inference.stereo.rectify import Rectifier
from tokt.inference.verdict import verdict_from_mask

from .plain_rig import PLAIN, lit_sea, sea_trial

DISPARITY_PX = 132  # at full size: 2200 * 0.3 / 132 = 5 m
SIDE_PX = 160


def faint_pair(number: int, shift_px: int | None = DISPARITY_PX) -> tuple[np.ndarray, np.ndarray]:
    """Noisy lit water with one square of 1.5 grey levels' texture; no square without a shift."""
    left, right = lit_sea(number)
    texture = np.random.default_rng(1).normal(0, 1.6, (SIDE_PX // 8, SIDE_PX // 8))
    square = cv2.resize(texture, (SIDE_PX, SIDE_PX))
    if shift_px is not None:
        for view, x in ((left, 700), (right, 700 - shift_px)):
            view[400 : 400 + SIDE_PX, x : x + SIDE_PX] += square
    return tuple(view.round().clip(0, 255).astype(np.uint8) for view in (left, right))


def sea_floor(number: int) -> list[np.ndarray]:
    """The lower half of noisy lit water is sand 3 m away, a little of which goes by each frame."""
    coarse = np.random.default_rng(2).normal(0, 1.4, (48, 160))
    sand, shift_px, x = cv2.resize(coarse, (1920, 576)), 220, 230 + 15 * number
    views = lit_sea(number)
    for view, start in zip(views, (x, x + shift_px), strict=True):
        view[-576:] += sand[:, start : start + view.shape[1]]
    return [view.round().clip(0, 255).astype(np.uint8) for view in views]


def edge_alone(number: int) -> list[np.ndarray]:
    """A tower's edge 5 m away, so far to the left that the right camera does not see it."""
    left, right = lit_sea(number)
    left[:, :100] += cv2.resize(np.random.default_rng(3).normal(10, 4, (128, 13)), (100, 1024))
    return [view.round().clip(0, 255).astype(np.uint8) for view in (left, right)]


def status(found) -> int:
    return -1 if found.mask is None else verdict_from_mask(found.mask, "disparity").status


def statuses(frames, detector=None):
    detector = DisparityDetector(PLAIN, Grid()) if detector is None else detector
    return [detector.detect(frame) for frame in frames]


BOTH = pytest.mark.parametrize("stereo", [DisparityDetector, PushbroomDetector])


@BOTH
def test_what_one_pair_shows_too_faintly_is_an_obstacle_after_four_of_six(stereo):
    frames = (Frame(n, 0.0, *faint_pair(n)) for n in range(1, 6))
    found = statuses(frames, stereo(PLAIN, Grid()))
    assert [status(one) for one in found] == [-1, -1, -1, 1, 1]
    assert found[0].fault.reason is Reason.FRAME_RULE and found[0].vetoes_clear
    assert (
        found[3].distance_m == pytest.approx(5.0, rel=0.03) and "4 of the last 6" in found[3].note
    )
    x, y, width, height = verdict_from_mask(found[3].mask, "disparity").box
    assert x <= 740 * 360 / 1360 <= x + width and y <= 440 * 271 / 1024 <= y + height


def test_it_is_held_while_four_of_six_frames_have_it_and_then_the_water_is_clear():
    seen = [Frame(n, 0.0, *faint_pair(n)) for n in range(1, 7)]
    gone = [Frame(n, 0.0, *faint_pair(n, None)) for n in range(7, 11)]
    assert [status(one) for one in statuses([*seen, *gone])[6:]] == [1, 1, 0, 0]


def test_a_frame_that_is_missing_is_no_frame_without_it():
    water = [Frame(n, 0.0, *faint_pair(n, None)) for n in range(1, 7)]
    one = Frame(7, 0.0, *faint_pair(7))
    assert status(statuses([*water, one])[-1]) == 0
    late = Frame(10, 0.0, *faint_pair(10), missed=3)
    found = statuses([*water, late])[-1]
    assert found.mask is None and found.fault.reason is Reason.FRAME_RULE


def test_a_pair_at_which_the_detector_fails_is_no_frame_without_it():
    detector = DisparityDetector(PLAIN, Grid())
    statuses((Frame(n, 0.0, *faint_pair(n, None)) for n in range(1, 7)), detector)
    matcher, detector._matcher = detector._matcher, None
    for number in range(7, 11):
        found = guarded(detector, Frame(number, 0.0, *faint_pair(number)))
        assert found.fault.reason is Reason.DETECTOR_FAILED
    detector._matcher = matcher
    assert detector.detect(Frame(11, 0.0, *faint_pair(11))).fault.reason is Reason.FRAME_RULE


@BOTH
def test_faint_texture_that_stays_and_matches_nowhere_is_unknown(stereo):
    # 0.6 m away: nearer than is searched.
    frames = (Frame(n, 0.0, *faint_pair(n, 690)) for n in range(1, 7))
    found = statuses(frames, stereo(PLAIN, Grid()))
    assert all(one.mask is None and one.vetoes_clear for one in found)
    assert "do not match" in found[-1].fault


@BOTH
def test_a_sea_floor_too_faint_for_one_pair_is_an_obstacle(stereo):
    frames = (Frame(n, 0.0, *sea_floor(n)) for n in range(1, 8))
    assert [status(one) for one in statuses(frames, stereo(PLAIN, Grid()))] == [-1] * 3 + [1] * 4
    hold_row(
        "sea floor 3 m away, of 0.9 grey levels' texture (stereo)",
        "obstacle; before, unknown `frame_rule` while frames are not known",
        "frames by reason",
    )


@BOTH
def test_an_edge_that_only_the_left_camera_sees_is_unknown(stereo):
    frames = (Frame(n, 0.0, *edge_alone(n)) for n in range(1, 8))
    found = statuses(frames, stereo(PLAIN, Grid()))
    assert all(one.mask is None and one.vetoes_clear for one in found)
    assert {one.fault.reason for one in found} == {Reason.STEREO}
    hold_row(
        "a tower's edge that the left camera alone sees (stereo)",
        "unknown `stereo`",
        "frames by reason",
    )


def test_the_documented_rows_of_what_is_faint():
    found = statuses(Frame(n, 0.0, *faint_pair(n)) for n in range(1, 6))
    assert [one.fault.reason for one in found[:3]] == [Reason.FRAME_RULE] * 3 and found[
        3
    ].mask.any()
    hold_row(
        "too faint for one pair, there in 4 of 6 (stereo)",
        "obstacle; before, unknown `frame_rule` while frames are not known",
        "frames by reason",
    )
    found = statuses(Frame(n, 0.0, *faint_pair(n, 690)) for n in range(1, 7))
    assert found[-1].fault.reason is Reason.STEREO
    hold_row(
        "faint texture that stays and matches nowhere (stereo)",
        "unknown `stereo`",
        "frames by reason",
    )


def hazy(view: np.ndarray) -> np.ndarray:
    return 0.5 * view + 50


def glowing(view: np.ndarray) -> np.ndarray:
    return 0.5 * view + np.linspace(0, 120, len(view))[:, None]


def enlarged(view: np.ndarray) -> np.ndarray:
    height, width = view.shape
    part = view[height // 4 : -(height // 4), width // 4 : -(width // 4)]
    return cv2.resize(part, (width, height))


def turned(quarters: int):
    return lambda view: cv2.resize(np.rot90(view, quarters), view.shape[::-1])


LOST = {
    "hazy": hazy,
    "raised": lambda view: view + 60,
    "glowing": glowing,
    "inverted": lambda view: 255 - view,
    "enlarged": enlarged,
    "blurred": lambda view: cv2.GaussianBlur(view, (0, 0), 8),
}
TURNED = {
    "90": turned(1),
    "180": turned(2),
    "270": turned(3),
    "mirrored": lambda view: view[:, ::-1],
    "upside down": lambda view: view[::-1],
}


def judged_with(change, sides: str, stereo=DisparityDetector):
    """The sixth pair of open water with one or both views changed."""
    detector = stereo(PLAIN, Grid())
    for number in range(1, 7):
        views = [
            change(view) if side in sides else view
            for side, view in zip("lr", lit_sea(number), strict=True)
        ]
        pictures = [np.ascontiguousarray(view.round().clip(0, 255), np.uint8) for view in views]
        found = detector.detect(Frame(number, 0.0, *pictures))
    return found


@BOTH
def test_open_water_is_clear(stereo):
    assert status(judged_with(None, "", stereo)) == 0


@BOTH
@pytest.mark.parametrize("sides", ["lr", "l", "r"])
@pytest.mark.parametrize("name", LOST)
def test_water_that_has_lost_its_contrast_is_unknown(name, sides, stereo):
    found = judged_with(LOST[name], sides, stereo)
    assert found.mask is None
    if sides == "lr":  # one alone is also much brighter than the other
        assert found.vetoes_clear and found.fault.reason is Reason.STEREO
    hold_row(
        "open water in haze, under glow, inverted, enlarged or blurred (stereo)",
        "unknown `stereo`",
        "frames by reason",
    )


def test_a_pair_that_is_not_believed_is_no_frame_without_it():
    water = [Frame(n, 0.0, *faint_pair(n, None)) for n in range(1, 7)]
    views = [[hazy(view).round().astype(np.uint8) for view in lit_sea(n)] for n in range(7, 11)]
    lost = [Frame(7, 0.0, *pair) for pair in views]
    found = statuses([*water, *lost, Frame(11, 0.0, *faint_pair(11))])
    assert [status(one) for one in found[5:]] == [0, -1, -1, -1, -1, -1]
    hold_row(
        "haze while something faint comes into view, then none (`disparity`)",
        f"unknown `{found[-2].fault.reason}`, then unknown `{found[-1].fault.reason}`",
        "frames by reason",
    )


@BOTH
@pytest.mark.parametrize("sides", ["l", "r"])
@pytest.mark.parametrize("name", TURNED)
def test_a_view_turned_against_the_other_is_unknown_in_open_water_too(name, sides, stereo):
    found = judged_with(TURNED[name], sides, stereo)
    assert found.mask is None and found.vetoes_clear and "not alike" in found.fault
    hold_row(
        "one view turned or mirrored, in open water (stereo)",
        "unknown `stereo`",
        "frames by reason",
    )


@BOTH
def test_one_picture_in_both_places_is_unknown(stereo):
    left, _ = faint_pair(1, None)
    found = stereo(PLAIN, Grid()).detect(Frame(1, 0.0, left, left.copy()))
    assert found.mask is None and found.vetoes_clear and "one and the same" in found.fault
    hold_row("one camera's picture in both places (stereo)", "unknown `stereo`", "frames by reason")


@pytest.mark.mission
@pytest.mark.parametrize("number", [50, 104, 216, 237, 246])
def test_the_light_of_swapped_cameras_is_told_without_anything_to_match(
    number, mission, calibration_path
):
    rectifier = Rectifier(load_calibration(calibration_path), 0.5)
    left, right = (sea_trial(mission, side, number) for side in ("Left", "Right"))
    assert open_water_fault(rectifier.left(left), rectifier.right(right)) is None
    swapped = open_water_fault(rectifier.left(right), rectifier.right(left))
    assert swapped is not None and "not alike" in swapped.reason


def labelled(path: Path) -> set[int]:
    with path.open() as rows:
        of_obstacles = (row for row in csv.DictReader(rows) if row["label"] == OBSTACLE_CLASS)
        return {int(row["frame"]) for row in of_obstacles}


OBSTACLE_CLASS = "subsea_installation"


@pytest.fixture(scope="module", params=[DisparityDetector, PushbroomDetector])
def whole_run(mission, calibration_path, request):
    """A detector's status of every frame of the sea trial, in their order."""
    detector = request.param(load_calibration(calibration_path), Grid())
    pairs = (
        (n, [sea_trial(mission, side, n) for side in ("Left", "Right")]) for n in range(1, 247)
    )
    return {number: status(detector.detect(Frame(number, 0.0, *pair))) for number, pair in pairs}


@pytest.mark.mission
@pytest.mark.study
def test_no_labelled_frame_of_the_sea_trial_is_clear_and_no_water_an_obstacle(mission, whole_run):
    tower = labelled(mission / "labels.csv")
    assert len(tower) == 107
    seen = [whole_run[number] for number in tower]
    assert 0 not in seen and seen.count(-1) <= 4  # pushbroom: between two of its distances
    water = [whole_run[number] for number in range(1, 132)]
    assert 1 not in water and water.count(-1) <= 3
