"""The board against what the store itself says, whoever wrote what in whatever order."""

import tempfile
from itertools import count, pairwise
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.features.frames.view_mask import CameraMasks
from tokt.labels.page.state.board import Board
from tokt.labels.record import HUMAN, SETTLED, LabelRecord, utc_now
from tokt.labels.store.actions import Action, Change
from tokt.labels.store.store import LabelStore
from tokt.labels.taxonomy import UNSURE, Taxonomy

GRID = Grid(1, 3, 36)
FRAMES = {"left": [1, 2, 5], "right": [2]}
WHO = ("anna", "ben", "carl")
LABELS = ("ocean", "reef", UNSURE, None)
TAXONOMY = Taxonomy.load()


class Dive:
    """A mission of four frames."""

    name = "dive"
    cameras = ("left", "right")
    masks = CameraMasks()

    def frames(self, camera="left"):
        return FRAMES[camera]


def _board(store):
    board = Board(Dive(), GRID, TAXONOMY, store)
    board.refresh()
    return board


_keys = count()


def _say(store, who, frame, cell, label, **more):
    camera, source = more.pop("camera", "left"), more.pop("source", HUMAN)
    said = store.settled if source == SETTLED else store.current
    there = said("dive", grid=GRID, camera=camera, frame=frame)
    held = [r for r in there if r.col == cell and (source == SETTLED or r.annotator == who)]
    base = held[0].label if held else None
    change = Change(camera, frame, 0, cell, label, base, more.pop("model", None))
    key = f"key-{next(_keys)}"
    store.apply(Action(key, who, "dive", GRID, "paint", utc_now(), (change,), source, **more))


def _letter(board, frame=1, who="anna", *, blind=False):
    return board.states(who, blind)["left"][FRAMES["left"].index(frame)]


def test_states_of_a_frame_on_its_way(store):
    board = _board(store)
    assert board.states("anna", False) == {"left": "uuu", "right": "u"}
    board.mark_seen("anna", "left", 1)
    assert (_letter(board), _letter(board, who="ben")) == ("s", "u")
    for cell, letter in enumerate("ppd"):
        _say(store, "anna", 1, cell, UNSURE if cell else "ocean")
        board.refresh()
        assert _letter(board) == letter
    _say(store, "ben", 1, 0, UNSURE)
    board.refresh()
    assert (_letter(board), _letter(board, who="ben")) == ("d", "p")
    _say(store, "ben", 1, 0, "reef")
    board.refresh()
    assert (_letter(board), _letter(board, who="ben"), _letter(board, who="eve")) == ("x",) * 3
    assert (_letter(board, blind=True), _letter(board, who="ben", blind=True)) == ("d", "p")
    _say(store, "carl", 1, 0, "reef", source=SETTLED)
    board.refresh()
    assert (_letter(board), board.settled("left", 1)) == ("d", ["reef", None, None])
    assert [d.settled_by for d in board.differences("anna", "ben")] == ["carl"]
    _say(store, "anna", 1, 0, None)
    _say(store, "anna", 1, 0, "ocean")
    board.refresh()
    assert (_letter(board), board.settled("left", 1)) == ("x", [None] * 3)


def test_changed_says_who_and_where(store):
    board = _board(store)
    first = board.event
    _say(store, "anna", 1, 0, "ocean")
    _say(store, "ben", 2, 0, "ocean", camera="right")
    _say(store, "carl", 5, 0, "reef", source=SETTLED)
    changed = board.refresh()
    assert changed.event == board.event == store.last_event()
    assert changed.labelled == {"anna": {("left", 1)}, "ben": {("right", 2)}}
    assert changed.settled == {"carl": {("left", 5)}}
    assert changed.frames == {("left", 1), ("right", 2), ("left", 5)}
    assert changed.seen_by("anna", True).frames == {("left", 1)}
    assert not changed.seen_by("carl", True)
    assert board.changed_since(first) == changed
    assert not board.changed_since(board.event) and not board.refresh()


def test_what_is_not_of_this_mission_and_grid_is_left_out(store):
    def record(mission, frame, grid):
        return LabelRecord(mission, "left", frame, grid, 0, 0, "ocean", "anna", utc_now())

    store.add([record("other", 1, GRID), record("dive", 1, Grid()), record("dive", 99, GRID)])
    board = _board(store)
    assert board.annotators == [] and set(board.counts("anna").values()) == {0}
    assert board.event == store.last_event() and not board.changed_since(0)


def test_seen_frames_of_an_earlier_time(store):
    store.mark_seen("dive", "right", 2, "anna", utc_now())
    store.mark_seen("dive", "left", 99, "anna", utc_now())
    board = _board(store)
    assert board.states("anna", False) == {"left": "uuu", "right": "s"}
    store.mark_seen("dive", "left", 5, "anna", utc_now())
    board.reload_seen("anna")
    assert board.states("anna", False) == {"left": "uus", "right": "s"}


def test_model_versions_and_blind_labels(store):
    _say(store, "anna", 1, 2, "reef", model="reefs/3")
    _say(store, "anna", 1, 1, "reef", blind=True)
    board = _board(store)
    assert board.versions("anna", "left", 1) == {2: "reefs/3"}
    assert (board.blind_count("anna"), board.blind_count("ben")) == (1, 0)
    _say(store, "anna", 1, 2, "ocean")
    _say(store, "anna", 1, 1, None)
    board.refresh()
    assert board.versions("anna", "left", 1) == {} and board.blind_count("anna") == 0


def test_labels_that_the_taxonomy_does_not_know(store):
    _say(store, "anna", 1, 0, "wreck")
    board = _board(store)
    assert board.names == [*TAXONOMY.names, UNSURE, "wreck"]
    assert board.counts("anna")["wreck"] == 1 and "wreck" not in board.counts("ben")
    assert board.cells_of_class("anna", "wreck") == [("left", 1, 0)]
    assert board.cells_of_class("anna", "nothing") == board.cells_of_class("eve", "wreck") == []


_said = st.tuples(
    st.sampled_from(WHO),
    st.sampled_from(sorted((camera, frame) for camera in FRAMES for frame in FRAMES[camera])),
    st.integers(0, GRID.n_patches - 1),
    st.sampled_from(LABELS),
    st.sampled_from((HUMAN, HUMAN, HUMAN, SETTLED)),
)


@settings(max_examples=scaled(15))
@given(st.lists(st.lists(_said, max_size=8), min_size=1, max_size=3))
def test_board_says_what_the_store_says(parts):
    with tempfile.TemporaryDirectory() as folder, LabelStore(Path(folder) / "labels.db") as store:
        board = _board(store)
        for part in parts:
            for who, (camera, frame), cell, label, source in part:
                if source == SETTLED and label == UNSURE:
                    continue
                _say(store, who, frame, cell, label, camera=camera, source=source)
            board.refresh()
            _check(board, store)
        _check(_board(store), store)


def _check(board, store):
    said = {(r.annotator, r.camera, r.frame, r.col): r.label for r in store.current("dive")}
    settled = {(r.camera, r.frame, r.col): r.label for r in store.settled("dive")}
    every = [(camera, frame) for camera in FRAMES for frame in FRAMES[camera]]
    cells = range(GRID.n_patches)
    for camera, frame in every:
        of_frame = [settled.get((camera, frame, cell)) for cell in cells]
        assert board.settled(camera, frame) == of_frame
        for who in WHO:
            mine = [said.get((who, camera, frame, cell)) for cell in cells]
            assert board.labels(who, camera, frame) == mine
    for who in WHO:
        labels = [label for (name, *_), label in said.items() if name == who]
        assert board.counts(who) == {name: labels.count(name) for name in board.names}
        frames = {(camera, frame) for name, camera, frame, _ in said if name == who}
        assert set(board.labelled_frames(who)) == frames
        given = {}
        for name, camera, frame, _ in said:
            if name == who:
                found = {said.get((who, camera, frame, cell)) for cell in cells}
                ordered = [label for label in board.names if label in found]
                given.setdefault(camera, {})[str(frame)] = ordered
        assert board.given(who) == given
        for camera, frame in every:
            expected = given.get(camera, {}).get(str(frame), [])
            assert board.given(who, [(camera, frame)]) == {camera: {str(frame): expected}}
    for a, b in pairwise(WHO):
        patches = [patch for name, *patch in said if name == a and (b, *patch) in said]
        both = [(said[a, *patch], said[b, *patch]) for patch in patches]
        assert sorted(board.pairs(a, b).elements()) == sorted(both)
        differ = [(*pair, UNSURE not in pair) for pair in both if pair[0] != pair[1]]
        assert sorted((d.a, d.b, d.sure) for d in board.differences(a, b)) == sorted(differ)
    for camera, frame in every:
        x = any(
            len({said.get((who, camera, frame, cell)) for who in WHO} - {UNSURE, None}) > 1
            and (camera, frame, cell) not in settled
            for cell in cells
        )
        assert (board.states_of("eve", False, [(camera, frame)])[camera][str(frame)] == "x") is x
