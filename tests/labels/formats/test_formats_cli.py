import csv
import json

import pytest

from tokt.labels.store.store import LabelStore, Note

from .examples import said

RECORDS = [
    said("sand", 1, 2, model_version="net/3", blind=True),
    said("reef", 1, 3, camera="right", annotator="bob"),
    said("reef", 1, 3, camera="right"),
]


@pytest.fixture
def labels(tmp_path, run_tokt):
    """`tokt labels` in a workspace with some labels, one of them changed since."""
    workspace = tmp_path / ".tokt"
    with LabelStore(workspace / "labels.db") as store:
        store.add([said("ocean", 1, 2)])
        store.add(RECORDS)

    def run(verb, file, *words, store=".tokt"):
        return run_tokt("labels", verb, tmp_path / file, "--workspace", tmp_path / store, *words)

    return run


@pytest.mark.parametrize(
    ("file", "name"), [("out.json", "coco"), ("out.json", "labelstudio"), ("out.csv", "csv")]
)
def test_there_and_back(labels, tmp_path, dive, file, name):
    more = ("--full",) if name == "csv" else ("--mission-dir", dive)
    ran = labels("export", file, "--format", name, *more)
    assert ran.code == 0, ran.err
    assert f"{file}: 3 labels" in ran.err
    assert "1 earlier label left out: files hold those in force" in ran.err
    came = labels("import", file, "--json", store="copy")
    said_back = json.loads(came.out)
    assert (said_back["format"], said_back["labels"], said_back["lost"]) == (name, 3, [])
    assert said_back["annotators"] == ["ann", "bob"]
    with LabelStore(tmp_path / "copy" / "labels.db") as store:
        assert set(store.current()) == set(RECORDS)


def test_notes_are_beside_labels_of_the_full_csv_and_said_where_they_are_lost(labels, tmp_path):
    with LabelStore(tmp_path / ".tokt" / "labels.db") as store:
        for row, col, who, text in (
            *((1, 2, "ann", "coral, or\nrock"), (1, 3, "ann", ""), (4, 4, "ann", "no label here")),
            *((1, 2, "bob", "no label of bob"), (None, None, "ann", "murky")),
        ):
            grid = None if row is None else RECORDS[0].grid
            store.add_note(Note("dive", "left", 3, grid, row, col, text, who, RECORDS[0].time))
    assert "CSV: 3 notes left out: csv --full keeps" in labels("export", "a.csv", "--full").err
    with (tmp_path / "a.csv").open(newline="", encoding="utf-8") as opened:
        notes = {
            (row["row"], row["col"], row["camera"]): row["note"] for row in csv.DictReader(opened)
        }
    assert notes == {("1", "2", "left"): "coral, or\nrock", ("1", "3", "right"): ""}
    assert "3 notes left out" in labels("export", "b.csv", "--annotator", "ann").err
    came = labels("import", "a.csv", store="copy")
    assert came.err == "CSV: 1 note left out: notes stay in the workspace they were written in\n"


def test_viame_and_patches(labels, tmp_path, dive):
    frames = ("--mission-dir", dive)
    ran = labels("export", "out.csv", "--format", "viame", *frames)
    assert ran.code == 2 and "choose it by --camera" in ran.err
    assert labels("export", "out.csv", "--format", "viame", *frames, "--camera", "left").code == 0
    came = json.loads(labels("import", "out.csv", "--json", store="copy").out)
    assert (came["format"], came["new"]) == ("viame", 1)
    ran = labels("export", "patches", *frames)
    assert ran.code == 2 and "choose by --annotator" in ran.err
    ran = labels("export", "patches", *frames, "--annotator", "ann", "--grid", "10x10@360")
    assert ran.code == 0 and "2 labels" in ran.err.splitlines()[-2]
    (tmp_path / "patches" / "ocean").mkdir()
    (file,) = (tmp_path / "patches" / "sand").iterdir()
    file.rename(tmp_path / "patches" / "ocean" / file.name)
    ran = labels("import", "patches")
    assert ": 0 new, 1 changed, 1 known" in ran.out
    assert ran.err == "folder of patches: 1 patch moved to another class: labels by hand\n"


def test_foreign_file(labels, tmp_path, dive):
    (tmp_path / "fish.csv").write_text(
        "0,dive_L_3.png,0,0,0,37,28,1,-1,fish,1\n1,dive_L_3.png,0,90,90,95,95,1,-1,fish,1\n"
    )
    ran = labels("import", "fish.csv", "--mission-dir", dive)
    assert ran.code == 2 and "'fish' (2)" in ran.err and ran.err.count("\n") == 1
    options = ("--map", "fish=other", "--mission-dir", dive, "--mission", "wreck")
    ran = labels("import", "fish.csv", *options, "--annotator", "eva", "--json", store="new")
    came = json.loads(ran.out)
    assert (came["annotators"], came["new"]) == (["eva"], 4)
    assert came["lost"] == ["1 box left out: covering no patch by half"]
    with LabelStore(tmp_path / "new" / "labels.db") as store:
        assert store.missions() == ["wreck"]
    ran = labels("import", "fish.csv", "--map", "fish")
    assert ran.code == 2 and "not of the form THEIRS=OURS" in ran.err
