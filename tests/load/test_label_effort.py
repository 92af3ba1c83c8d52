"""A person's actions on the page in Chromium: they give the labels asked for, and are few."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as npst
from scipy import ndimage

from tests.load.effort.effort import WAYS, label_on_page, wrong_labels
from tests.load.effort.halves import labels_by_frame, most_frequent_obstacle, target_of, two_halves
from tests.load.effort.session import FREE, drags
from tests.load.page.mission import copy_frames
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.training.datasets.mission_source import read_labels

COLS = DEFAULT_GRID.cols
MASKS = npst.arrays(bool, (DEFAULT_GRID.rows, COLS))


@given(MASKS, MASKS)
def test_drags_paint_what_they_must_and_nothing_they_may_not(need, also):
    needed = set(np.flatnonzero(need).tolist())
    allowed = set(np.flatnonzero(need | also).tolist())
    paths = drags(needed, allowed)
    assert needed <= {cell for path in paths for cell in path} <= allowed
    for path in paths:  # always across an edge
        steps = np.diff([divmod(cell, COLS) for cell in path], axis=0)
        assert (np.abs(steps).sum(axis=1) == 1).all()
    areas, _ = ndimage.label(need | also)
    assert len(paths) == len(np.unique(areas[need]))


@pytest.mark.parametrize(
    "numbers", [range(1, 247), range(1, 41), [*range(1, 100), *range(132, 247)]]
)
def test_halves_are_whole_blocks_with_a_gap(numbers):
    first, second = two_halves(list(numbers))
    assert sorted(first.held + second.held) == list(numbers)
    for half in (first, second):
        apart = [min(abs(a - b) for b in half.held) for a in half.learnt]
        assert min(apart) == half.gap + 1
        assert len({number // half.block for number in half.learnt}) >= 5


@pytest.fixture(scope="module")
def records(tiny):
    """The tiny mission's labels."""
    return read_labels([tiny.labels], Taxonomy.load(), DEFAULT_GRID)


def test_a_mission_of_water_only_has_nothing_to_suggest(records):
    assert most_frequent_obstacle(labels_by_frame(records)) == "subsea_installation"
    water = [record for record in records if record.label == "ocean"]
    with pytest.raises(ToktError, match="no patch is labelled as an obstacle"):
        most_frequent_obstacle(labels_by_frame(water))


HELD = [8, 9, 20]


@pytest.mark.parametrize(
    ("way", "suggested", "most"),
    [("clicks", False, 27), ("frames", True, 9), ("drags_unsure", False, 10), ("drags", True, 6)],
)
def test_few_actions_in_the_browser_give_the_labels(
    way, suggested, most, browser, tiny, tiny_bundle, records, tmp_path
):
    workflow = next(each for each in WAYS if each.name == way)
    target = target_of(labels_by_frame(records), HELD, workflow.unsure)
    copy_frames(open_mission(tiny.path), HELD, tmp_path / "held")
    model = tiny_bundle if suggested else None
    places, who = (tmp_path / "held", tmp_path / "ws"), (workflow, model, "subsea_installation")
    # As many as the best of all plans had, when one was looked for beforehand.
    assert len(HELD) < label_on_page(browser, *places, target, *who) <= most
    assert wrong_labels(tmp_path / "ws", target) == []


def test_a_wrong_label_in_the_store_is_told(records, tmp_path):
    target = {
        frame: list(labels)
        for frame, labels in target_of(labels_by_frame(records), [8, 9], unsure=True).items()
    }
    with LabelStore(tmp_path / FILE_NAME) as store:
        store.add(record for record in records if record.frame in (8, 9))
    assert wrong_labels(tmp_path, target) == []
    target[8][:7] = [UNSURE] * 7
    target[9][44] = UNSURE
    found = wrong_labels(tmp_path, target)
    assert found[0] == "frame 8 patch 0: ocean instead of unsure"
    assert len(found) == 6 and found[-1] == "and 3 more"
    nothing_there = {10: ["reef", *[FREE] * 99]}
    assert wrong_labels(tmp_path, nothing_there) == ["frame 10 patch 0: nothing instead of reef"]
