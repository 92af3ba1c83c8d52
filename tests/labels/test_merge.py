"""One label a patch out of several annotators' labels and settlements."""

from dataclasses import replace

import pytest

from tokt.features.frames.grid import Grid
from tokt.labels.merge import merge_annotators
from tokt.labels.record import SETTLED, Cell, LabelRecord

TIME = "2016-04-20T10:00:00Z"
GRID = Grid()


def _record(label, *, annotator="ann", col=0, **more):
    return LabelRecord("dive", "left", 1, GRID, 0, col, label, annotator, TIME, **more)


def test_merge_of_one_annotator_changes_nothing():
    records = [_record("ocean"), _record("unsure", col=1)]
    assert merge_annotators(records).records == records


def test_merge_of_several_annotators():
    ann = [_record(label, col=n) for n, label in enumerate(["ocean", "ocean", "ocean", "unsure"])]
    late = "2016-04-21T10:00:00Z"
    bob = [
        replace(_record(label, col=n, annotator="bob"), time=late)
        for n, label in enumerate(["ocean", "reef", "unsure", "unsure"])
    ]
    eve = replace(_record("sand", col=9), annotator="eve")
    merged = merge_annotators([eve, *bob, *ann])
    assert [said.label for said in merged.records] == ["ocean", "unsure", "ocean", "unsure", "sand"]
    assert merged.conflicts == [Cell("dive", "left", 1, GRID, 0, 1)]
    assert merged.records[0].annotator == "ann+bob"
    assert merged.records[0].time == late
    assert merged.records[4] == eve


@pytest.mark.parametrize("label", ["reef", "ocean", "sand", "unsure"])
def test_a_settlement_decides_whatever_the_annotators_say(label):
    late = "2016-04-21T10:00:00Z"
    opinions = [_record("reef", model_version="lbp/1"), _record("ocean", annotator="ben")]
    settled = replace(_record(label, annotator="ann", source=SETTLED), time=late)
    for order in ([settled, *opinions], [*opinions, settled]):
        merged = merge_annotators(order)
        assert merged.conflicts == []
        assert merged.records == [replace(settled, annotator="ann+ben")]


def test_a_settlement_decides_only_its_own_patch():
    opinions = (("ann", "reef"), ("ben", "ocean"))
    said = [_record(label, annotator=who, col=n) for n in (0, 1) for who, label in opinions]
    merged = merge_annotators([*said, _record("reef", annotator="carl", source=SETTLED)])
    assert [record.label for record in merged.records] == ["reef", "unsure"]
    assert merged.conflicts == [Cell("dive", "left", 1, GRID, 0, 1)]


def test_settlements_of_two_stores_that_differ_are_a_conflict():
    two = [
        _record(label, annotator=who, source=SETTLED, col=col)
        for col, labels in enumerate([("reef", "reef"), ("reef", "ocean"), ("reef", "unsure")])
        for who, label in zip(("carl", "dora"), labels, strict=True)
    ]
    merged = merge_annotators(two)
    assert [record.label for record in merged.records] == ["reef", "unsure", "unsure"]
    assert [cell.col for cell in merged.conflicts] == [1, 2]
