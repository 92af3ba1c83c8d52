"""Random sessions of two annotators against a plain model of what must hold."""

import tempfile
from itertools import count
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.labels.record import HUMAN, SETTLED, LabelRecord
from tokt.labels.store.actions import Action, ActionResult, Change
from tokt.labels.store.store import LabelStore

GRID = Grid(2, 2)
PEOPLE = ("anna", "ben")
people = st.sampled_from(PEOPLE)
sources = st.sampled_from((HUMAN, HUMAN, HUMAN, SETTLED))
cells = st.sampled_from([(row, col) for row in range(2) for col in range(2)])
labels = st.sampled_from(["reef", "sand", None])
TIME = "2016-04-20T10:00:00Z"


class Session(RuleBasedStateMachine):
    """Two connections to one file stand for two processes; either may serve either person."""

    @initialize()
    def begin(self):
        self.folder = tempfile.TemporaryDirectory()
        self.path = Path(self.folder.name) / "labels.db"
        self.stores = [self._open(), self._open()]
        self.keys = (f"k{n}" for n in count())
        self.said = {}
        self.settled = {}
        self.stacks = {who: ([], []) for who in PEOPLE}
        self.sent = []
        self.events = 0

    def _open(self):
        store = LabelStore(self.path)
        store._connection.execute("PRAGMA synchronous = OFF")  # nobody is killed here
        return store

    def teardown(self):
        if hasattr(self, "stores"):
            for store in self.stores:
                store.close()
            self.folder.cleanup()

    def _holds(self, who, source, cell):
        return self.settled.get(cell) if source == SETTLED else self.said.get((who, cell))

    def _say(self, who, source, cell, label):
        self.events += 1
        if source == SETTLED:
            self.settled[cell] = label
        else:
            self.said[who, cell] = label
            self.settled[cell] = None

    def _write(self, who, source, wanted):
        made, conflicts = [], 0
        for cell, base, label in wanted:
            holds = self._holds(who, source, cell)
            if holds == label:
                continue
            if holds != base:
                conflicts += 1
                continue
            self._say(who, source, cell, label)
            made.append((cell, base, label))
        return made, conflicts

    @rule(
        store=st.sampled_from([0, 1]),
        who=people,
        source=sources,
        changes=st.dictionaries(cells, labels, max_size=4),
        stale=st.dictionaries(cells, labels, max_size=1),
    )
    def act(self, store, who, source, changes, stale):
        wanted = [
            (cell, stale.get(cell, self._holds(who, source, cell)), label)
            for cell, label in changes.items()
        ]
        said = tuple(Change("left", 1, *cell, label, base) for cell, base, label in wanted)
        about = (next(self.keys), who, "dive", GRID, f"{source} act", TIME)
        action = Action(*about, said, source=source)
        done = self.stores[store].apply(action)
        made, conflicts = self._write(who, source, wanted)
        assert (done.changed, len(done.conflicts)) == (len(made), conflicts)
        if made:
            undo, redo = self.stacks[who]
            undo.append((action.key, source, made))
            redo.clear()
        self.sent.append((action, done))

    @rule(store=st.sampled_from([0, 1]), who=people, way=st.sampled_from(["undo", "redo"]))
    def reverse(self, store, who, way):
        key = next(self.keys)
        done = getattr(self.stores[store], way)(who, "dive", GRID, key, TIME)
        self.sent.append(((way, who, key), done))
        take, put = self.stacks[who] if way == "undo" else reversed(self.stacks[who])
        if not take:
            assert done is None
            return
        name, source, steps = take.pop()
        back = [(cell, after, before) for cell, before, after in steps]
        made, conflicts = self._write(who, source, back)
        assert (done.changed, len(done.conflicts)) == (len(made), conflicts)
        assert done.kind == f"{source} act"
        if made:
            put.append((name, source, made))

    @rule(store=st.sampled_from([0, 1]), who=people, source=sources, cell=cells, label=labels)
    def imported(self, store, who, source, cell, label):
        time = f"2016-04-21T10:00:00.{self.events + 1:06d}Z"  # no file that was imported before
        record = LabelRecord("dive", "left", 1, GRID, *cell, label, who, time, source)
        new = self._holds(who, source, cell) != label
        assert self.stores[store].add([record]) == new
        if new:
            self._say(who, source, cell, label)

    @rule(store=st.sampled_from([0, 1]), which=st.integers(0, 1000))
    def sent_again(self, store, which):
        if not self.sent:
            return
        request, answer = self.sent[which % len(self.sent)]
        if isinstance(request, Action):
            again = self.stores[store].apply(request)
        else:
            way, who, key = request
            again = getattr(self.stores[store], way)(who, "dive", GRID, key, TIME)
        if answer is None:
            assert again is None
        else:
            assert again.repeated
            assert again == ActionResult(**{**vars(answer), "repeated": True})

    @rule(store=st.sampled_from([0, 1]))
    def restarted(self, store):
        self.stores[store].close()
        self.stores[store] = self._open()

    @invariant()
    def holds(self):
        if not hasattr(self, "stores"):
            return
        store = self.stores[self.events % 2]
        now = {(r.annotator, (r.row, r.col)): r.label for r in store.current()}
        assert now == {key: label for key, label in self.said.items() if label}
        settled = {(r.row, r.col): r.label for r in store.settled()}
        assert settled == {cell: label for cell, label in self.settled.items() if label}
        assert store.last_event() == self.events
        for who, stacks in self.stacks.items():
            expected = [(stack[-1][0], len(stack[-1][2])) if stack else None for stack in stacks]
            heads = store.history_top(who, "dive", GRID)
            assert [head and (head.key, head.changed) for head in heads] == expected


TestSession = Session.TestCase
TestSession.settings = settings(max_examples=scaled(60), stateful_step_count=30)
