from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.calls import refuses
from tests.fixtures import write_video
from tokt.features.common.errors import FrameError, ToktError
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.box_attributes import to_attributes
from tokt.labels.formats.boxes import Box, Size, patch_box, patches_in_box
from tokt.labels.formats.formats import FORMATS, format_named, format_to_read, format_to_write
from tokt.labels.formats.images import FrameKey, MissionImages, NamedFrame
from tokt.labels.record import LabelRecord

from .examples import said

KINDS = {
    "ours.csv": ("csv", "mission,camera,frame,row,col,label\n"),
    "ours_too.csv": ("csv", "frame,row,col,label,camera,mission,time,grid,source,annotator\n"),
    "wrong.csv": ("csv", "a,b\n"),
    "empty.csv": ("csv", ""),
    "dive.csv": ("viame", '"# 1: Detection or Track-id",2: Video\n'),
    "plain.csv": ("viame", "\n0,a.png,12,0,0,5,5,1,-1,reef,1\n"),
    "points.csv": ("coralnet", "Row;Column;Name;Label\n"),
    "aux.csv": ("coralnet", "\ufeffName,Date,Aux1,Row,Column,Label code\n"),
    "report.csv": ("biigle", "annotation_label_id,shape_name,points\n"),
    "spread.csv": ("csv", "mission;camera;frame;row;col;label\n"),
    "cvat.xml": ("cvat", "<annotations/>"),
    "dive.yaml": ("ifdo", ""),
    "ifdo.json": ("ifdo", '{"image-set-header": {}}'),
    "coco.json": ("coco", '{"images": []}'),
    "tasks.json": ("labelstudio", "[]"),
    "task.json": ("labelstudio", '{"data": {}}'),
}


@pytest.mark.parametrize("name", KINDS)
def test_formats_are_told_apart_by_content(tmp_path, name):
    kind, text = KINDS[name]
    (tmp_path / name).write_text(text)
    assert format_to_read(tmp_path / name) == kind


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_with_the_formats_ending_is_told_by_itself(tmp_path, writing, name):
    path = tmp_path / f"out{FORMATS[name].ending}"
    FORMATS[name].write(path, [said()], writing)
    assert format_to_read(path) == name


def test_what_is_no_label_file(tmp_path):
    assert format_to_read(tmp_path) == "patches"
    (tmp_path / "labels").write_text("")
    (tmp_path / "x.json").write_text('{"a": 1}')
    (tmp_path / "y.json").write_text("{")
    for name, message in (
        ("labels", "end in .csv, .json, .xml or .yaml"),
        ("labels.xlsx", "end in .csv, .json, .xml or .yaml"),
        ("none.csv", "does not exist"),
        ("none", "does not exist"),
        ("x.json", "neither COCO .* nor Label Studio .* nor iFDO"),
        ("y.json", "not JSON"),
    ):
        refuses(message, format_to_read, tmp_path / name)
    refuses("no label format 'yolo'; there are csv, viame, coco", format_named, "yolo")
    refuses(
        "--format coco or --format labelstudio or --format ifdo",
        format_to_write,
        tmp_path / "new.json",
    )
    assert format_to_write(tmp_path / "new.csv") == "csv"
    assert format_to_write(tmp_path / "patches") == "patches"
    assert format_to_write(tmp_path / "new.xml") == "cvat"


def test_csv_says_what_six_columns_lose(tmp_path, reading, writing):
    some = [said(), said("sand", 1, 1, model_version="net/3")]
    written = FORMATS["csv"].write(tmp_path / "six.csv", some, writing)
    assert written.lost == [
        "2 labels without annotator and time (--full keeps them)",
        "1 model version of confirmed suggestions (--full keeps them)",
    ]
    written = FORMATS["csv"].write(tmp_path / "all.csv", some, replace(writing, full=True))
    assert (written.labels, written.lost) == (2, [])
    assert FORMATS["csv"].read(tmp_path / "all.csv", reading).records == some
    first, second = some
    for ours, rest in (("reef", [replace(second, label="reef")]), ("", [])):
        mapped = replace(reading, classes={"sand": ours})
        assert FORMATS["csv"].read(tmp_path / "all.csv", mapped).records == [first, *rest]


def test_all_that_a_record_says_is_carried():
    record = said(source="settled", model_version="net/3", blind=True, file="dive_L_3.png")
    carried = {name.removeprefix("tokt_") for name in to_attributes(record)} - {"format"}
    assert carried == {field.name for field in fields(LabelRecord)}


def test_file_names_of_other_tools(images, dive, tmp_path):
    third = FrameKey("left", 3)
    for name in (
        *("dive_L_3.png", "Left/dive_L_3.png", "dive_L_3.jpg"),
        "C:\\cruise\\dive\\LEFT\\DIVE_L_3.PNG",
        "/data/local-files/?d=dive/Left/dive_L_3.png",
        "/data/upload/3/0a1b2c3d-dive_L_3.png",
        "s3://bucket/dive%5FL%5F3.png",
    ):
        assert images.find(name).key == third, name
    for name in ("", "dive_L_4.png", "..", "/", "\ud800", "3"):
        assert images.find(name).key is None
    assert images.file_name(third) == "Left/dive_L_3.png"
    assert images.file_name(FrameKey("left", 4)) is None
    assert images.size(third) == Size(137, 181)
    same = tmp_path / "same"
    for side in ("Left", "Right"):
        (same / side).mkdir(parents=True)
        (same / side / "3.png").write_bytes((dive / side / f"dive_{side[0]}_3.png").read_bytes())
    twins = MissionImages(open_mission(same), "dive")
    assert twins.name == "dive" and twins.find("3.png").key is None
    assert twins.find("same/right/3.png").key == FrameKey("right", 3)
    assert twins.find("x/right/3.png") == NamedFrame(folder="x")


def test_frames_of_a_video(tmp_path):
    levels = (np.full((48, 64, 3), 80 * level, np.uint8) for level in range(3))
    images = MissionImages(open_mission(write_video(tmp_path / "dive.avi", levels)))
    assert images.is_video and images.file_name(FrameKey("left", 2)) == "dive_000002.png"
    assert images.find("dive_000002.png").key == FrameKey("left", 2)
    assert images.at("left", 0) == FrameKey("left", 1) and images.at("left", 3) is None
    assert images.size(FrameKey("left", 3)) == Size(48, 64)
    with pytest.raises(FrameError):
        images.size(FrameKey("left", 4))


def test_boxes_of_the_thesis_grid():
    # 1360x1024 becomes 360x271: 136 px wide patches, 27 of 271 rows high.
    assert patch_box(Grid(), Size(1024, 1360), 1, 2) == pytest.approx(
        (272, 27 * 1024 / 271, 408, 54 * 1024 / 271)
    )


@given(
    st.sampled_from([Grid(), Grid(3, 4, 120), Grid(2, 2, None)]),
    st.integers(100, 3000),
    st.integers(100, 3000),
    st.tuples(*[st.floats(-50, 150)] * 4),
)
def test_a_box_takes_the_patches_it_covers_by_half(grid, height, width, percent):
    size = Size(height, width)
    x0, y0, x1, y1 = percent
    box = Box(x0 * width / 100, y0 * height / 100, x1 * width / 100, y1 * height / 100)
    try:
        found = {(row, col): share for row, col, share in patches_in_box(grid, size, box)}
    except ToktError:
        assert height / width < 0.35 or width < 360  # patches under 3 px
        return
    for row in range(grid.rows):
        for col in range(grid.cols):
            patch = patch_box(grid, size, row, col)
            wide = max(0.0, min(patch.x1, box.x1) - max(patch.x0, box.x0))
            high = max(0.0, min(patch.y1, box.y1) - max(patch.y0, box.y0))
            share = wide * high / ((patch.x1 - patch.x0) * (patch.y1 - patch.y0))
            if abs(share - 0.5) > 1e-6:
                assert ((row, col) in found) == (share > 0.5)
            if (row, col) in found:
                assert found[row, col] == pytest.approx(share)
