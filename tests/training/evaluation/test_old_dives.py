"""What a new version may lose of the dives that the old one learnt."""

import numpy as np
import pandas as pd
import pytest

from tokt.training.evaluation.old_dives import falls, held_out_falls, held_out_units


def test_a_dive_may_fall_by_little_and_the_mean_by_less():
    before = {"a": 0.9, "b": 0.8, "c": None, "gone": 0.9}
    assert falls(before, {"a": 0.875, "b": 0.83, "c": 0.1, "new": 0.0}) == []
    assert falls(before, {"a": 0.86, "b": 0.9}) == ["a F1 0.900 -> 0.860"]
    assert falls(before, {"a": 0.88, "b": 0.79}) == ["mean F1 of 2 dives 0.850 -> 0.835"]
    assert falls(before, {"a": 0.88}) == [], "the mean of one dive is the dive"
    assert len(falls(before, {"a": 0.5, "b": 0.5})) == 3
    assert falls(before, {"a": None, "b": None}) == falls({}, {}) == []


@pytest.fixture
def table():
    """Two dives of five frames, ten patches each, half of them obstacles, each held out whole."""
    keys = pd.MultiIndex.from_product(
        [["a", "b"], ["left"], range(5), range(2), range(5)],
        names=["mission", "camera", "frame", "row", "col"],
    )
    frame = keys.to_frame(index=False)
    frame["label"] = np.where(frame.row == 0, "ocean", "rock")
    frame["fold"] = (frame.mission == "b").astype(int)
    return frame.assign(obstacle_score=np.where(frame.row == 0, -1.0, 1.0))


def test_versions_are_compared_on_what_both_held_out(table):
    obstacle = (table.label == "rock").to_numpy()
    assert held_out_falls(table, table, obstacle) == []
    after = table.copy()
    after.loc[(after.mission == "a") & (after.frame < 2), "obstacle_score"] *= -1
    assert [line[:4] for line in held_out_falls(table, after, obstacle)] == ["a F1", "mean"]
    # On frames that only one has, that one did not hold out, or that have another label since:
    # nothing.
    few = after.frame >= 2
    for change in (
        lambda one: one[few],
        lambda one: one.assign(fold=one.fold.where(few, -1)),
        lambda one: one.assign(label=one.label.where(few, "wreck")),
    ):
        assert held_out_falls(change(table), after, obstacle) == []
    assert held_out_falls(table[:0], after, obstacle) is None


def test_a_dive_held_out_alone_is_not_compared_with_one_held_out_with_its_site(table):
    """A model that learnt of the same site does better, and says nothing of the other."""
    third = table[table.mission == "a"].assign(mission="c", fold=2)
    alone = pd.concat([table, third], ignore_index=True)
    obstacle = (alone.label == "rock").to_numpy()
    site = alone.assign(fold=alone.fold.where(alone.mission != "c", 0))
    assert held_out_units(site, {"a", "b"}) == held_out_units(alone, {"a", "b"})
    assert held_out_falls(alone, site, obstacle) is None
    assert held_out_falls(site, alone, obstacle) is None
    assert held_out_falls(site, site, obstacle) == []
    # With a dive that the other one does not know it may be held out together.
    assert held_out_falls(table, site, obstacle) == []


def test_whole_dives_are_not_compared_with_blocks(table):
    obstacle = (table.label == "rock").to_numpy()
    blocks = table.assign(fold=table.frame % 2)
    assert held_out_falls(blocks, table, obstacle) is None
    assert held_out_falls(blocks, blocks, obstacle) == []
