import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.inference.frame_checks import fine_detail, frame_fault
from tokt.inference.reason import Reason

RNG = np.random.default_rng(3)


SIZES = [(1024, 1360), (480, 640), (271, 360), (135, 180), (48, 64), (30, 40), (120, 1360)]


def light(height, width):
    """Open water as a camera sees it: light that falls off, and noise."""
    fall = np.linspace(60, 40, width) + np.linspace(0, 9, height)[:, None]
    return (fall + RNG.normal(0, 1, fall.shape)).astype(np.uint8)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("mean", "sigma"), [(12, 4), (30, 10), (60, 20), (128, 40)])
@pytest.mark.parametrize("channels", [1, 3])
def test_noise_without_a_picture_is_blank(size, mean, sigma, channels):
    noisy = np.clip(RNG.normal(mean, sigma, (*size, channels)), 0, 255).astype(np.uint8)
    fault = frame_fault(noisy if channels == 3 else noisy[:, :, 0])
    assert fault.reason is Reason.BLANK


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("gain", [0.5, 1, 3])
def test_evenly_lit_water_is_a_picture(size, gain):
    assert frame_fault(cv2.convertScaleAbs(light(*size), alpha=gain)) == ""


@given(
    top=st.floats(0, 0.9),
    rows=st.floats(0.06, 0.3),
    left=st.sampled_from([0, 1 / 3, 0.5]),
    grey=st.one_of(st.integers(0, 249), st.none()),
)
@settings(max_examples=scaled(40))
def test_a_band_of_one_colour_or_of_one_row_is_damage(top, rows, left, grey):
    """Wherever it begins; a row that goes on to the frame's end, as where a packet was lost."""
    picture = light(480, 640)
    first, last = round(480 * top), min(round(480 * (top + rows)), 480)
    if last - first < 0.05 * 480:
        first = last - round(0.05 * 480)
    band = picture[first:last, round(640 * left) :]
    band[:] = band[0] if grey is None else grey
    assert frame_fault(picture).reason is Reason.DAMAGED


def test_rows_that_glare_makes_equal_are_no_damage():
    picture = light(480, 640)
    picture[100:200] = 255
    assert frame_fault(picture) == ""


def test_detail_as_fine_as_pixels_is_lost_by_blur_and_by_enlarging():
    picture = light(480, 640)
    found = fine_detail(picture)
    assert 0.9 < found <= 1.1
    assert fine_detail(np.ascontiguousarray(picture[:, :, None].repeat(3, axis=2))) == found
    assert fine_detail(cv2.GaussianBlur(picture, (0, 0), 4)) < 0.6
    assert fine_detail(cv2.resize(picture, None, fx=2, fy=2)[:480, :640]) < 0.7
    for across, down in ((2, 1), (1, 2)):
        assert fine_detail(cv2.resize(picture, None, fx=across, fy=down)) < 0.75
    assert fine_detail(np.full((480, 640), 90, np.uint8)) == 0
    assert fine_detail(picture[:30, :30]) == 1.0
