"""All patches of a class, odd ones first."""

import math

import cv2
import numpy as np
import pytest

from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.page.state import review_sheet
from tokt.labels.page.state.review_sheet import PatchRanker

FIRST_PAGE = 50
Cells = dict[str, list[tuple[str, int, int]]]


@pytest.fixture
def sheet(tiny):
    made = PatchRanker(open_mission(tiny.path), Grid())
    yield made
    made.features.background.close()


@pytest.fixture
def cells(tiny_truth):
    """The tiny mission's patches by their label."""
    found = {}
    for _, camera, frame, row, col, label in tiny_truth.labels():
        found.setdefault(label, []).append((camera, frame, row * 10 + col))
    return found


def looked_at(sheet, cells):
    features = sheet.features
    features.want((camera, frame) for c in cells.values() for camera, frame, _ in c)
    features.background.start()
    until(lambda: features.progress[0] >= features.progress[1])
    return sheet


def plant(cells, of, into, n):
    """Give `n` patches of one class another label."""
    step = len(cells[of]) // n
    wrong = cells[of][::step][:n]
    cells[of] = [cell for cell in cells[of] if cell not in wrong]
    cells[into] = sorted(cells[into] + wrong)
    return wrong


def cells_of(ranked):
    return [patch[:3] for patch in ranked.patches]


@pytest.mark.parametrize(
    ("of", "into"), [("ocean", "subsea_installation"), ("subsea_installation", "ocean")]
)
def test_planted_wrong_labels_come_first(sheet, cells, of, into):
    wrong = plant(cells, of, into, 6)
    ranked = looked_at(sheet, cells).patches(cells, into)
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
    assert set(wrong) & set(cells_of(ranked)[:3])
    assert sorted(cells_of(ranked)) == cells[into] and ranked.ready
    values = [patch.value for patch in ranked.patches]
    assert values == sorted(values) and values[0] < 0 < values[-1]


def test_the_sheet_says_how_the_order_was_made(sheet, cells):
    looked_at(sheet, cells)
    # Frames 1..40 are in blocks 0, 1 and 2 (frame 40).
    assert sheet.patches(cells, "ocean").by == (
        "decision value against the other classes, cross-validated: 3 folds of whole blocks of"
        " 20 frames, linear SVM on LBP and Haralick features"
    )
    assert "for cross-validation it needs a second class" in sheet.patches(cells, "unsure").by
    alone = {"ocean": cells["ocean"], "unsure": cells["unsure"]}
    assert "needs a second class" in sheet.patches(alone, "ocean").by
    one_block = {name: [cell for cell in c if cell[1] < 20] for name, c in cells.items()}
    ranked = sheet.patches(one_block, "ocean")
    assert "distance from the class's median" in ranked.by
    assert ranked.by.endswith("needs patches in two blocks of 20 frames")
    class_in_one = {**cells, "subsea_installation": one_block["subsea_installation"]}
    assert "distance" in sheet.patches(class_in_one, "subsea_installation").by


def test_no_classifier_saw_the_block_of_the_patch_it_judges(sheet, cells, monkeypatch):
    from sklearn.preprocessing import StandardScaler
    from sklearn.svm import LinearSVC

    looked_at(sheet, cells)
    known = sheet.features.snapshot()
    block_of = {
        known.features[row, cell].tobytes(): int(known.numbers[row]) // 20
        for row in range(40)
        for cell in range(100)
    }
    seen = []

    def keep(self, x, y=None, **more):
        seen.append(({block_of[row.astype(np.float32).tobytes()] for row in x}, set()))
        return x

    def judge(self, x):
        seen[-1][1].update(block_of[row.tobytes()] for row in x)
        return np.zeros(len(x))

    monkeypatch.setattr(StandardScaler, "fit_transform", keep)
    monkeypatch.setattr(StandardScaler, "transform", lambda self, x: x)
    monkeypatch.setattr(LinearSVC, "decision_function", judge)
    sheet.patches(cells, "ocean")
    assert len(seen) == 3
    assert all(trained and judged and not trained & judged for trained, judged in seen)
    assert set().union(*(judged for _, judged in seen)) == {0, 1, 2}


def test_without_a_second_class_odd_is_what_is_far_from_the_middle(sheet, cells):
    wrong = plant(cells, "subsea_installation", "ocean", 6)
    only = {"ocean": cells["ocean"]}
    ranked = looked_at(sheet, only).patches(only, "ocean")
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
    assert all(patch.value <= 0 for patch in ranked.patches)


def test_before_all_frames_are_looked_at_nothing_is_missing(sheet, cells):
    ranked = sheet.patches(cells, "ocean", version=1)
    assert (ranked.done, ranked.of, ranked.ready) == (0, 40, False)
    assert cells_of(ranked) == cells["ocean"] and math.isnan(ranked.patches[0].value)
    assert ranked.by == "in the order of the frames: none has been looked at so far"
    looked_at(sheet, cells)
    again = sheet.patches(cells, "ocean", version=1)
    assert again.ready and "cross-validated" in again.by


def test_an_unreadable_frame_comes_last(own_tiny, cells):
    (own_tiny.path / "Left" / "tiny_L_7.png").write_bytes(b"")
    cv2.imwrite(str(own_tiny.path / "Left" / "tiny_L_8.png"), np.zeros((3, 500), np.uint8))
    sheet = PatchRanker(open_mission(own_tiny.path), Grid())
    ranked = looked_at(sheet, cells).patches(cells, "ocean")
    sheet.features.background.close()
    last = [cell for cell in cells["ocean"] if cell[1] in (7, 8)]
    assert cells_of(ranked)[-len(last) :] == last and ranked.ready
    for place, patch in enumerate(ranked.patches):
        assert math.isnan(patch.value) == (place >= len(ranked.patches) - len(last))


def test_pages_of_one_ranking_are_computed_once(sheet, cells, monkeypatch):
    looked_at(sheet, cells)
    first = sheet.patches(cells, "ocean", version=("anna", 5))
    fresh = sheet.patches(cells, "ocean")
    assert list(fresh.patches) == list(first.patches)  # seeded
    sheet.patches(cells, "ocean", version=("anna", 5))
    with monkeypatch.context() as patched:
        patched.setattr(review_sheet, "_values", lambda *a: pytest.fail("computed again"))
        page = sheet.patches({}, "ocean", version=("anna", 5)).patches[20:23]
    assert page == list(first.patches)[20:23]
    fewer = {**cells, "ocean": cells["ocean"][:10]}
    assert len(sheet.patches(fewer, "ocean", version=("anna", 6)).patches) == 10


def test_a_label_nobody_used_has_no_patches(sheet, cells):
    ranked = looked_at(sheet, cells).patches(cells, "reef")
    assert len(ranked.patches) == 0 and ranked.patches[:200] == []
    assert len(sheet.patches({}, "ocean").patches) == 0


def test_more_patches_than_are_trained_on_are_all_ranked(sheet, cells, monkeypatch):
    monkeypatch.setattr(review_sheet, "MAX_TRAINED", 200)
    wrong = plant(cells, "ocean", "subsea_installation", 4)
    ranked = looked_at(sheet, cells).patches(cells, "subsea_installation")
    assert not any(math.isnan(patch.value) for patch in ranked.patches)
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
