"""All patches of a class, odd ones first."""

import math

import cv2
import numpy as np
import pytest

from tests.fixtures import tiny_labels
from tests.waiting import until
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import CameraMasks
from tokt.labels.page.state import review_sheet
from tokt.labels.page.state.frame_features import FrameFeatures
from tokt.labels.page.state.review_sheet import rank

FIRST_PAGE = 50


@pytest.fixture(scope="module")
def features(tiny):
    """All frames of the tiny mission, looked at."""
    made = FrameFeatures(open_mission(tiny.path), Grid(), CameraMasks())
    yield look_at_all(made, patches_by_label())
    made.background.close()


def patches_by_label():
    """The tiny mission's patches by their label."""
    found = {}
    for _, camera, frame, row, col, label in tiny_labels():
        found.setdefault(label, []).append((camera, frame, row * 10 + col))
    return found


@pytest.fixture
def cells():
    """`patches_by_label`, which a test may change."""
    return patches_by_label()


def look_at_all(features, cells):
    for some in cells.values():
        features.locate(some)
    features.background.start()
    until(lambda: features.snapshot().done == len(features.snapshot().positions))
    return features


def plant(cells, of, into, n):
    """Give `n` patches of one class another label."""
    step = len(cells[of]) // n
    wrong = cells[of][::step][:n]
    cells[of] = [cell for cell in cells[of] if cell not in wrong]
    cells[into] = sorted(cells[into] + wrong)
    return wrong


def all_of(ranked):
    return ranked.patches(0, len(ranked.cells))


def cells_of(ranked):
    return [patch[:3] for patch in all_of(ranked)]


@pytest.mark.parametrize(
    ("of", "into"), [("ocean", "subsea_installation"), ("subsea_installation", "ocean")]
)
def test_planted_wrong_labels_come_first(features, cells, of, into):
    wrong = plant(cells, of, into, 6)
    ranked = rank(features, cells, into)
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
    assert set(wrong) & set(cells_of(ranked)[:3])
    assert sorted(cells_of(ranked)) == cells[into] and ranked.ready
    values = [patch.value for patch in all_of(ranked)]
    assert values == sorted(values) and values[0] < 0 < values[-1]


def test_no_classifier_saw_the_block_of_the_patch_it_judges(features, cells, monkeypatch):
    from sklearn.preprocessing import StandardScaler
    from sklearn.svm import LinearSVC

    known = features.snapshot()
    block_of = {
        known.features[row, cell].tobytes(): int(known.positions[row]) // 20
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
    rank(features, cells, "ocean")
    assert len(seen) == 3
    assert all(trained and judged and not trained & judged for trained, judged in seen)
    assert set().union(*(judged for _, judged in seen)) == {0, 1, 2}


def test_without_a_second_class_odd_is_what_is_far_from_the_middle(features, cells):
    wrong = plant(cells, "subsea_installation", "ocean", 6)
    only = {"ocean": cells["ocean"]}
    ranked = rank(features, only, "ocean")
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
    assert all(patch.value <= 0 for patch in all_of(ranked))


def test_before_all_frames_are_looked_at_nothing_is_missing(tiny, cells):
    features = FrameFeatures(open_mission(tiny.path), Grid(), CameraMasks())
    ranked = rank(features, cells, "ocean")
    assert (ranked.done, ranked.of, ranked.ready) == (0, 40, False)
    assert cells_of(ranked) == cells["ocean"] and math.isnan(all_of(ranked)[0].value)
    assert ranked.by == "in the order of the frames"


def test_frames_that_were_looked_at_and_cannot_be_read_are_not_said_to_wait(own_tiny):
    (own_tiny.path / "Left" / "tiny_L_7.png").write_bytes(b"")
    features = FrameFeatures(open_mission(own_tiny.path), Grid(), CameraMasks())
    cells = {"ocean": [("left", 7, 0)]}
    ranked = rank(look_at_all(features, cells), cells, "ocean")
    features.background.close()
    assert ranked.ready and ranked.by == "in the order of the frames: none can be read"


def test_the_sheet_says_how_the_order_was_made(features, cells):
    ranked = rank(features, cells, "ocean")
    assert ranked.ready and "cross-validated: 3 folds of whole blocks" in ranked.by
    alone = {"ocean": cells["ocean"], "unsure": cells["unsure"]}
    assert "needs a second class" in rank(features, alone, "ocean").by
    one_block = {name: [cell for cell in c if cell[1] < 20] for name, c in cells.items()}
    for by_name in (one_block, {**cells, "subsea_installation": one_block["subsea_installation"]}):
        assert "needs patches in two blocks" in rank(features, by_name, "subsea_installation").by
    nobody_used = rank(features, cells, "reef")
    assert len(nobody_used.cells) == 0 and nobody_used.patches(0, 200) == []


def test_an_unreadable_frame_comes_last(own_tiny, cells):
    (own_tiny.path / "Left" / "tiny_L_7.png").write_bytes(b"")
    cv2.imwrite(str(own_tiny.path / "Left" / "tiny_L_8.png"), np.zeros((3, 500), np.uint8))
    features = FrameFeatures(open_mission(own_tiny.path), Grid(), CameraMasks())
    ranked = rank(look_at_all(features, cells), cells, "ocean")
    features.background.close()
    last = [cell for cell in cells["ocean"] if cell[1] in (7, 8)]
    assert cells_of(ranked)[-len(last) :] == last and ranked.ready
    for place, patch in enumerate(all_of(ranked)):
        assert math.isnan(patch.value) == (place >= len(ranked.cells) - len(last))


def test_more_patches_than_are_trained_on_are_all_ranked(features, cells, monkeypatch):
    monkeypatch.setattr(review_sheet, "MAX_TRAINED", 200)
    wrong = plant(cells, "ocean", "subsea_installation", 4)
    ranked = rank(features, cells, "subsea_installation")
    assert not any(math.isnan(patch.value) for patch in all_of(ranked))
    assert set(wrong) <= set(cells_of(ranked)[:FIRST_PAGE])
