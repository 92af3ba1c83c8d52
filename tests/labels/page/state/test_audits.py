"""Which doubts of an audit are decided: those of patches that a person looked at since."""

import os
from itertools import count

import pytest

from tokt.features.frames.grid import Grid
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, write_audit
from tokt.labels.page.state.audits import Audits
from tokt.labels.record import HUMAN, SETTLED, LabelRecord
from tokt.labels.store.actions import CONFIRM, Action, Change

GRID = Grid()
PATCH = AuditedPatch("dive", "left", 1, 0, 0, "ocean", "reef", -1.0, "a reason")
BEFORE, MADE, AFTER = (f"2016-04-20T{hour}:00:00Z" for hour in (10, 12, 14))

_keys = count()


class Person:
    """Does things to the doubted patch."""

    def __init__(self, store, name="anna"):
        self._store, self._name = store, name

    def imports(self, label, time=AFTER, source=HUMAN):
        place = ("dive", "left", 1, GRID, 0, 0)
        assert self._store.add([LabelRecord(*place, label, self._name, time, source)]) == 1

    def does(self, kind, label, base="ocean", time=AFTER, source=HUMAN):
        change = Change("left", 1, 0, 0, label, base)
        action = (f"k{next(_keys)}", self._name, "dive", GRID, kind, time, (change,), source)
        assert self._store.apply(Action(*action)).changed == 1

    def settles(self, label, base=None, time=AFTER, kind="settle"):
        self.does(kind, label, base, time, SETTLED)

    def steps(self, step):
        key = f"k{next(_keys)}"
        assert getattr(self._store, step)(self._name, "dive", GRID, key, AFTER).changed == 1


def imported_again(anna, ben):
    anna.imports("reef")


def a_settlement_imported(anna, ben):
    ben.imports("reef", source=SETTLED)


def another_opinion_from_before(anna, ben):
    ben.does("paint", "reef", base=None, time=BEFORE)


def a_settlement_from_before(anna, ben):
    ben.settles("ocean", time=BEFORE)


def somebody_accepted_the_frame(anna, ben):
    ben.does("accept", "reef", base=None)


def the_rest(anna, ben):
    ben.does("rest", "ocean", base=None)


def an_own_label_accepted(anna, ben):
    anna.does("copy", "reef")


def erased(anna, ben):
    anna.does("erase", None)


def undone(anna, ben):
    anna.does("paint", "reef")
    anna.steps("undo")


def taken_back(anna, ben):
    anna.does("relabel", "reef")
    anna.does("take back", "ocean", base="reef")


def a_confirmation_undone(anna, ben):
    ben.settles("ocean", time=BEFORE)
    anna.settles("ocean", "ocean", kind=CONFIRM)
    anna.steps("undo")


def settled_and_then_accepted_by_somebody(anna, ben):
    anna.settles("ocean")
    ben.does("accept", "reef", base=None)


def painted(anna, ben):
    anna.does("paint", "reef")


def painted_undone_and_done_again(anna, ben):
    anna.does("paint", "reef")
    anna.steps("undo")
    anna.steps("redo")


def painted_by_another_and_accepted_by_the_first(anna, ben):
    ben.does("row", "reef", base=None)
    anna.does("accept", "sand")


def settled(anna, ben):
    anna.does("paint", "sand")
    ben.settles("reef")


def settled_before_and_confirmed(anna, ben):
    anna.settles("reef", time=BEFORE)
    ben.settles("reef", "reef", kind=CONFIRM)


@pytest.mark.parametrize(
    ("story", "decided"),
    [
        *[(imported_again, None), (a_settlement_imported, None), (the_rest, None)],
        *[(another_opinion_from_before, None), (a_settlement_from_before, None)],
        *[(somebody_accepted_the_frame, None), (an_own_label_accepted, None), (erased, None)],
        *[(undone, None), (taken_back, None), (a_confirmation_undone, None)],
        *[(settled_and_then_accepted_by_somebody, None), (painted, "reef"), (settled, "reef")],
        *[(painted_undone_and_done_again, "reef"), (settled_before_and_confirmed, "reef")],
        (painted_by_another_and_accepted_by_the_first, "reef"),
    ],
)
def test_a_doubt_is_decided_by_who_looked_at_it_since(store, story, decided):
    anna, ben = Person(store), Person(store, "ben")
    anna.imports("ocean", BEFORE)
    story(anna, ben)
    audit = Audit("dive", "dataset dive", GRID, "a rule", (PATCH,), MADE)
    assert Audits(store, None).decision(audit, PATCH) == decided


def test_an_audit_that_does_not_say_when_it_was_made_is_as_old_as_its_file(store):
    file = write_audit(store.path.parent, Audit("dive", "dataset dive", GRID, "a rule", (PATCH,)))
    os.utime(file, (1461153600, 1461153600))
    assert Audits(store, None).audit("dive").made == MADE
