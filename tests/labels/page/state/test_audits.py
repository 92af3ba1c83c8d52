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


def taken_back(anna, ben):
    anna.does("relabel", "reef")
    anna.does("take back", "ocean", base="reef")


def confirmed_and_undone(anna, ben):
    ben.settles("ocean", time=BEFORE)
    anna.settles("ocean", "ocean", kind=CONFIRM)
    anna.steps("undo")


def settled_and_then_accepted_by_somebody(anna, ben):
    anna.settles("ocean")
    ben.does("accept", "reef", base=None)


def painted_and(*steps):
    def story(anna, ben):
        anna.does("paint", "reef")
        for step in steps:
            anna.steps(step)

    return story


def painted_by_another_and_accepted_by_the_first(anna, ben):
    ben.does("row", "reef", base=None)
    anna.does("accept", "sand")


def settled_after_a_change(anna, ben):
    anna.does("paint", "sand")
    ben.settles("reef")


def settled_before_and_confirmed(anna, ben):
    anna.settles("reef", time=BEFORE)
    ben.settles("reef", "reef", kind=CONFIRM)


OPEN = {
    "imported again": lambda anna, ben: anna.imports("reef"),
    "a settlement imported": lambda anna, ben: ben.imports("reef", source=SETTLED),
    "another opinion from before": lambda anna, ben: ben.does(
        "paint", "reef", base=None, time=BEFORE
    ),
    "a settlement from before": lambda anna, ben: ben.settles("ocean", time=BEFORE),
    "accepted by somebody": lambda anna, ben: ben.does("accept", "reef", base=None),
    "the rest": lambda anna, ben: ben.does("rest", "ocean", base=None),
    "an own label accepted": lambda anna, ben: anna.does("copy", "reef"),
    "erased": lambda anna, ben: anna.does("erase", None),
    "undone": painted_and("undo"),
    "taken back": taken_back,
    "confirmed and undone": confirmed_and_undone,
    "settled and then accepted": settled_and_then_accepted_by_somebody,
}
DECIDED = {
    "painted": painted_and(),
    "done again": painted_and("undo", "redo"),
    "painted and accepted": painted_by_another_and_accepted_by_the_first,
    "settled": settled_after_a_change,
    "settled before and confirmed": settled_before_and_confirmed,
}


@pytest.mark.parametrize(
    ("story", "decided"),
    [(story, None) for story in OPEN.values()] + [(story, "reef") for story in DECIDED.values()],
    ids=[*OPEN, *DECIDED],
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
