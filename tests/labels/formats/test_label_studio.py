import json

import pytest

from tokt.labels.formats.formats import FORMATS

from .examples import foreign_label_studio, put, said, told

read_label_studio, write_label_studio = FORMATS["labelstudio"].read, FORMATS["labelstudio"].write


def test_what_label_studio_sees(tmp_path, writing):
    some = [
        said("sand", 1, 2),
        said("ocean", 1, 2, annotator="bob"),
        said("reef", 1, 2, annotator="eva", source="settled"),
        said("reef", 9, 9, annotator="net", source="model", model_version="net/3"),
        said("reef", camera="right"),
    ]
    write_label_studio(tmp_path / "out.json", some, writing)
    tasks = json.loads((tmp_path / "out.json").read_text())
    assert [task["data"]["image"] for task in tasks] == [
        "/data/local-files/?d=dive/Left/dive_L_3.png",
        "/data/local-files/?d=dive/Right/dive_R_3.png",
    ]
    annotations = [entry for task in tasks for entry in task["annotations"]]
    assert [entry["id"] for entry in annotations] == [1, 2, 3, 4]
    assert [entry["ground_truth"] for entry in annotations] == [False, False, True, False]
    # Label Studio refuses a file that names people it does not know.
    assert not any("completed_by" in entry for entry in annotations)
    (result,) = annotations[0]["result"]
    assert (result["original_width"], result["original_height"]) == (181, 137)
    value = result["value"]
    assert value["rectanglelabels"] == ["sand"]
    assert [value["x"], value["width"]] == pytest.approx([20, 10])
    # The resized frame is 272 high and 10 patches of it 270: the last strip is in none.
    assert [value["y"], value["height"]] == pytest.approx([100 * 27 / 272, 100 * 27 / 272])
    assert tasks[0]["predictions"][0]["model_version"] == "net/3"
    ids = [entry["id"] for annotation in annotations for entry in annotation["result"]]
    assert len(ids) == 4


def test_foreign_boxes(tmp_path, reading):
    read = read_label_studio(put(tmp_path, foreign_label_studio()), reading)
    found = [(r.annotator, r.camera, r.frame, r.row, r.col, r.label) for r in read.records]
    assert found == [
        ("eva@example.org", "left", 3, 0, 0, "reef"),
        ("eva@example.org", "left", 3, 0, 1, "reef"),
        ("user 10", "left", 3, 0, 0, "sand"),
        ("model 1", "left", 3, 9, 9, "ocean"),
        ("boxes", "right", 7, 0, 0, "reef"),
    ]
    assert read.records[0].time == "2021-03-09T22:16:08.728353Z"
    assert read.records[3].source == "model" and read.records[3].model_version == "model 1"
    assert sorted(read.lost) == [
        "1 annotation left out: cancelled",
        "1 box left out: turned, or without class",
        "1 box of a model: suggestions, not labels",
        "1 result left out: of type 'choices', not a labelled box",
        "4 boxes of pictures of 1810x1370, where frames have 181x137: scaled",
    ]


def test_one_task_alone_and_a_box_with_two_classes(tmp_path, reading):
    task = foreign_label_studio()[1]
    task["completions"][0]["result"][0]["value"]["rectanglelabels"] = ["reef", "sand"]
    read = read_label_studio(put(tmp_path, task), reading)
    assert [record.label for record in read.records] == ["reef"]
    assert "1 box with several classes: the first counts" in read.lost


def _result(value):
    return value[0]["annotations"][0]["result"][0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v[0].pop("data"), "task 1: no data; export from Label Studio"),
        (lambda v: v[0]["annotations"][0].pop("result"), "annotation 1: result is not a list"),
        (lambda v: v[0]["annotations"][0].update(created_at="now"), "time 'nowZ' is not like"),
        (lambda v: _result(v).update(original_width="wide"), "size 'wide' is not a whole number"),
        (lambda v: _result(v).update(original_height=10**7), "a size that no picture has"),
        (lambda v: _result(v)["value"].update(x=float("inf")), "x inf is not a number"),
        (lambda v: _result(v).update(meta={"tokt_format": 1}), "no tokt_mission beside"),
    ],
)
def test_mistakes_are_one_line(tmp_path, reading, change, message):
    value = foreign_label_studio()
    change(value)
    assert message in told(read_label_studio, put(tmp_path, value), reading)
