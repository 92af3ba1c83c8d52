import csv
import re
from contextlib import suppress
from dataclasses import replace
from functools import partial

import pytest
from hypothesis import given

from tests.calls import refuses
from tokt.features.frames.grid import Grid
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.options import WriteOptions

from .examples import DIVE, SLOW, TAXONOMY, put, said, some_records

read_viame_csv, write_viame_csv = FORMATS["viame"].read, FORMATS["viame"].write
_file = partial(put, name="boxes.csv")


def _through_dive(text):
    """What DIVE makes of a file: whole pixels, numbers where attributes look like some."""
    out = []
    for row in csv.reader(text.splitlines()):
        if row[0].startswith("#"):
            continue
        row[3:7] = [str(round(float(side))) for side in row[3:7]]
        for n, cell in enumerate(row):
            match = re.match(r"^\(atr\) (.*?)\s(.+)", cell)
            if match:
                value = match[2]
                with suppress(ValueError):
                    value = {"true": True, "false": False}.get(match[2]) or float(match[2])
                row[n] = f"(atr) {match[1]} {str(value).lower() if value is True else value}"
        out.append(row)
    assert out
    return "\n".join(",".join('"' + cell.replace('"', '""') + '"' for cell in row) for row in out)


@SLOW
@given(some_records(cameras=("left",)))
def test_own_files_come_back_whole_from_dive(tmp_path, reading, writing, some):
    write_viame_csv(tmp_path / "out.csv", some, writing)
    text = _through_dive((tmp_path / "out.csv").read_text("utf-8"))
    read = read_viame_csv(_file(tmp_path, text), replace(reading, images=None))
    assert set(read.records) == set(some) and read.lost == []


def test_what_other_tools_see(tmp_path, writing):
    path = tmp_path / "out.csv"
    write_viame_csv(path, [said("sand", 1, 2, frame=20)], writing)
    *comments, row = csv.reader(path.read_text().splitlines())
    assert all(line[0].startswith("#") for line in comments)
    # Frame 20 is the third of the camera; a patch is 36x27 of 360x272, so 18.1 x 13.6 here.
    assert row[:3] == ["0", "dive_L_20.png", "2"]
    assert [float(side) for side in row[3:7]] == pytest.approx([36.2, 13.6, 54.3, 27.2], abs=0.01)
    assert row[7:11] == ["1.0", "-1", "sand", "1.0"]
    assert "(atr) tokt_annotator ann" in row


def test_foreign_boxes(tmp_path, reading):
    options = replace(reading, annotator="net", classes={"fish": "other", "rock": "reef"})
    read = read_viame_csv(_file(tmp_path, DIVE), options)
    people = [record for record in read.records if record.source == "human"]
    assert {(r.frame, r.row, r.col, r.label, r.annotator) for r in people} == {
        (3, row, col, "other", "net") for row in (0, 1) for col in (0, 1)
    }
    models = [record for record in read.records if record.source == "model"]
    # The class with the higher confidence, and a detector's box is no label.
    assert {(r.frame, r.row, r.col, r.label, r.model_version) for r in models} == {
        (20, 0, col, "other", "net") for col in (0, 1)
    }
    assert sorted(read.lost) == [
        "1 box left out: covering no patch by half",
        "1 box of a model: suggestions, not labels",
        "1 box with an outline or points: only the box is read",
        "fields that tokt does not read: depth",
    ]


def test_unknown_classes_are_named_with_what_to_do(tmp_path, reading):
    path, left_out = _file(tmp_path, DIVE), replace(reading, classes={"fish": ""})
    refuses(r"'fish' \(3\); known: ocean, .*--map THEIRS=OURS", read_viame_csv, path, reading)
    refuses(r"no labels in it; .*3 boxes left out by --map", read_viame_csv, path, left_out)


def test_foreign_boxes_need_frames(tmp_path, reading):
    options = replace(reading, images=None, classes={"fish": "other"})
    refuses(r"line 3: .*--mission-dir DIR", read_viame_csv, _file(tmp_path, DIVE), options)


def test_frames_without_names_go_by_position(tmp_path, reading):
    path = _file(tmp_path, "0,,1,0,0,37,28,1,-1,reef,1\n")
    (first, *_) = read_viame_csv(path, replace(reading, camera="right")).records
    assert (first.camera, first.frame) == ("right", 7)
    path = _file(tmp_path, "0,,3,0,0,37,28,1,-1,reef,1\n")
    refuses("1 box left out: on 1 image not of the mission", read_viame_csv, path, reading)


def test_the_box_that_covers_most_decides_and_then_the_last(tmp_path, reading):
    rows = ["0,dive_L_3.png,0,0,0,18.1,13.6,1,-1,reef,1", "1,dive_L_3.png,0,0,0,18.1,9,1,-1,sand,1"]
    path = _file(tmp_path, "\n".join(rows))
    read = read_viame_csv(path, reading)
    assert [record.label for record in read.records] == ["reef"]
    assert read.lost[0].startswith("1 patch under boxes of several classes")
    path = _file(tmp_path, rows[0] + "\n" + rows[0].replace("reef", "sand"))
    assert [record.label for record in read_viame_csv(path, reading).records] == ["sand"]


def test_a_box_that_was_moved_counts_where_it_is(tmp_path, reading, writing):
    write_viame_csv(tmp_path / "out.csv", [said("reef", 0, 0)], writing)
    text = (tmp_path / "out.csv").read_text()
    moved = text.replace(",0.00,0.00,18.10,13.60,", ",18.00,0.00,36.00,14.00,")
    assert moved != text
    read = read_viame_csv(_file(tmp_path, moved), replace(reading, images=None))
    assert [(r.row, r.col, r.label, r.annotator) for r in read.records] == [(0, 1, "reef", "ann")]
    assert read.lost == ["1 box moved since tokt wrote the file: read by its new place"]


@pytest.mark.parametrize(
    ("source", "by", "comes_back_as"),
    [
        ("human", None, ("human", "ann")),
        ("human", "bob", ("human", "bob")),
        ("settled", None, ("settled", "ann")),
        ("model", None, ("human", "boxes")),
    ],
)
def test_another_class_is_a_label_by_hand_and_no_confirmed_suggestion(
    tmp_path, reading, writing, source, by, comes_back_as
):
    written = [said("reef", 0, col, source=source, model_version="net/3") for col in (0, 1)]
    write_viame_csv(tmp_path / "out.csv", written, writing)
    text = (tmp_path / "out.csv").read_text().replace(",reef,", ",sand,", 1)
    read = read_viame_csv(_file(tmp_path, text), replace(reading, annotator=by))
    by_hand, kept = sorted(read.records, key=lambda record: record.col)
    assert kept == written[1]
    assert (by_hand.label, by_hand.model_version) == ("sand", None)
    assert (by_hand.source, by_hand.annotator) == comes_back_as
    assert by_hand.time > written[0].time
    assert read.lost == ["1 box of another class than tokt wrote: labels by hand"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0,dive_L_3.png,0,0,0,10,10,1", "line 1: 8 fields where VIAME CSV has at least 9"),
        ("0,dive_L_3.png,0,0,nan,10,10,1,-1,reef,1", "line 1: box corner 'nan' is not a number"),
        ("0,dive_L_3.png,first,0,0,10,10,1,-1,reef,1", "frame 'first' is not a whole number"),
        ("0,dive_L_3.png,0,0,0,10,10,1,-1,reef,sure", "confidence 'sure' is not a number"),
        ('"0,dive_L_3.png,0', "line 1: unexpected end of data"),
        ("0,dive_L_3.png,0,10,10,0,0,1,-1,reef,1", "1 box left out: without area"),
        ("0,dive_L_3.png,0,900,0,999,50,1,-1,reef,1", "1 box left out: outside the frame"),
        ("0,other_L_3.png,0,0,0,50,50,1,-1,reef,1", "1 image not of the mission, .* 'other_L"),
        ("0,dive_L_3.png,0,0,0,50,50,1,-1", r"unknown class '' \(1\)"),
        ("0,d.png,0,0,0,9,9,1,-1,reef,1,(atr) tokt_format 1", "no tokt_mission beside tokt_format"),
        ("0,d.png,0,0,0,9,9,1,-1,reef,1,(atr) tokt_format 9", "a newer tokt wrote it"),
        ("", "no labels in it"),
    ],
)
def test_mistakes_are_one_line(tmp_path, reading, row, message):
    path = _file(tmp_path, row)
    assert str(path) in refuses(message, read_viame_csv, path, reading)


def test_huge_boxes_stay_in_the_frame(tmp_path, reading):
    path = _file(tmp_path, "0,dive_L_3.png,0,-9,-9,185,140,1,-1,reef,1\n")
    assert len(read_viame_csv(path, reading).records) == 100
    path = _file(tmp_path, "0,dive_L_3.png,0,-1e300,-1e300,1e300,1e300,1,-1,reef,1\n")
    refuses("pictures were larger where they were labelled", read_viame_csv, path, reading)
    huge = said("reef", 0, 0, grid=Grid(9999, 9999, None))
    attributes = "".join(
        f",(atr) tokt_{key} {value}"
        for key, value in {
            "format": 1, "mission": "dive", "camera": "left", "frame": 3, "grid": huge.grid,
            "row": 0, "col": 0, "label": "reef", "annotator": "ann", "time": huge.time,
            "size": "99999x99999",
        }.items()
    )  # fmt: skip
    path = _file(tmp_path, f"0,d.png,0,0,0,9e9,9e9,1,-1,reef,1{attributes}\n")
    refuses("more than 1000000 patches", read_viame_csv, path, replace(reading, images=None))


def test_one_camera_one_mission(tmp_path, writing):
    wreck = replace(said(), mission="wreck")
    for some, options, message in (
        ([said(), said(camera="right")], writing, "cameras left, right: VIAME CSV holds one"),
        ([said(), wreck], writing, "missions dive, wreck: .* --mission NAME"),
        ([said()], WriteOptions(TAXONOMY), "needs file names .* --mission-dir DIR"),
        ([said(frame=4)], writing, "no label could be written; 1 label left out: .*no such"),
    ):
        refuses(message, write_viame_csv, tmp_path / "out.csv", some, options)
    assert not (tmp_path / "out.csv").exists()
