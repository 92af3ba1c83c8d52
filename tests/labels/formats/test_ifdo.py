import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.calls import refuses
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.frame_metadata import FrameMetadata, ifdo_of, load_ifdo, read_ifdo
from tokt.labels.formats.images import FrameKey, MissionImages
from tokt.labels.formats.options import WriteOptions

from .examples import TAXONOMY, foreign_ifdo, put, said

HEADER, ITEMS = "image-set-header", "image-set-items"
LEFT, RIGHT = FrameKey("left", 3), FrameKey("right", 20)


@pytest.fixture
def dive_with_ifdo(tmp_path):
    """A mission of two frames, with a file of metadata and another tool's annotations."""
    for side, frame in (("Left", 3), ("Right", 20)):
        (tmp_path / "dive" / side).mkdir(parents=True)
        path = tmp_path / "dive" / side / f"dive_{side[0]}_{frame}.png"
        cv2.imwrite(str(path), np.full((137, 181), 90, np.uint8))
    put(tmp_path / "dive", foreign_ifdo(), "ifdo.json")
    return WriteOptions(TAXONOMY, MissionImages(open_mission(tmp_path / "dive")))


def test_metadata_of_frames(tmp_path, images):
    expected = FrameMetadata("2016-04-20T10:00:00.250000Z", 63.4, 10.4, 310.5, 2.5, 271.0)
    only_depth = FrameMetadata(None, None, None, 300.0, None, None)
    found = read_ifdo(put(tmp_path, foreign_ifdo(), "ifdo.json"), images)
    assert found == {LEFT: expected, RIGHT: only_depth}
    text = """
image-set-header:
  image-altitude: -310.5   # before version 2
  image-datetime-format: "%d.%m.%Y %H:%M:%S.%f"
image-set-items:
  dive_L_3.png:
    image-datetime: 20.04.2016 10:00:00.250
    image-latitude: 63.4
    image-longitude: 10.4
    image-camera-yaw-degrees: 271
    image-meters-above-ground: 2.5
  dive_R_20.png: [{image-depth: 300, image-datetime: 20.04.2016 10:00:00.250}]
"""
    if find_spec("yaml"):
        found = read_ifdo(put(tmp_path, text, "ifdo.yml"), images)
        assert found == {LEFT: expected, RIGHT: replace(only_depth, time=expected.time)}
        usual = text.replace("20.04.2016", "2016-04-20").replace("datetime-format", "x")
        assert read_ifdo(put(tmp_path, usual, "ifdo.yml"), images)[LEFT] == expected


def test_where_it_lies(tmp_path, monkeypatch):
    (tmp_path / "dive").mkdir()
    assert ifdo_of(tmp_path / "dive") is None
    put(tmp_path, {}, "ifdo.json")  # of another dive, for all that is known
    assert ifdo_of(tmp_path / "dive") is None
    beside = put(tmp_path, {}, "dive_ifdo.yaml")
    assert ifdo_of(tmp_path / "dive") == ifdo_of(tmp_path / "dive.mp4") == beside
    (tmp_path / "dive.2").mkdir()
    assert ifdo_of(tmp_path / "dive.2") is None
    inside = put(tmp_path / "dive", {}, "ifdo.yml")
    monkeypatch.chdir(tmp_path / "dive")
    assert ifdo_of(tmp_path / "dive") == ifdo_of(Path()) == inside


def test_labels_go_beside_what_was_known(tmp_path, dive_with_ifdo):
    some = [said("reef", 1, 2), said("sand", 0, 0, camera="right", frame=20, annotator="Bo B.")]
    some.append(said("ocean", 9, 9, source="model", annotator="net", model_version="net/3"))
    path = tmp_path / "out.json"
    assert FORMATS["ifdo"].write(path, some, dive_with_ifdo).lost == [
        "1 suggestion of models left out: in iFDO they would count as labels"
    ]
    document, before = json.loads(path.read_text()), foreign_ifdo()
    labels = document[HEADER].pop("image-annotation-labels")
    creators = document[HEADER].pop("image-annotation-creators")
    assert [label["id"] for label in labels] == ["8a45", "reef", "sand"]
    assert [creator["name"] for creator in creators] == ["Eva Ås", "Bo B.", "ann"]
    assert document[HEADER].items() <= before[HEADER].items()
    assert list(document[ITEMS]) == list(before[ITEMS])
    item, was = document[ITEMS]["dive_L_3.png"], before[ITEMS]["dive_L_3.png"]
    annotations = item.pop("image-annotations")
    others = was.pop("image-annotations")
    assert item == was and annotations[: len(others)] == others
    (reef,) = annotations[len(others) :]
    corners = [36.2, 13.599, 54.3, 13.599, 54.3, 27.199, 36.2, 27.199]
    assert reef["shape"] == "rectangle" and reef["coordinates"][0] == pytest.approx(
        corners, abs=0.01
    )
    (label,) = reef["labels"]
    assert label == {"label": "reef", "annotator": "ann", "created-at": "2016-04-20T10:00:00Z"}
    assert len(document[ITEMS]["dive_R_20.png"][0]["image-annotations"]) == 1
    # Where that file then lies with the mission, labels are there once.
    (tmp_path / "dive" / "ifdo.json").write_bytes(path.read_bytes())
    FORMATS["ifdo"].write(tmp_path / "again.json", some, dive_with_ifdo)
    assert json.loads((tmp_path / "again.json").read_text()) == json.loads(path.read_text())


def test_without_a_file_of_metadata(tmp_path, writing):
    written = FORMATS["ifdo"].write(tmp_path / "out.json", [said()], writing)
    assert written.lost == [
        "1 header with no more than a name: no ifdo.json is in the mission's folder"
    ]
    document = load_ifdo(tmp_path / "out.json")
    assert document[HEADER]["image-set-name"] == "dive" and list(document[ITEMS]) == [
        "dive_L_3.png"
    ]


def test_annotations_of_other_tools(tmp_path, reading):
    read = FORMATS["ifdo"].read(put(tmp_path, foreign_ifdo()), reading)
    people = [r for r in read.records if r.source == "human"]
    (reef,) = people
    assert (reef.row, reef.col, reef.label, reef.annotator) == (0, 0, "reef", "Eva Ås")
    assert reef.time == "2021-03-09T22:16:08.500000Z"
    models = {(r.row, r.col, r.label, r.model_version) for r in read.records} - {
        (0, 0, "reef", None)
    }
    assert {(0, 0, "sand", "net"), (9, 0, "sand", "net")} < models
    assert (5, 4, "sand", "net") not in models
    assert "1 shape left out: 'whole-image' with 0 numbers" in read.lost


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v.pop(HEADER), f"{HEADER} is not an object"),
        (lambda v: v[ITEMS].update({"dive_L_7.png": [7]}), "'dive_L_7.png' is not an object"),
        (lambda v: v[HEADER].update({"image-latitude": "N"}), "image-latitude 'N' is not a number"),
        (lambda v: v[HEADER].update({"image-depth": float("nan")}), "image-depth nan is not"),
        (lambda v: v[HEADER].update({"image-datetime": "noon"}), "time 'noonZ' is not like"),
        (lambda v: v[HEADER].update({"image-datetime-format": "%Y"}), "is not of the form '%Y'"),
    ],
)
def test_mistakes_are_one_line(tmp_path, images, change, words):
    value = foreign_ifdo()
    for item in value[ITEMS].values():
        if isinstance(item, dict) and "datetime-format" not in words:
            item.pop("image-latitude", None)
    if "image-datetime" in words or "noon" in words:
        value[ITEMS]["dive_L_3.png"].pop("image-datetime")
    change(value)
    path = put(tmp_path, value, "ifdo.json")
    assert str(path) in refuses(words, read_ifdo, path, images)


@pytest.mark.skipif(find_spec("yaml") is None, reason="PyYAML is not installed (extra label)")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &x [1]\nb: *x", "YAML with an alias"),
        ("a: !!python/object/apply:os.system [ls]", "a tag"),
        ("- " * 100_000 + "x", "YAML of more than 50 levels"),
        ("a: [", "line 2: not YAML"),
        (f"a: {'9' * 5000}", "YAML that cannot be read"),
        ("? [a]\n: b", "line 1: not YAML: found unhashable key"),
        ("", "the file is not an object"),
    ],
)
def test_odd_yaml_is_refused_in_one_line(tmp_path, text, words):
    path = put(tmp_path, text, "ifdo.yaml")
    assert str(path) in refuses(words, load_ifdo, path)


def test_the_formats_own_library_reads_what_is_written(tmp_path, writing, dive_with_ifdo):
    ifdo = pytest.importorskip("ifdo", reason="ifdo is not installed (extra dev)")
    FORMATS["ifdo"].write(tmp_path / "bare.json", [said("reef", 1, 2)], writing)
    assert ifdo.iFDO.load(tmp_path / "bare.json").image_set_header.image_set_name == "dive"
    FORMATS["ifdo"].write(tmp_path / "out.json", [said("reef", 1, 2)], dive_with_ifdo)
    document = ifdo.iFDO.load(tmp_path / "out.json")
    annotation = document.image_set_items["dive_L_3.png"].image_annotations[-1]
    assert annotation.shape == "rectangle" and len(annotation.coordinates[0]) == 8
    assert (annotation.labels[0].label, annotation.labels[0].annotator) == ("reef", "ann")
    assert document.image_set_header.image_altitude_meters == -310.5
    assert [entry.id for entry in document.image_set_header.image_annotation_labels][-1] == "reef"
