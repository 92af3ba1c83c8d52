"""The row offset of a pair of views, and the correction that follows it."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tokt.features.frames.grid import Grid
from tokt.inference.frame import Frame
from tokt.inference.stereo import epipolar_drift
from tokt.inference.stereo.calibration import load_calibration
from tokt.inference.stereo.disparity import DisparityDetector
from tokt.inference.stereo.epipolar_drift import (
    EpipolarDriftCorrection,
    EpipolarOffset,
    epipolar_offset,
)
from tokt.inference.stereo.matching import Matches

from .plain_rig import sea_trial_pair

WIDTH, HEIGHT, SCALE = 340, 256, 0.5
DISPARITY_PX = 40.25

View = NDArray[np.float32]


def scene(seed: int = 0) -> View:
    """A view of smooth noise, as textured as the sea trial's tower."""
    noise = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(40 + 12 * smooth / smooth.std(), np.float32)


LEFT = scene()


def right_of(left: View, too_high_px: float = 0.0, turn_deg: float = 0.0) -> View:
    """The right view of a plane, `too_high_px` pixels of the full resolution too high.

    Positive `turn_deg` turns it clockwise about its centre. Darker than the left one, as a second
    lamp makes it.
    """
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    y_from = y + SCALE * too_high_px - np.tan(np.radians(turn_deg)) * (x - WIDTH / 2)
    maps = (x + np.float32(DISPARITY_PX), y_from.astype(np.float32))
    view = cv2.remap(left, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(0.6 * view + 5, np.float32)


def matches(columns: slice = slice(60, 300), rows: slice = slice(None)) -> Matches:
    """What matching finds of the plane, in some part of the left view."""
    valid = np.zeros((HEIGHT, WIDTH), bool)
    valid[rows, columns] = True
    everywhere = np.ones_like(valid)
    return Matches(np.full(valid.shape, DISPARITY_PX, np.float32), valid, everywhere, everywhere)


def measured(right: View, found: Matches | None = None) -> EpipolarOffset:
    return epipolar_offset(LEFT, right, found or matches(), SCALE)


@pytest.mark.parametrize("too_high_px", [0.0, 1.0, -2.2, 4.0, -6.0])
def test_an_offset_is_measured_in_pixels_of_the_full_resolution(too_high_px):
    offset = measured(right_of(LEFT, too_high_px))
    assert offset.px == pytest.approx(too_high_px, abs=0.15)
    assert offset.spread_px < 0.2
    assert offset.agreeing > 0.9
    assert not offset.turned


@pytest.mark.parametrize("turn_deg", [1.0, -1.0])
def test_a_turn_is_measured_with_its_sign(turn_deg):
    offset = measured(right_of(LEFT, 0.5, turn_deg))
    assert offset.turn_deg == pytest.approx(turn_deg, abs=0.15)
    assert offset.turned


def test_a_turn_is_not_told_from_a_narrow_strip():
    assert not measured(right_of(LEFT, 0.5, 1.0), matches(slice(200, 216))).turned


@pytest.mark.parametrize(
    "found",
    [
        matches(slice(0)),
        matches(slice(60, 76), slice(60, 76)),
        matches(rows=slice(epipolar_drift.SEARCH_ROWS)),
        matches(slice(0, int(DISPARITY_PX))),
    ],
    ids=["none", "few", "at the upper edge", "outside the right view"],
)
def test_too_few_matches_measure_nothing(found):
    assert epipolar_offset(LEFT, right_of(LEFT), found, SCALE) is None


def test_views_that_are_flat_or_smaller_than_a_patch_measure_nothing():
    tiny = np.ones((6, 9), bool)
    found = Matches(np.full(tiny.shape, 2, np.float32), tiny, tiny, tiny)
    assert epipolar_offset(LEFT[:6, :9], LEFT[:6, :9], found, SCALE) is None
    flat = np.full_like(LEFT, 30)
    assert epipolar_offset(flat, flat, matches(), SCALE) is None


def follow(drift: EpipolarDriftCorrection, true_px: float, pairs: int) -> list[float]:
    """Trims over some pairs whose right view is corrected by the drift, as the detector does."""
    found = []
    for _ in range(pairs):
        drift.add(LEFT, right_of(LEFT, true_px - drift.px), matches(), SCALE)
        found.append(drift.px)
    return found


def test_the_correction_reaches_an_offset_slowly_and_stays_there():
    corrections = follow(EpipolarDriftCorrection(), 4.0, 20)
    assert not any(corrections[: epipolar_drift.SETTLED_PAIRS - 1])
    assert np.abs(np.diff([0.0, *corrections])).max() <= epipolar_drift.STEP_PX + 1e-9
    assert corrections[-1] == pytest.approx(4.0, abs=epipolar_drift.STILL_PX)
    assert len(set(corrections[-5:])) == 1


def test_the_correction_keeps_its_limit(monkeypatch):
    monkeypatch.setattr(epipolar_drift, "LIMIT_PX", 2.0)
    drift = EpipolarDriftCorrection()
    assert follow(drift, 5.0, 40)[-1] == 2.0
    assert follow(drift, -4.0, 40)[-1] == -2.0


def test_a_small_offset_is_left_alone():
    assert follow(EpipolarDriftCorrection(), 0.8 * epipolar_drift.STILL_PX, 20)[-1] == 0.0


def test_a_wrong_right_frame_leaves_the_correction():
    drift = EpipolarDriftCorrection()
    settled = follow(drift, 3.0, 20)[-1]
    for seed in range(1, 31):
        assert drift.add(LEFT, right_of(scene(seed)), matches(), SCALE) is None
    assert drift.px == settled
    assert drift.settled


def test_a_turned_view_leaves_the_correction():
    drift = EpipolarDriftCorrection()
    for _ in range(20):
        drift.add(LEFT, right_of(LEFT, 3.0, 1.0), matches(), SCALE)
    assert drift.px == 0.0


def test_a_camera_out_of_step_leaves_the_correction_and_is_told_by_the_variation():
    drift = EpipolarDriftCorrection()
    for too_high in 2.5 * np.sin(np.arange(40)):  # the vehicle heaves
        drift.add(LEFT, right_of(LEFT, float(too_high)), matches(), SCALE)
    assert drift.px == 0.0
    assert not drift.settled
    assert drift.variation_px is not None and drift.variation_px > 1.0


def test_one_pair_off_the_others_is_told_by_its_deviation_and_moves_nothing():
    drift = EpipolarDriftCorrection()
    settled = follow(drift, 2.0, 15)[-1]
    assert drift.deviation_px == pytest.approx(0.0, abs=0.2)
    drift.add(LEFT, right_of(LEFT, 2.0 + 2.5 - drift.px), matches(), SCALE)
    assert drift.deviation_px == pytest.approx(2.5, abs=0.3)
    assert drift.px == settled
    drift.add(LEFT, right_of(LEFT, 0.0), matches(slice(0)), SCALE)
    assert drift.deviation_px is None


@pytest.mark.mission
def test_on_the_sea_trial(mission, calibration_path):
    """A right camera that looks too low is followed, and the next frame's view moves nothing."""
    for lower_px, later in ((-6.0, 0), (2.2, 0), (0.0, 1)):
        detector = DisparityDetector(load_calibration(calibration_path), Grid())
        down = np.array([[1, 0, 0], [0, 1, lower_px]])
        for number in range(158, 172):
            left, right = sea_trial_pair(mission, number, number + later)
            moved = np.asarray(cv2.warpAffine(right, down, right.shape[1::-1]), np.uint8)
            detector.detect(Frame(number, 0.0, left, moved))
        wrong_px = 0.0 if later else 0.5
        assert detector.row_shift_px == pytest.approx(-lower_px, abs=wrong_px)
