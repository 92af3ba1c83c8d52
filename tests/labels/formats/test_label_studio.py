from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.labels.formats.label_studio import read_label_studio, write_label_studio
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.record import LabelRecord

from .examples import damaged, said, some_records, with_odd_values

SLOW = settings(
    max_examples=scaled(25), suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def _box(label: str, x: float, y: float, width: float, height: float) -> dict[str, Any]:
    return {
        "id": "Dx_aB91ISN",
        "type": "rectanglelabels",
        "from_name": "tag",
        "to_name": "img",
        "original_width": 1810,
        "original_height": 1370,
        "image_rotation": 0,
        "value": {
            "x": x, "y": y, "width": width, "height": height,
            "rotation": 0, "rectanglelabels": [label],
        },
    }  # fmt: skip


def _foreign() -> list[dict[str, Any]]:
    """A project that two people labelled, and a model."""
    turned = _box("reef", 0, 0, 10, 10)
    turned["value"]["rotation"] = 30
    return [
        {
            "id": 1,
            "data": {"img": "/data/upload/3/0a1b2c3d-dive_L_3.png", "note": "deep"},
            "annotations": [
                {
                    "id": 1001,
                    "completed_by": {"email": "eva@example.org", "id": 7},
                    "created_at": "2021-03-09T22:16:08.728353Z",
                    "result": [_box("reef", 0, 0, 20, 10), turned, {"type": "choices"}],
                },
                {"completed_by": 10, "result": [_box("sand", 0, 0, 10, 10)]},
                {"was_cancelled": True, "result": [_box("sand", 50, 50, 10, 10)]},
            ],
            "predictions": [
                {"model_version": "model 1", "result": [_box("ocean", 90, 90, 10, 10)]}
            ],
        },
        {
            "data": {"img": "https://example.org/Right/dive_R_7.png?d=Right/dive_R_7.png"},
            "completions": [{"result": [_box("reef", 0, 0, 10, 10)]}],
        },
    ]


def _file(folder: Path, value: Any) -> Path:
    path = folder / "project.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return path


@SLOW
@given(some_records(), st.booleans())
def test_own_files_come_back_whole(
    tmp_path: Path,
    reading: ReadOptions,
    writing: WriteOptions,
    some: list[LabelRecord],
    with_frames: bool,
) -> None:
    written = write_label_studio(tmp_path / "out.json", some, writing)
    assert (written.labels, written.lost) == (len(some), [])
    options = reading if with_frames else replace(reading, images=None)
    read = read_label_studio(tmp_path / "out.json", options)
    assert set(read.records) == set(some) and len(read.records) == len(some)
    assert read.lost == []


def test_what_label_studio_sees(tmp_path: Path, writing: WriteOptions) -> None:
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


def test_foreign_boxes(tmp_path: Path, reading: ReadOptions) -> None:
    read = read_label_studio(_file(tmp_path, _foreign()), reading)
    found = [(r.annotator, r.camera, r.frame, r.row, r.col, r.label) for r in read.records]
    assert found == [
        ("eva@example.org", "left", 3, 0, 0, "reef"),
        ("eva@example.org", "left", 3, 0, 1, "reef"),
        ("user 10", "left", 3, 0, 0, "sand"),
        ("model 1", "left", 3, 9, 9, "ocean"),
        ("project", "right", 7, 0, 0, "reef"),
    ]
    assert read.records[0].time == "2021-03-09T22:16:08.728353Z"
    assert read.records[3].source == "model" and read.records[3].model_version == "model 1"
    assert sorted(read.lost) == [
        "1 annotation left out: cancelled",
        "1 box left out: turned, or without class",
        "1 box of a model: suggestions, not labels",
        "1 result left out: of type 'choices', not a labelled box",
    ]


def test_one_task_alone_and_a_box_with_two_classes(tmp_path: Path, reading: ReadOptions) -> None:
    task = _foreign()[1]
    task["completions"][0]["result"][0]["value"]["rectanglelabels"] = ["reef", "sand"]
    read = read_label_studio(_file(tmp_path, task), reading)
    assert [record.label for record in read.records] == ["reef"]
    assert read.lost == ["1 box with several classes: the first counts"]


def _result(value: list[dict[str, Any]]) -> dict[str, Any]:
    return value[0]["annotations"][0]["result"][0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v: v[0].pop("data"), "task 1 has no data; export from Label Studio"),
        (lambda v: v.insert(0, None), "task 1 is not an object"),
        (lambda v: v[0].update(annotations="all"), "task 1: annotations is not a list"),
        (lambda v: v[0]["annotations"][0].pop("result"), "annotation 1: result is not a list"),
        (lambda v: v[0]["annotations"][0].update(created_at="now"), "time 'now' is not like"),
        (lambda v: _result(v).pop("original_width"), "original_width None is not a whole number"),
        (lambda v: _result(v).update(original_height=10**7), "a frame of 1810x10000000 pixels"),
        (lambda v: _result(v).update(original_width=10**400), "original_width 100.* is not a wh"),
        (lambda v: _result(v)["value"].update(x=None), "result 1: x None is not a number"),
        (lambda v: _result(v)["value"].update(x=float("inf")), "x inf is not a number"),
        (lambda v: _result(v)["value"].update(rectanglelabels=[{}]), "is not text"),
        (
            lambda v: _result(v)["value"].update(rectanglelabels=["fish"]),
            r"unknown class 'fish' \(1",
        ),
        (lambda v: _result(v).update(meta={"tokt_format": 1}), "no tokt_mission beside"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, reading: ReadOptions, change, message: str) -> None:
    value = _foreign()
    change(value)
    path = _file(tmp_path, value)
    with pytest.raises(ToktError, match=message) as caught:
        read_label_studio(path, reading)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@SLOW
@given(st.data())
def test_damaged_files_are_refused_or_read(
    tmp_path: Path, reading: ReadOptions, writing: WriteOptions, data: st.DataObject
) -> None:
    some = [said("sand", 1, 2), said(source="model", annotator="7", model_version="net/3")]
    write_label_studio(tmp_path / "out.json", some, writing)
    if data.draw(st.booleans()):
        (tmp_path / "bad.json").write_bytes(
            data.draw(damaged((tmp_path / "out.json").read_bytes()))
        )
    else:
        own = json.loads((tmp_path / "out.json").read_text())
        changed = data.draw(with_odd_values(data.draw(st.sampled_from([own, _foreign()]))))
        (tmp_path / "bad.json").write_text(json.dumps(changed))
    try:
        read_label_studio(tmp_path / "bad.json", reading)
    except ToktError as error:
        assert "\n" not in str(error)
