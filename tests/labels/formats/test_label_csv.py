from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.frames.grid import Grid
from tokt.labels.formats.label_csv import read_label_csv, write_label_csv
from tokt.labels.record import LabelRecord, utc_text
from tokt.labels.store.store import LabelStore

from .examples import SLOW, TAXONOMY, moments, names, put, said

HEADER = "mission,camera,frame,row,col,label\n"


_file = partial(put, name="ann.csv")


def test_six_columns(tmp_path):
    path = _file(tmp_path, HEADER + "dive,left,7,2,3,ocean\ndive,right,7,2,3,unsure\n")
    first, second = read_label_csv(path, TAXONOMY)
    assert first.cell == ("dive", "left", 7, Grid(), 2, 3)
    assert (first.label, first.annotator, first.source) == ("ocean", "ann", "human")
    assert (second.camera, second.label, second.time) == ("right", "unsure", first.time)
    (given_grid, _) = read_label_csv(path, TAXONOMY, annotator="bob", grid=Grid(4, 4))
    assert (given_grid.annotator, given_grid.grid) == ("bob", Grid(4, 4))


def test_all_columns_in_any_order_with_mark_and_windows_line_ends(tmp_path):
    path = _file(
        tmp_path,
        "\ufefflabel,source,model_version,time,grid,annotator,col,row,frame,camera,mission\r\n"
        "reef,model,lbp/3,2016-04-20T12:00:00+02:00,3x4@120,net,3,2,9,left,dive\r\n\r\n",
    )
    assert read_label_csv(path, TAXONOMY) == [
        LabelRecord(
            *("dive", "left", 9, Grid(3, 4, 120), 2, 3, "reef", "net"),
            *("2016-04-20T10:00:00Z", "model", "lbp/3"),
        )
    ]


GOOD = "dive,left,1,0,0,ocean\n"


def test_what_excel_writes_where_the_comma_is_for_decimals(tmp_path):
    text = "\ufeff" + (HEADER + GOOD).replace(",", ";").replace("\n", "\r\n")
    read = read_label_csv(put(tmp_path, text), TAXONOMY)
    plain = read_label_csv(put(tmp_path, HEADER + GOOD), TAXONOMY)
    assert [record.cell for record in read] == [record.cell for record in plain]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "empty"),
        ("mission,camera,frame,row,label\n", 1, "no column col;"),
        (HEADER.replace("label", "label,confidence") + GOOD, 1, "unknown column 'confidence'"),
        (HEADER.replace("label", "label,label") + GOOD, 1, "column label is there twice"),
        ((HEADER + GOOD).replace(",", "\t"), 1, "no column mission"),
        (HEADER + GOOD + "dive,left,1,0,1,fish\n", 3, "unknown class 'fish'; known: ocean"),
        (HEADER + GOOD + "dive,left,1,0,1,\n", 3, "unknown class ''"),
        (HEADER + GOOD + "dive,left,1,0,10,ocean\n", 3, "row 0 col 10 is outside the grid"),
        (HEADER + GOOD + "dive,left,1.5,0,1,ocean\n", 3, "frame '1.5' is not a whole number"),
        (HEADER + GOOD + f"dive,left,{'9' * 30},0,1,ocean\n", 3, "is not a whole number"),
        (HEADER + GOOD + "\n" + GOOD.replace("ocean", "reef"), 4, "is labelled on line 2 already"),
        (HEADER + GOOD + "dive,left,1,0,ocean\n", 3, "5 fields where the first line names 6"),
        (HEADER + GOOD + "dive,up,1,0,1,ocean\n", 3, "camera 'up'"),
        (HEADER + GOOD + '"dive,left,1,0,1,ocean\n', 3, "unexpected end of data"),
        (HEADER.replace("label", "label,grid") + "dive,left,1,0,1,ocean,big\n", 2, "not a grid"),
        (HEADER.replace("label", "label,time") + "dive,left,1,0,1,ocean,noon\n", 2, "time 'noon'"),
        (HEADER.replace("label", "label,source") + "dive,left,1,0,1,ocean,me\n", 2, "source 'me'"),
        (HEADER.replace("label", "label,blind") + "dive,left,1,0,1,ocean,1\n", 2, "blind '1' is"),
    ],
)
def test_mistakes_name_file_and_line(tmp_path, text, line, message):
    path = _file(tmp_path, text)
    said = refuses("", read_label_csv, path, TAXONOMY)
    assert said.startswith(f"{path} line {line}: ") and message in said


def test_files_that_are_none(tmp_path):
    refuses("does not exist", read_label_csv, tmp_path / "none.csv", TAXONOMY)
    refuses("has no labels", read_label_csv, _file(tmp_path, HEADER), TAXONOMY)
    refuses(r"Is a directory|Permission denied", read_label_csv, tmp_path, TAXONOMY)
    (tmp_path / "image.csv").write_bytes(b"\x89PNG\xff\x00")
    refuses("not UTF-8", read_label_csv, tmp_path / "image.csv", TAXONOMY)


def test_same_patch_by_two_annotators_or_in_two_grids_is_no_duplicate(tmp_path):
    text = "mission,camera,frame,row,col,label,annotator,grid\n" + "".join(
        f"dive,left,1,0,0,ocean,{who},{grid}\n" for who in "ab" for grid in ("2x2@60", "3x3@60")
    )
    assert len(read_label_csv(_file(tmp_path, text), TAXONOMY)) == 4


def test_six_columns_are_refused_where_they_would_lose_something(tmp_path):
    ann, bob, coarse = said(), said(annotator="bob"), said(grid=Grid(2, 2))
    path = tmp_path / "out.csv"
    refuses(r"2 annotators \(ann, bob\)", write_label_csv, path, [ann, bob])
    refuses("grid 2x2@360", write_label_csv, path, [coarse])
    suggestion = replace(ann, source="model", model_version="lbp/1")
    refuses("suggestions of a model", write_label_csv, path, [suggestion])
    assert not path.exists()
    assert write_label_csv(path, [ann, bob, coarse], full=True) == 3


def test_a_failed_export_leaves_the_old_file(tmp_path):
    (tmp_path / "file").write_text("old")
    refuses("cannot write", write_label_csv, tmp_path / "file" / "out.csv", [said()])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


cells = st.tuples(
    names, st.sampled_from(["left", "right"]), st.integers(0, 2**31 - 1),
    st.sampled_from([Grid(), Grid(3, 4, 120), Grid(12, 12, None)]),
    st.integers(0, 2), st.integers(0, 3),
)  # fmt: skip
records = st.builds(
    lambda cell, label, annotator, moment, source, version, blind: LabelRecord(
        *cell, label, annotator, utc_text(moment.isoformat()), source, version, blind
    ),
    *(cells, st.sampled_from([*TAXONOMY.names, "unsure"]), names, moments),
    *(st.sampled_from(["human", "human", "settled"]), st.none() | names, st.booleans()),
)


def by_whom(record):
    return record.cell, record.source, record.annotator if record.source == "human" else ""


distinct = st.lists(records, min_size=1, max_size=20, unique_by=by_whom)


@settings(SLOW, max_examples=scaled(60))
@given(distinct)
def test_export_import_export_is_lossless(tmp_path, some):
    path = tmp_path / "full.csv"
    write_label_csv(path, some, full=True)
    first = path.read_bytes()
    read = read_label_csv(path, TAXONOMY)
    assert set(read) == set(some) and len(read) == len(some)
    write_label_csv(path, reversed(read), full=True)
    assert path.read_bytes() == first


@settings(SLOW, max_examples=scaled(30))
@given(distinct)
def test_store_keeps_records_as_they_are(tmp_path, some):
    path = tmp_path / "labels.db"
    for leftover in tmp_path.glob("labels.db*"):
        leftover.unlink()
    with LabelStore(path) as store:
        assert store.add(some) == len(some)
        assert set(store.current_and_settled()) == set(some)


@pytest.mark.mission
def test_mission_labels_are_written_back_byte_for_byte(mission_dir, tmp_path):
    source = mission_dir / "labels.csv"
    records = read_label_csv(source, TAXONOMY)
    assert len(records) == 21_400
    write_label_csv(tmp_path / "out.csv", reversed(records))
    assert (tmp_path / "out.csv").read_bytes() == source.read_bytes()
