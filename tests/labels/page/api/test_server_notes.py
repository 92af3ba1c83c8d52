"""Notes on patches and frames: kept as they were written, told to others, hidden from the blind."""

import csv
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.common.spreadsheet import unguarded
from tokt.features.frames.grid import Grid
from tokt.labels.formats.label_csv import read_label_csv, write_label_csv
from tokt.labels.record import Cell
from tokt.labels.store.store import FILE_NAME, LabelStore
from tokt.labels.taxonomy import Taxonomy

ODD = [
    "<img src=x onerror=alert(1)>",
    "a\r\nb\rc\n\td",
    "\u202eabc\u2066",
    "=1+1",
    '",;',
    "🐟\u2028",
]
_NO_CONTROLS = st.characters(exclude_categories=["Cc", "Cs"], include_characters="\t\n\r")


@pytest.fixture(scope="module")
def server(page_server):
    return page_server("--annotator", "anna")


def _note(server, text, frame=1, cell=None, who="anna"):
    return server.post("/api/notes", who=who, camera="left", frame=frame, cell=cell, text=text)


def _notes(server, frame=1, who="anna"):
    (found,) = server.get("/api/labels", camera="left", frames=frame, who=who)["frames"]
    return {(one["who"], one["cell"]): one["text"] for one in found["notes"]}


def test_notes_are_of_a_patch_or_a_frame_and_the_newest_of_each_person_counts(server):
    said = _note(server, "coral?", cell=7)["notes"]
    assert [(one["cell"], one["text"], one["who"]) for one in said] == [(7, "coral?", "anna")]
    _note(server, "murky")
    _note(server, "no: rock", cell=7, who="ben")
    _note(server, "coral!", cell=7)
    both = {("anna", None): "murky", ("anna", 7): "coral!", ("ben", 7): "no: rock"}
    assert _notes(server) == _notes(server, who="ben") == both
    _note(server, "", cell=7)
    del both["anna", 7]
    server.interrupt()
    server.start()
    assert _notes(server) == both and _notes(server, frame=2) == {}


def test_others_hear_of_a_note_and_the_blind_do_not(server):
    server.post("/api/blind", who="dora", blind=True)
    _note(server, "mine", frame=3, cell=1, who="dora")
    with server.events(who="eva") as eva, server.events(who="dora") as dora:
        eva.next("status")
        dora.next("status")
        _note(server, "theirs", frame=3, cell=1, who="anna")
        heard = eva.next("change")
        assert (heard["noted"], heard["frames"]) == ([["left", 3]], [])
        _note(server, "mine too", frame=4, who="dora")
        assert dora.next("change")["noted"] == [["left", 4]]
        with LabelStore(server.workspace / FILE_NAME) as store:  # another server's page
            (note,) = [one for _, one in store.notes_after(0, "tiny") if one.text == "theirs"]
            store.add_note(note.__class__(**{**vars(note), "frame": 5}))
        while heard["noted"] != [["left", 5]]:
            heard = eva.next("change")
    assert _notes(server, 3, who="dora") == {("dora", 1): "mine"}
    assert _notes(server, 3, who="eva") == {("dora", 1): "mine", ("anna", 1): "theirs"}


@settings(max_examples=scaled(60), deadline=None)
@given(st.sampled_from(ODD) | st.text(_NO_CONTROLS, max_size=80))
def test_any_text_without_control_characters_survives_the_server_the_store_and_a_file(
    server, tmp_path_factory, text
):
    _note(server, text, frame=6, cell=99, who="gus")
    said = {("gus", 99): text} if text else {}
    assert _notes(server, 6) == said
    server.paint(f"g{text!r:.60}", 6, [99], "reef", who="gus", base=None)
    file = tmp_path_factory.mktemp("notes") / "all.csv"
    with LabelStore(server.workspace / FILE_NAME) as store:
        notes, records = store.notes("tiny"), store.current("tiny", "gus")
    cell = Cell("tiny", "left", 6, Grid(), 9, 9)
    assert notes.get((cell, "gus"), "") == text
    write_label_csv(file, records, full=True, notes=notes)
    with file.open(newline="", encoding="utf-8") as opened:
        (row,) = csv.DictReader(opened)
    assert unguarded(row["note"]) == text
    assert read_label_csv(file, Taxonomy.load()) == records


@pytest.mark.parametrize(
    ("wrong", "status"),
    [
        ({"text": "x" * 2001}, 400),
        ({"text": "\ud800"}, 400),
        *(({"text": f"a{control}b"}, 400) for control in "\0\b\v\x1b\x7f\x85"),
        ({"text": None}, 400),
        ({"cell": 100}, 400),
        ({"cell": -1}, 400),
        ({"frame": 9999}, 404),
        ({"camera": "up"}, 400),
        ({"who": ""}, 400),
    ],
)
def test_wrong_notes_are_refused(server, wrong, status):
    body = {"who": "anna", "camera": "left", "frame": 1, "cell": 1, "text": "x", **wrong}
    answer = server.send("/api/notes", json.loads(json.dumps(body)))
    assert answer.status == status and "\n" not in answer.json["error"]
    assert _note(server, "x" * 2000, frame=8)["notes"]
