"""No split may leak: whole groups, a gap on both sides, every row tested once."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.training.datasets.folds import (
    FULL_DIVE,
    Dives,
    block_of,
    blocked_folds,
    dive_folds,
    every_nth_block,
    held_out_together,
    sites_named,
    some_units,
)


@st.composite
def layouts(draw):
    """Labelled patches of one or two missions, in blocks, with gaps between the frames."""
    block = draw(st.integers(1, 6))
    rows = []
    for mission in ("a", "b")[: draw(st.integers(1, 2))]:
        for frame in sorted(draw(st.sets(st.integers(0, 120), min_size=4, max_size=40))):
            target = draw(st.integers(0, 2))
            for row in range(draw(st.integers(1, 3))):
                other = draw(st.booleans())
                rows.append((mission, frame, row, block_of(mission, frame, block), target, other))
    table = pd.DataFrame(rows, columns=["mission", "frame", "row", "group", "target", "other"])
    present = np.unique(table.target)
    targets = np.searchsorted(present, table.target).astype(np.int64)
    return table, targets


def distance_to_test(table, fold):
    """The least number of frames between a training and a test row of the same mission."""
    train, test = table.iloc[fold.train], table.iloc[fold.test]
    pairs = train.merge(test, on="mission", suffixes=("", "_test"))
    return int((pairs.frame - pairs.frame_test).abs().min()) if len(pairs) else 10**9


@settings(max_examples=scaled(80))
@given(layout=layouts(), n_folds=st.integers(2, 5), embargo=st.integers(0, 8))
def test_no_layout_leaks(layout, n_folds, embargo):
    table, targets = layout
    try:
        folds = blocked_folds(table, targets, n_folds, embargo)
    except ToktError:
        event("refused")  # what cannot be split honestly is refused, never split otherwise
        return
    event("split")
    assert len(folds) == n_folds
    tested = np.concatenate([fold.test for fold in folds])
    assert sorted(tested) == list(range(len(table)))
    group = table.group.to_numpy()
    for fold in folds:
        assert len(fold.test)
        assert not set(group[fold.train]) & set(group[fold.test])
        assert distance_to_test(table, fold) > embargo
        assert set(targets[fold.train]) == set(targets)


@settings(max_examples=scaled(80))
@given(st.data())
def test_no_dive_or_site_is_on_both_sides(data):
    names = [f"dive_{number}" for number in range(data.draw(st.integers(1, 14)))]
    sites = data.draw(st.dictionaries(st.sampled_from(names), st.sampled_from(["s", "t", "u"])))
    rows = [
        (name, frame, f"{name}#{frame}", data.draw(st.booleans()))
        for name in names
        for frame in range(data.draw(st.integers(1, 3)))
    ]
    table = pd.DataFrame(rows, columns=["mission", "frame", "group", "reef"])
    for one, other in data.draw(st.lists(st.tuples(*[st.sampled_from(list(table.group))] * 2))):
        table.group = table.group.replace(one, other)  # they share a picture
    targets = table.reef.to_numpy(np.int64)
    whole, columns = table.assign(site=table.mission.replace(sites)), ["mission", "group"]
    try:
        folds = dive_folds(table, targets, sites, 5)
    except ToktError:
        event("refused")
        folds = dive_folds(table, targets, sites, 5, refuse=False)
    else:
        event("split" if folds else "one unit")
        columns += ["site"] if len(set(held_out_together(table, sites))) > 1 else []
        tested = np.concatenate([fold.test for fold in folds]) if folds else np.arange(len(table))
        assert sorted(tested) == list(range(len(table)))
    for fold in folds:
        for column in columns:
            sides = (set(whole[column].iloc[rows]) for rows in (fold.train, fold.test))
            assert not set.intersection(*sides)
        assert set(targets[fold.train]) == set(targets)


def test_more_dives_than_can_be_alone_are_held_out_several_at_a_time():
    dives = [f"dive_{n:02d}" for n in range(18) for _ in range(4)]
    table = pd.DataFrame({"mission": dives, "frame": range(72), "group": dives})
    targets = np.arange(72) % 2
    folds = dive_folds(table, targets, {}, 5)
    assert len(folds) == 5 and {len(set(table.mission[f.test])) for f in folds} == {3, 4}
    assert len(dive_folds(table[:64], targets[:64], {}, 5)) == 16
    assert len(dive_folds(table[:28], targets[:28], {}, 5, alone=6)) == 5
    assert len(dive_folds(table[:24], targets[:24], {}, 5, alone=6)) == 6


def test_dives_that_share_a_picture_have_one_name():
    table = pd.DataFrame({"mission": list("abcd"), "frame": 1, "group": ["g", "h", "g", "i"]})
    assert held_out_together(table).tolist() == ["a+c", "b", "a+c", "d"]
    together = held_out_together(table, {"b": "basin", "c": "basin"}).tolist()
    assert together == ["a+basin", "a+basin", "a+basin", "d"]


def test_sites_are_told_by_name():
    assert sites_named(["s=a,b", "t=c"], ["a", "b", "c"]) == {"a": "s", "b": "s", "c": "t"}
    for text in ("s", "=a", "s=", "s=a,", ""):
        refuses("--site is something like basin=dive_1,dive_2", sites_named, [text], ["a"])
    refuses("no mission 'x' .there are: a, b", sites_named, ["s=x"], ["a", "b"])
    refuses("mission a is in two sites, s and t", sites_named, ["s=a", "t=a"], ["a", "b"])


def test_a_dive_weighs_by_the_root_of_its_patches_and_a_patch_one_in_the_mean():
    weights = Dives.of(np.array(list("aaaab"))).weights()
    assert weights.tolist() == pytest.approx([5 / 6] * 4 + [5 / 3]) and weights.mean() == 1
    dives = np.repeat([0, 1, 2], [FULL_DIVE // 4, FULL_DIVE, 5 * FULL_DIVE])
    sums = np.bincount(dives, Dives.of(dives).weights())
    assert sums[1:] / sums[0] == pytest.approx([2, 2]), "a long dive counts no more than a full one"


def regular(frames, block, period=2):
    frame = np.arange(frames)
    groups = [block_of("m", n, block) for n in frame]
    table = pd.DataFrame({"mission": "m", "frame": frame, "group": groups})
    return table, (frame // block % period == 0).astype(np.int64)


@pytest.mark.parametrize(
    ("frames", "block", "period", "n_folds", "message"),
    [
        (40, 10, 2, 5, "4 blocks of frames are too few for 5 folds"),
        (100, 20, 5, 5, "single block"),
        (20, 4, 2, 5, "neighbour frames"),
    ],
)
def test_too_little_to_split_is_said(frames, block, period, n_folds, message):
    table, targets = regular(frames, block, period)
    refuses(message, blocked_folds, table, targets, n_folds, 5)


def test_fewer_patches_of_each_class_than_folds():
    table = pd.DataFrame({"mission": "m", "frame": range(0, 60, 10), "group": list("abcdef")})
    with pytest.raises(ToktError, match="no class has as many patches"):
        blocked_folds(table, np.array([0, 0, 0, 1, 1, 1]), 5, 0)


@settings(max_examples=scaled(60))
@given(layout=layouts(), n=st.integers(2, 4), embargo=st.integers(0, 8))
def test_holding_back_every_nth_block_does_not_leak(layout, n, embargo):
    table, targets = layout
    try:
        fold = every_nth_block(table, targets, n, embargo)
    except ToktError:
        return
    group = table.group.to_numpy()
    assert not set(group[fold.train]) & set(group[fold.test])
    assert distance_to_test(table, fold) > embargo
    assert set(targets[fold.train]) == set(targets[fold.test]) == set(targets)


@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(0, 2)), min_size=1),
    st.integers(1, 60),
    st.integers(1, 3),
)
def test_some_units_are_whole_and_hold_every_class_and_site(rows, most, of_class):
    units = np.array([f"unit {unit}" for unit, _ in rows], object)
    targets = np.array([one for _, one in rows])
    site = np.array([unit % 3 - 1 for unit, _ in rows])  # the first of them is none
    kept = some_units(units, (targets, site), most, of_class)
    names = units.astype(str)
    assert set(names[kept]).isdisjoint(np.delete(names, kept))
    for kind in [targets == one for one in range(3)] + [site == one for one in range(2)]:
        having = set(names[kind])
        assert len(having & set(names[kept])) >= min(of_class, len(having))
    again = some_units(units, (targets, site), most, of_class)
    assert (kept == again).all() and (np.diff(kept) > 0).all()
    if len(kept) > most:  # only what the classes ask for
        assert len(set(names[kept])) <= of_class * 5
