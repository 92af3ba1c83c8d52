"""A person's actions on the page in Chromium: they give the labels asked for, and are few."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra import numpy as npst
from scipy import ndimage

from tests.load.effort.effort import effort_of, wrong_labels
from tests.load.effort.session import FREE, drags
from tests.load.effort.stretches import Stretch, labels_by_frame, target_of
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy
from tokt.training.datasets.mission_source import LabelledMission, read_labels

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


@pytest.fixture(scope="module")
def records(tiny):
    """The tiny mission's labels."""
    return read_labels([tiny.labels], Taxonomy.load(), DEFAULT_GRID)


@pytest.fixture(scope="module")
def dive(tiny, records):
    """The tiny mission with its labels."""
    return LabelledMission(open_mission(tiny.path), records)


HELD = [8, 9, 20]


def test_few_actions_in_the_browser_give_the_labels(browser, dive, tiny_bundle):
    effort = effort_of(Stretch(dive, HELD), tiny_bundle, True, browser)
    assert effort.wrong == [] and effort.against == 0
    # As many as the best of all plans had, when one was looked for beforehand.
    assert len(HELD) < effort.without <= 10 and 1 < effort.with_model <= 12


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
