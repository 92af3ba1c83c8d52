"""Settlements: when they hold, and how they travel through files into datasets."""

from dataclasses import replace

import pytest

from tests.calls import refuses
from tests.labels.store.said import history
from tokt.features.frames.grid import DEFAULT_GRID
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.label_csv import read_label_csv, write_label_csv
from tokt.labels.record import SETTLED, LabelRecord
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import Taxonomy
from tokt.training.datasets.mission_source import LabelledMission, plan_from_missions, read_labels

TIME = "2016-04-20T10:00:00Z"
TAXONOMY = Taxonomy.load()


def _said(label, who, *, col=0, **more):
    return LabelRecord("dive", "left", 1, DEFAULT_GRID, 0, col, label, who, TIME, **more)


def _settled(label, who="ann", *, col=0, **more):
    return _said(label, who, col=col, source=SETTLED, **more)


@pytest.fixture
def store(store):
    """Two opinions on a patch."""
    store.add([_said("reef", "ann"), _said("ocean", "ben")])
    return store


def test_a_settlement_stands_beside_the_opinions(store):
    added = store.add_counted([_settled("reef", "carl")])
    assert (added.settled, added.new, added.events) == (1, 0, 1)
    assert store.settled() == [_settled("reef", "carl")]
    assert store.current() == [_said("reef", "ann"), _said("ocean", "ben")]
    assert store.current_and_settled() == [*store.current(), _settled("reef", "carl")]
    assert store.annotators() == ["ann", "ben"]
    sources = [record.source for record in history(store, _said(None, "ann").cell)]
    assert sources == ["human", "human", "settled"]


@pytest.mark.parametrize(
    ("newer", "holds"),
    [
        (_said("sand", "ben"), False),
        (_said(None, "ben"), False),
        (_said("reef", "carl"), False),
        (_said("ocean", "ben"), True),  # said so before: nothing new
        (_said("sand", "ben", col=1), True),
        (_said("sand", "m", source="model", model_version="lbp/1"), True),
        (_settled(None, "dora"), False),
    ],
)
def test_anything_newer_that_people_say_opens_the_question_again(store, newer, holds):
    store.add([_settled("reef")])
    store.add([newer])
    assert store.settled() == ([_settled("reef")] if holds else [])
    assert [record.source for record in store.current_and_settled()].count(SETTLED) == holds
    store.add([_settled("ocean", "carl")])
    assert store.settled() == [_settled("ocean", "carl")]


def test_settlements_are_chosen_like_labels(store):
    coarse = replace(_settled("sand", "ben"), grid=type(DEFAULT_GRID)(5, 5))
    other = replace(_settled("sand", "ben"), mission="transit", camera="right", frame=9)
    store.add([_settled("reef"), coarse, other])
    assert store.settled("transit") == [other]
    assert store.settled("dive", grid=DEFAULT_GRID) == [_settled("reef")]
    assert store.settled(annotator="ben") == [coarse, other]
    assert store.settled(camera="right", frame=9) == [other]
    assert store.current_and_settled("dive", "ben") == [_said("ocean", "ben"), coarse]
    assert store.current_and_settled(grid=coarse.grid, frame=1) == [coarse]


def test_importing_a_settlement_twice_changes_nothing(store):
    assert store.add([_settled("reef"), _settled("reef")]) == 1
    assert store.add([_settled("reef")]) == 0
    assert store.add([_settled("reef", "carl")]) == 0  # it is settled so
    store.add([_said("sand", "ben")])
    assert store.add([_settled("reef")]) == 0  # its file knew nothing of ben's newer opinion
    assert store.settled() == []
    assert store.add([replace(_settled("reef"), time="2016-04-21T10:00:00Z")]) == 1


def test_a_full_file_carries_settlements_to_another_store(store, tmp_path):
    # "ann" sorts before "ben": were the rows in order of annotators, ben's would reopen it.
    store.add([_settled("reef", "ann", model_version="lbp/1"), _said("sand", "ben", col=1)])
    full = store.current_and_settled()
    assert write_label_csv(tmp_path / "full.csv", reversed(full), full=True) == 4
    read = read_label_csv(tmp_path / "full.csv", TAXONOMY)
    assert read == full
    with LabelStore(tmp_path / "other.db") as other:
        assert other.add_counted(reversed(read)).settled == 1
        assert other.current_and_settled() == full
        assert other.add(read) == 0


def test_six_columns_cannot_say_what_is_settled(store, tmp_path):
    store.add([_settled("reef")])
    refuses(
        "--full", write_label_csv, tmp_path / "x.csv", store.current_and_settled(annotator="ann")
    )
    assert write_label_csv(tmp_path / "x.csv", store.current(annotator="ann")) == 1


def test_a_patch_that_a_file_settles_twice(tmp_path):
    path = tmp_path / "full.csv"
    write_label_csv(path, [_said("reef", "ann"), _settled("reef")], full=True)
    assert len(read_label_csv(path, TAXONOMY)) == 2
    write_label_csv(path, [_settled("reef"), _settled("ocean", "ben")], full=True)
    refuses(r"line 3: .* is settled on line 2 already", read_label_csv, path, TAXONOMY)


def test_a_dataset_takes_what_is_settled(store, own_tiny, tmp_path):
    mission = open_mission(own_tiny.path.rename(tmp_path / "dive"))
    store.add([_said("reef", "ann", col=1), _said("ocean", "ben", col=1), _settled("reef")])
    records = store.current_and_settled(grid=DEFAULT_GRID)
    write_label_csv(tmp_path / "full.csv", records, full=True)
    for given in (records, read_labels([tmp_path / "full.csv"], TAXONOMY, DEFAULT_GRID)):
        labelled = LabelledMission(mission, given)
        plan, remarks = plan_from_missions("d", "binary", [labelled], TAXONOMY)
        assert plan.patches[["col", "label"]].to_numpy().tolist() == [[0, "reef"]]
        assert remarks == ["1 patches left out: annotators disagree"]
