from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.stereo import pushbroom
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.odometry import Odometry, parse_odometry
from tokt.inference.stereo.pushbroom import DISTANCES_M, KEPT_FRAMES, PushbroomDetector
from tokt.inference.verdict import Detection, verdict_from_mask

from .plain_rig import (
    BASELINE_M,
    CENTRE,
    FOCAL_PX,
    PLAIN,
    SQUARE_PX,
    WIDTH,
    lamp_light,
    lit_sea,
    pair_with,
    sea_trial_pair,
    square_texture,
    unfit_pairs,
)

FOCAL_BASELINE = FOCAL_PX * BASELINE_M
X, Y = 780, 350
MASK = 360 / WIDTH
CELL = 4 / MASK  # pixels at full size


def draw(distance_m: float, texture: np.ndarray | None = None, x: int = X, y: int = Y):
    """An even sea with one thing in it, at (x, y) in the left view and at a distance."""
    texture = square_texture(40) if texture is None else texture
    return pair_with(texture, x, y, round(FOCAL_BASELINE / distance_m))


EMPTY = tuple(view.round().astype(np.uint8) for view in lit_sea(1))


@pytest.fixture
def detector():
    return PushbroomDetector(PLAIN, Grid())


def corners(found: Detection) -> np.ndarray:
    """Of the verdict's box, in pixels at full size."""
    assert found.mask is not None and found.mask.shape == (271, 360)
    verdict = verdict_from_mask(found.mask, found.method)
    assert verdict.status == 1 and verdict.box is not None
    x, y, width, height = verdict.box
    return np.array([x, y, x + width, y + height]) / MASK


def is_clear(found: Detection) -> bool:
    return found.mask is not None and not found.mask.any() and found.distance_m is None


@pytest.mark.parametrize("distance_m", [*DISTANCES_M, 3.9, 6.25])
def test_what_stands_at_a_distance_is_found_where_it_is(detector, distance_m):
    found = detector.detect(Frame(1, 0.0, *draw(distance_m)))
    assert found.distance_m == pytest.approx(distance_m, rel=0.03)
    square = np.array([X, Y, X + SQUARE_PX, Y + SQUARE_PX])
    assert np.abs(corners(found) - square).max() <= 1.5 * CELL + 2 / MASK
    assert found.note == "pushbroom sees only at 8, 6, 4, 3 and 2 m"


@pytest.mark.parametrize("distance_m", [1.5, 2.4, 5.0, 12.0])
def test_what_stands_elsewhere_is_not_found_and_not_called_clear(detector, distance_m):
    found = detector.detect(Frame(1, 0.0, *draw(distance_m)))
    assert found.mask is None and found.vetoes_clear
    assert found.fault.startswith("something is in view, but at none of 8, 6, 4, 3 and 2 m")


def slanting_bar() -> np.ndarray:
    """A bar that is nearly horizontal: it looks the same a little to the side, a little lower."""
    rows, columns = np.mgrid[:120, :700]
    return np.where(np.abs(rows - 30 - columns / 12) < 12, 110.0, 35.0)


def fence() -> np.ndarray:
    """Bars 38 pixels apart: what stands at 3.5 m matches as well as if it stood at 3 m."""
    return 60 + 40 * np.sin(np.arange(500) * 2 * np.pi / 38)[None].repeat(240, 0)


@pytest.mark.parametrize("texture", [slanting_bar, fence])
def test_what_matches_at_other_disparities_as_well_is_no_hit(detector, texture, monkeypatch):
    between = draw(3.5, texture(), x=560)
    assert not detector.look(*between).any()
    monkeypatch.setattr(pushbroom, "INVARIANCE_RATIO", 1e6)  # without the invariance filter
    assert detector.look(*between).any()


def test_an_obstacle_is_remembered_for_some_frames_as_it_was(detector):
    first = detector.detect(Frame(1, 0.0, *draw(4.0)))
    then = detector.detect(Frame(2, 0.0, *EMPTY))
    assert then.distance_m == first.distance_m and (corners(then) == corners(first)).all()
    assert "1 frame ago" in then.note and "there is no odometry" in then.note
    missing = Fault(Reason.MISSING, "no right frame 3")
    lost = detector.detect(Frame(3, 0.0, EMPTY[0], None, NO_FAULT, missing))
    assert lost.mask is None and lost.fault == "no right frame 3" and lost.vetoes_clear
    late = detector.detect(Frame(KEPT_FRAMES + 1, 0.0, *EMPTY, missed=KEPT_FRAMES - 3))
    assert corners(late).any()
    assert is_clear(detector.detect(Frame(KEPT_FRAMES + 2, 0.0, *EMPTY)))


def poses(*lines: str) -> Odometry:
    return parse_odometry("\n".join(["frame,t,x_m,y_m,z_m,qw,qx,qy,qz", *lines]), "test")


def test_odometry_carries_an_obstacle_to_where_it_is_now():
    # 1.5 m forward in three frames, one without a pose; then a turn of 60 degrees to the right.
    ahead = [f"{frame},0,5,5,{z_m},1,0,0,0" for frame, z_m in ((1, 5), (2, 5.5), (4, 6.5))]
    path = poses(*ahead, "5,0,5,5,6.5,.86602,0,.5,0")
    detector = PushbroomDetector(PLAIN, Grid(), odometry=path)
    square = np.array([[X, Y], [X + SQUARE_PX, Y + SQUARE_PX]])
    for number, distance_m in ((1, 4.0), (2, 3.5), (3, 3.5), (4, 2.5)):
        found = detector.detect(Frame(number, 0.0, *(draw(4.0) if number == 1 else EMPTY)))
        assert found.distance_m == pytest.approx(distance_m, rel=0.03)
        grown = ((square - CENTRE) * 4 / distance_m + CENTRE).ravel()
        assert np.abs(corners(found) - grown).max() <= 3 * CELL
        inside = (corners(found) * MASK).round().astype(int)
        whole = found.mask[inside[1] : inside[3], inside[0] : inside[2]]
        assert (whole > 0).mean() > 0.93  # no gaps between what has come apart
        assert ("there is no odometry" in found.note) == (number == 3)
    assert is_clear(detector.detect(Frame(5, 0.0, *EMPTY)))


def test_what_was_passed_is_forgotten():
    path = poses("1,0,0,0,0,1,0,0,0", "2,0,0,0,4.5,1,0,0,0", "3,0,0,0,0,1,0,0,0")
    detector = PushbroomDetector(PLAIN, Grid(), odometry=path)
    for number in range(-5, 1):  # before, nobody knows what stays
        detector.detect(Frame(number, 0.0, *EMPTY))
    detector.detect(Frame(1, 0.0, *draw(4.0)))
    assert is_clear(detector.detect(Frame(2, 0.0, *EMPTY)))


def test_what_was_met_before_the_poses_came_back_is_still_ahead():
    """1 m a frame, and the first and last pose only: seen on the way at 4 m, now 3 m away."""
    path = poses("1,0,0,0,0,1,0,0,0", "5,0,0,0,4,1,0,0,0")
    detector = PushbroomDetector(PLAIN, Grid(), odometry=path)
    for number in range(1, 5):
        detector.detect(Frame(number, 0.0, *(draw(4.0) if number == 4 else EMPTY)))
    found = detector.detect(Frame(5, 0.0, *EMPTY))
    assert found.distance_m == pytest.approx(3.0, rel=0.03)


def test_what_is_remembered_but_has_become_too_small_is_not_clear():
    path = poses("1,0,0,0,0,1,0,0,0", "2,0,0,0,-6,1,0,0,0")
    detector = PushbroomDetector(PLAIN, Grid(), odometry=path)
    small = cv2.resize(np.random.default_rng(8).uniform(20, 120, (12, 12)), (60, 60))
    assert detector.detect(Frame(1, 0.0, *draw(2.0, small))).distance_m is not None
    found = detector.detect(Frame(2, 0.0, *EMPTY))
    assert found.mask is None and found.vetoes_clear and "met before" in found.fault


def noise(seed: int, light: float = 1.0) -> np.ndarray:
    """Open water, never twice the same."""
    view = lit_sea(seed)[0] + (light - 1) * lamp_light()
    return np.asarray(view.round().clip(0), np.uint8)


def test_a_camera_that_sees_nothing_makes_no_clear(detector):
    tower = draw(1.5)[1]  # before the right camera alone
    assert is_clear(detector.detect(Frame(1, 0.0, noise(1), noise(2))))
    frozen = detector.detect(Frame(2, 0.0, noise(1), noise(3)))
    assert frozen.mask is None and frozen.vetoes_clear and "left camera repeats" in frozen.fault
    covered = detector.detect(Frame(3, 0.0, noise(4), tower))
    assert covered.mask is None and covered.vetoes_clear and "right view shows" in covered.fault
    dark = detector.detect(Frame(4, 0.0, noise(5), noise(6, light=0.2)))
    assert dark.mask is None and not dark.vetoes_clear and "right: dark" in dark.fault
    assert is_clear(detector.detect(Frame(5, 0.0, noise(7), noise(8))))


def test_an_unfit_pair_is_unknown_unless_it_shows_an_obstacle(detector):
    for words, frame in unfit_pairs(*EMPTY).items():
        found = detector.detect(frame)
        assert found.mask is None and words in found.fault
        assert found.vetoes_clear == words.startswith("left: ")
    left, right = draw(4.0, y=650)
    left[:600], right[:600] = 255, 255
    found = detector.detect(Frame(1, 0.0, left, right))
    assert found.distance_m == pytest.approx(4.0, rel=0.03)


@pytest.mark.parametrize(
    ("farther_apart", "words"),
    [
        (0.3, "cannot look at 8 m with this calibration, only from 0.29 to 6.6 m"),
        (4.0, "cannot look at 3 m"),
    ],
)
def test_distances_that_these_cameras_cannot_tell_are_refused(farther_apart, words):
    apart = replace(PLAIN, T_mm=farther_apart * PLAIN.T_mm)
    refuses(words, PushbroomDetector, apart, Grid())


@pytest.mark.parametrize("size", [(97, 61), (361, 271), (640, 203)])
def test_frames_of_any_size_gray_or_colour(size, monkeypatch):
    monkeypatch.setattr(pushbroom, "DISTANCES_M", (2.0,))
    width, height = size
    camera = np.array([[1.6 * width, 0, width / 2], [0, 1.6 * width, height / 2], [0, 0, 1]])
    small = replace(PLAIN, K1=camera, K2=camera, frame_size=size)
    detector = PushbroomDetector(small, Grid())
    noise = np.random.default_rng(1).integers(0, 255, (height // 3, width // 3), np.uint8)
    left = cv2.resize(noise, size)
    right = np.roll(left, -round(1.6 * width * 0.3 / 2.0), axis=1)
    found = detector.detect(Frame(1, 0.0, left, cv2.cvtColor(right, cv2.COLOR_GRAY2BGR)))
    assert found.mask is not None and found.mask.shape == Grid().resized(height, width)
    assert found.distance_m == pytest.approx(2.0, rel=0.06) and "at 2 m" in found.note


@pytest.fixture(scope="module")
def real(calibration_path):
    return PushbroomDetector(load_calibration(calibration_path), Grid())


def look(detector, mission, left, right, turn=False) -> np.ndarray:
    """The depths found in frames of the sea trial."""
    return detector.look(*sea_trial_pair(mission, left, right, turn))


@pytest.mark.mission
def test_the_tower_is_met_as_it_crosses_each_distance(mission, real):
    # Frames with even numbers: the settings were chosen on the odd ones.
    met = {150: 8, 166: 6, 176: 4, 180: 3, 184: 2, 194: 3, 198: 4}
    for number, distance_m in met.items():
        found = look(real, mission, number, number)
        assert np.median(found[found > 0]) == pytest.approx(distance_m, rel=0.06)
    for number in (146, 158, 170, 204):  # farther, or between two distances
        assert not look(real, mission, number, number).any()
        frame = Frame(number, 0.0, *sea_trial_pair(mission, number, number))
        assert real.detect(frame).vetoes_clear  # and never clear


@pytest.mark.mission
def test_a_wrong_right_frame_gives_no_hit(mission, real):
    for other in (50, 170, 188, 200):
        assert not look(real, mission, 180, other).any()
    assert not look(real, mission, 180, 180, turn=True).any()
