import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.inference.reason import Fault, Reason
from tokt.inference.verdict import STATUS_MEAN_THRESHOLD, unknown_verdict, verdict_from_mask

masks = hnp.arrays(
    np.uint8, st.tuples(st.integers(1, 40), st.integers(1, 40)), elements=st.sampled_from([0, 255])
)


def test_one_patch_has_the_thesis_figures():
    obstacle = np.zeros(100, bool)
    obstacle[23] = True  # row 2, col 3: pixels 108..143 x 54..80
    verdict = verdict_from_mask(Grid().paint(obstacle, 271, 360), "texture", "m/1")
    assert verdict.status == 1
    assert verdict.box == (108, 54, 36, 27)
    # centroid 125.5, 67 rounds to the even 126, 67; the frame's centre is 180, 135
    assert (verdict.x, verdict.y) == (180 - 126, 135 - 67)
    assert verdict.mean is not None and np.isclose(verdict.mean, 255 * 36 * 27 / (271 * 360))


def test_y_follows_the_rows_and_x_the_columns():
    mask = np.zeros((100, 200), np.uint8)
    mask[80:90, 20:30] = 255  # low and left: steer right (positive) and up (negative)
    verdict = verdict_from_mask(mask, "texture")
    assert verdict.x == 100 - 24 and verdict.y == 50 - 84


def test_centre_is_weighted_by_area_and_box_is_the_union():
    mask = np.zeros((200, 400), np.uint8)
    mask[10:31, 10:31] = 255  # 20 x 20 enclosed, centroid 20, 20
    mask[100:141, 300:341] = 255  # 40 x 40 enclosed, centroid 320, 120
    verdict = verdict_from_mask(mask, "texture")
    assert verdict.x == 200 - int((400 * 20 + 1600 * 320) / 2000)
    assert verdict.y == 100 - int((400 * 20 + 1600 * 120) / 2000)
    assert verdict.box == (10, 10, 331, 131)


def test_empty_mask_is_clear_and_asks_for_no_steering():
    verdict = verdict_from_mask(np.zeros((271, 360), np.uint8), "texture")
    assert (verdict.status, verdict.x, verdict.y, verdict.box, verdict.mean) == (0, 0, 0, None, 0.0)


def test_contours_without_area_still_have_a_centre():
    mask = np.zeros((10, 10), np.uint8)
    mask[2, 3] = mask[8, 3] = 255
    verdict = verdict_from_mask(mask, "texture")
    assert verdict.status == 1
    assert (verdict.x, verdict.y) == (5 - 3, 5 - 5)
    assert verdict.box == (3, 2, 1, 7)


def test_status_changes_just_above_the_threshold():
    mask = np.zeros((1, 1_000_000), np.uint8)
    mask[0, :1352] = 255  # mean 0.34476
    assert verdict_from_mask(mask, "texture").status == 0
    mask[0, :1353] = 255  # mean 0.34502
    assert verdict_from_mask(mask, "texture").status == 1


def test_unknown_has_no_direction():
    verdict = unknown_verdict(Fault(Reason.NO_FRAME, "no frame"))
    assert (verdict.status, verdict.x, verdict.y, verdict.mean) == (-1, None, None, None)
    assert (verdict.health, verdict.reason) == ("no frame", Reason.NO_FRAME)


@settings(max_examples=scaled(200))
@given(masks)
def test_every_mask_has_a_verdict_inside_the_frame(mask):
    height, width = mask.shape
    verdict = verdict_from_mask(mask, "texture")
    assert verdict.status == int(mask.mean() > STATUS_MEAN_THRESHOLD)
    assert verdict.x is not None and verdict.y is not None
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        assert verdict.box is None
        return
    assert verdict.box == (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)
    cx, cy = width // 2 - verdict.x, height // 2 - verdict.y
    assert columns.min() <= cx <= columns.max() and rows.min() <= cy <= rows.max()
