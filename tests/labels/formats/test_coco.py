import json
from dataclasses import replace

import pytest

from tests.calls import refuses
from tokt.features.frames.grid import Grid
from tokt.labels.formats.formats import FORMATS
from tokt.labels.taxonomy import Taxonomy

from .examples import foreign_coco, put, said, told

read_coco, write_coco = FORMATS["coco"].read, FORMATS["coco"].write


def test_what_other_tools_see(tmp_path, writing):
    some = [said("sand", 1, 2), said("unsure", camera="right", frame=20), said("sand", 0, 0)]
    write_coco(tmp_path / "out.json", some, writing)
    document = json.loads((tmp_path / "out.json").read_text())
    files = [image["file_name"] for image in document["images"]]
    assert files == ["Left/dive_L_3.png", "Right/dive_R_20.png"]
    assert document["images"][0] == {**document["images"][0], "width": 181, "height": 137, "id": 1}
    names = {entry["id"]: entry["name"] for entry in document["categories"]}
    assert list(names.values()) == [*Taxonomy.load().names, "unsure"] and min(names) == 1
    first, second, third = document["annotations"]
    assert [entry["id"] for entry in document["annotations"]] == [1, 2, 3]
    classes = [names[entry["category_id"]] for entry in (first, second, third)]
    assert classes == ["sand", "sand", "unsure"]
    assert second["bbox"] == pytest.approx([36.2, 13.6, 18.1, 13.6], abs=0.01)
    assert second["area"] == pytest.approx(18.1 * 13.6, abs=0.1)
    assert (third["image_id"], third["iscrowd"]) == (2, 0)


def test_foreign_boxes(tmp_path, reading):
    options = replace(reading, classes={"fish": "other"})
    read = read_coco(put(tmp_path, foreign_coco()), options)
    found = {(r.camera, r.frame, r.row, r.col, r.label, r.source) for r in read.records}
    assert found == {
        ("left", 3, 0, 0, "reef", "human"),
        ("left", 3, 0, 1, "reef", "human"),
        ("right", 20, 1, 1, "other", "model"),
    }
    assert {record.annotator for record in read.records} == {"boxes"}
    assert {record.mission for record in read.records} == {"dive"}
    assert sorted(read.lost) == [
        "1 annotation left out: of a crowd",
        "1 annotation left out: without a box",
        "1 annotation with an outline: only its box is read",
        "1 box of a model: suggestions, not labels",
        "2 boxes of pictures of 362x274, where frames have 181x137: scaled",
    ]
    coarse = read_coco(put(tmp_path, foreign_coco()), replace(options, grid=Grid(20, 20)))
    assert sum(record.source == "human" for record in coarse.records) == 2 * 5


def test_half_of_a_patch_is_enough(tmp_path, reading):
    value = foreign_coco()
    half, less = [0, 0, 36.2, 13.6001], [0, 0, 36.2, 13.5]
    value["annotations"] = [{"id": 1, "image_id": 1, "category_id": 7, "bbox": half}]
    assert len(read_coco(put(tmp_path, value), reading).records) == 1
    value["annotations"] = [{"id": 1, "image_id": 1, "category_id": 7, "bbox": less}]
    refuses("1 box left out: covering no patch by half", read_coco, put(tmp_path, value), reading)


def test_boxes_on_frames_of_another_mission_are_counted(tmp_path, reading):
    value = foreign_coco()
    value["images"][1]["file_name"] = "wreck_20.png"
    read = read_coco(put(tmp_path, value), replace(reading, classes={"fish": "other"}))
    assert "1 box left out: on 1 image not of the mission, such as 'wreck_20.png'" in read.lost
    value["images"][1]["file_name"] = "wreck" * 1000
    read = read_coco(put(tmp_path, value), replace(reading, classes={"fish": "other"}))
    assert max(map(len, read.lost)) < 200


def test_a_label_corrected_elsewhere_and_a_box_drawn_over(tmp_path, reading, writing):
    write_coco(tmp_path / "out.json", [said("reef", 0, 0), said("reef", 0, 1)], writing)
    document = json.loads((tmp_path / "out.json").read_text())
    ids = {entry["name"]: entry["id"] for entry in document["categories"]}
    document["annotations"][0]["category_id"] = ids["sand"]
    over = {"id": 9, "image_id": 1, "category_id": ids["ocean"], "bbox": [18, 0, 36, 14]}
    document["annotations"].append(over)
    read = read_coco(put(tmp_path, document), replace(reading, annotator="ann"))
    assert [(r.col, r.label) for r in read.records] == [(0, "sand"), (1, "ocean"), (2, "ocean")]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v.pop("images"), "images is not a list"),
        (lambda v: v["images"][1].update(id=1), "images 2: id 1 is there twice"),
        (lambda v: v["images"][0].update(file_name=7), "file_name of its image is not text"),
        (lambda v: v["images"][0].update(width=0), "annotation 1: a size that no picture has"),
        (lambda v: v["annotations"][0].update(bbox=[0, 0, 5]), "bbox has 3 numbers, not 4"),
        (lambda v: v["annotations"][0].update(bbox=[0, 0, float("nan"), 5]), "nan is not a number"),
        (lambda v: v["annotations"][0].update(image_id=8), "its image_id is that of no image"),
        (lambda v: v["annotations"][1].update(score="high"), "score 'high' is not a number"),
        (
            lambda v: v["annotations"][0].update(attributes={"tokt_format": {}}),
            "not a whole number",
        ),
    ],
)
def test_mistakes_are_one_line(tmp_path, reading, change, message):
    value = foreign_coco()
    change(value)
    options = replace(reading, classes={"fish": "other"})
    assert message in told(read_coco, put(tmp_path, value), options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: not JSON"),
        ('{"images": [', "line 1: not JSON"),
        ("[" * 100_000, "JSON that cannot be read"),
        ("9" * 5000, "JSON that cannot be read"),
        ("7", "the file is not an object"),
    ],
)
def test_files_that_are_none(tmp_path, reading, text, message):
    refuses(message, read_coco, put(tmp_path, text), reading)
    (tmp_path / "utf16.json").write_text("{}", encoding="utf-16")
    refuses("not UTF-8", read_coco, tmp_path / "utf16.json", reading)
    refuses("does not exist", read_coco, tmp_path / "none.json", reading)
