import contextlib
import json
import sqlite3

import pytest

from tests.calls import refused, succeeds
from tests.inference.test_faults import hold_row

HEADER = "mission,camera,frame,row,col,label\n"
ANN = HEADER + "".join(f"dive,left,1,0,{n},{'reef' if n > 6 else 'ocean'}\n" for n in range(10))
BOB = HEADER + "".join(f"dive,left,1,0,{n},{'reef' if n > 5 else 'ocean'}\n" for n in range(10))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ann.csv").write_text(ANN)
    (tmp_path / "bob.csv").write_text(BOB)
    return tmp_path


def _good(folder, *words):
    with contextlib.chdir(folder):
        return succeeds("labels", *words).out


def _refused(folder, *words):
    with contextlib.chdir(folder):
        said = refused("", "labels", *words)
    assert said.count("\n") == 1
    return said


def test_import_stats_export(folder):
    assert "10 labels by ann: 10 new, 0 changed, 0 known" in _good(folder, "import", "ann.csv")
    again = json.loads(_good(folder, "import", "ann.csv", "--json"))
    assert (again["labels"], again["new"], again["unchanged"]) == (10, 0, 10)
    changed = json.loads(_good(folder, "import", "bob.csv", "--annotator", "ann", "--json"))
    assert (changed["new"], changed["changed"]) == (0, 1)
    assert (folder / ".tokt" / "labels.db").is_file()
    table = _good(folder, "stats")
    # mission, annotator, frames, patches, ocean, reef, blind, events
    assert table.splitlines()[2].split() == ["dive", "ann", "1", "10", "6", "4", "0", "11"]
    stats = json.loads(_good(folder, "stats", "--json"))
    assert stats["annotators"][0]["counts"] == {"ocean": 6, "reef": 4}
    _good(folder, "export", "out.csv")
    assert (folder / "out.csv").read_text() == BOB
    said = json.loads(_good(folder, "export", "again.csv", "--json"))
    assert (said["file"], said["labels"]) == ("again.csv", 10)
    assert (folder / "again.csv").read_text() == BOB


def test_annotators_are_kept_apart(folder):
    for name in ("ann.csv", "bob.csv"):
        _good(folder, "import", name, "--workspace", "ws")
    assert "2 annotators (ann, bob)" in _refused(folder, "export", "o.csv", "--workspace", "ws")
    assert not (folder / "o.csv").exists()
    _good(folder, "export", "o.csv", "--annotator", "ann", "--workspace", "ws")
    assert (folder / "o.csv").read_text() == ANN
    _good(folder, "export", "all.csv", "--full", "--workspace", "ws")
    copied = json.loads(_good(folder, "import", "all.csv", "--workspace", "copy", "--json"))
    assert copied["annotators"] == ["ann", "bob"] and copied["new"] == 20
    _good(folder, "export", "all2.csv", "--full", "--workspace", "copy")
    assert (folder / "all2.csv").read_bytes() == (folder / "all.csv").read_bytes()


def test_an_import_says_how_many_labels_were_settled(folder):
    full = HEADER.replace("\n", ",annotator,time,grid,source,model_version\n")
    more = "2016-04-20T10:00:00Z,10x10@360"
    rows = f"dive,left,1,0,0,reef,ann,{more},human,\ndive,left,1,0,0,reef,cat,{more},settled,\n"
    (folder / "settled.csv").write_text(full + rows)
    assert "1 new, 0 changed, 0 known already, 1 settled" in _good(folder, "import", "settled.csv")
    again = json.loads(_good(folder, "import", "settled.csv", "--json"))
    assert (again["new"], again["settled"], again["unchanged"]) == (0, 0, 2)


def test_agreement_of_files_and_annotators(folder):
    by_file = json.loads(_good(folder, "agreement", "ann.csv", "bob.csv", "--json"))
    assert by_file["confusion"] == [[6, 1], [0, 3]]
    assert by_file["kappa"] == pytest.approx((0.9 - 0.54) / (1 - 0.54))
    assert not (folder / ".tokt").exists()
    for name in ("ann.csv", "bob.csv"):
        _good(folder, "import", name)
    by_name = json.loads(_good(folder, "agreement", "ann", "bob", "--json"))
    assert {**by_name, "a": "", "b": ""} == {**by_file, "a": "", "b": ""}
    assert "0.7826" in _good(folder, "agreement", "ann", "bob.csv")
    assert "which has ann, bob" in _refused(folder, "agreement", "ann", "eve")


def test_a_wrong_line_imports_nothing(folder):
    (folder / "bad.csv").write_text(ANN + "dive,left,2,0,0,fish\n")
    assert "line 12: unknown class 'fish'" in _refused(folder, "import", "bad.csv")
    assert not (folder / ".tokt").exists()


def test_other_mistakes_are_one_line(folder):
    assert "no label store" in _refused(folder, "stats")
    assert "no label store" in _refused(folder, "export", "out.csv")
    assert "does not exist" in _refused(folder, "import", "none.csv")
    assert "end in .csv" in _refused(folder, "import", "labels.xlsx")
    assert "not a grid" in _refused(folder, "import", "ann.csv", "--grid", "ten")
    assert "no label store" in _refused(folder, "agreement", "ann", "bob")
    _good(folder, "import", "ann.csv")
    assert "missions dive" in _refused(folder, "export", "out.csv", "--mission", "transit")
    (folder / ".tokt" / "labels.db").write_text("not a database at all" * 50)
    assert "not a database" in _refused(folder, "stats")


def test_names_in_an_edited_store_move_no_cursor(folder):
    _good(folder, "import", "ann.csv")
    with contextlib.closing(sqlite3.connect(folder / ".tokt" / "labels.db")) as store, store:
        for (name,) in store.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'"):
            store.execute(f"DROP TRIGGER {name}")
        store.execute(
            "UPDATE events SET mission = ?, annotator = ?, label = ?", ["\x1b[2Jx\u202e"] * 3
        )
    table = _good(folder, "stats")
    assert table.count(r"\x1b[2Jx\u202e") == 3 and table.replace("\n", "").isprintable()
    said = r"shown as text, such as `\x1b`"
    hold_row("escape sequences in the label store or the model registry", said, "nothing")
