"""CoralNet, BIIGLE and CVAT: what these tools write is read, and ours is what they read."""

import csv
import io
import json
import re
from dataclasses import replace
from itertools import product
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.calls import refuses
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.boxes import (
    Box,
    Size,
    found_shape,
    patch_at,
    patches_in_box,
    patches_in_outline,
)
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.taxonomy import LabelClass, Taxonomy

from .examples import BIIGLE, CORALNET, CVAT, put, said, told

SIZE = Size(1024, 1360)


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def found(read):
    return {(r.camera, r.frame, r.row, r.col, r.label, r.annotator) for r in read.records}


def test_a_point_is_in_the_patch_that_holds_it():
    # 1360x1024 becomes 360x271: patches of 136 x 102.02 px, and a strip of 3.78 px under them.
    assert patch_at(Grid(), SIZE, 0, 0) == (0, 0)
    assert patch_at(Grid(), SIZE, 135.99, 102) == (0, 0)
    assert patch_at(Grid(), SIZE, 136, 102.1) == (1, 1)
    assert patch_at(Grid(), SIZE, 1359.9, 1020.2) == (9, 9)
    for x, y in ((0, 1021), (-0.1, 5), (1360, 5), (5, 1e300), (1e308, 5)):
        assert patch_at(Grid(), SIZE, x, y) is None


def test_polygons_take_the_patches_they_cover_by_half():
    triangle = ((0.0, 0.0), (0.0, 1024.0), (1360.0, 1024.0))
    patches = {(row, col) for row, col, _ in patches_in_outline(Grid(), SIZE, triangle)}
    assert patches >= {(row, col) for row in range(10) for col in range(row)}
    assert not patches & {(row, col) for row in range(10) for col in range(row + 1, 10)}
    # Its box would take all of them.
    line = ((0.0, 0.0), (1360.0, 1000.0), (1360.0, 1024.0), (0.0, 24.0))
    assert patches_in_outline(Grid(), SIZE, line) == []
    far = ((-1e300, -1e300), (1e300, -1e300), (1e300, 1e300), (-1e300, 1e300))
    assert len(patches_in_outline(Grid(), SIZE, far)) == 100


@given(
    st.sampled_from([Grid(), Grid(3, 4, 120)]),
    st.tuples(st.integers(100, 1500), st.integers(200, 1500)),
    st.tuples(*[st.floats(-0.5, 1.5)] * 4),
)
def test_a_box_given_as_a_polygon_takes_the_same_patches(grid, sides, corners):
    size = Size(*sides)
    height, width = grid.resized(*size)
    assume(height // grid.rows >= 12)
    x0, x1 = sorted(x * size.width for x in corners[:2])
    y0, y1 = sorted(y * size.height for y in corners[2:])
    polygon = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    as_polygon = {(row, col) for row, col, _ in patches_in_outline(grid, size, polygon)}
    # Counted in pixels: a patch of 12 pixels may err by one of them, in both directions.
    grown, shrunk = 1.5 * size.width / width, -1.5 * size.width / width
    for by, holds in ((grown, as_polygon.__le__), (shrunk, as_polygon.__ge__)):
        box = Box(x0 - by, y0 - by, x1 + by, y1 + by)
        assert holds({(row, col) for row, col, _ in patches_in_box(grid, size, box)})


def test_shapes():
    assert found_shape("point", [3, 4]) == (Box(3, 4, 3, 4), ((3, 4),))
    assert found_shape("rectangle", [0, 0, 5, 0, 5, 4, 0, 4]) == (Box(0, 0, 5, 4), ())
    turned, outline = found_shape("rectangle", [5, 0, 10, 5, 5, 10, 0, 5])
    assert turned == Box(0, 0, 10, 10) and len(outline) == 4
    around, outline = found_shape("circle", [50, 60, 10])
    assert around == pytest.approx((40, 50, 60, 70)) and len(outline) == 64
    for kind, numbers in (
        *(("point", []), ("point", [1]), ("rectangle", [0, 0, 5, 4]), ("polygon", [0] * 7)),
        *(("circle", [1, 2]), ("linestring", [0, 0, 5, 4]), ("wholeframe", []), ("", [])),
    ):
        assert found_shape(kind, numbers) is None


def test_coralnet_sees_a_point_a_patch(tmp_path, writing):
    some = [said("reef", 0, 0), said("subsea_installation", 9, 9, camera="right", frame=20)]
    some.append(said("sand", 0, 0, source="settled", annotator="bo"))
    some.append(said("ocean", 5, 5, source="model", annotator="net", model_version="net/3"))
    written = FORMATS["coralnet"].write(tmp_path / "out.csv", some, writing)
    assert written.lost == [
        "1 suggestion of models left out: in CoralNet they would count as labels",
        "1 opinion on patches that were settled",
        "1 label 'subsea_installation' is longer than CoralNet's label codes of 10 signs",
    ]
    text = (tmp_path / "out.csv").read_text()
    assert text.splitlines()[0] == "Name,Row,Column,Label code,tokt"
    # The pixel that holds the middle: patches are 18.1 x 13.6 px, and CoralNet counts from 0.
    rows = [list(row.values())[:4] for row in rows_of(tmp_path / "out.csv")]
    assert rows == [
        ["dive_L_3.png", "6", "9", "sand"],
        ["dive_R_20.png", "129", "171", "subsea_installation"],
    ]
    two = [said("reef"), said("sand", annotator="bo")]
    words = "labelled by ann and by bo: CoralNet holds one label a patch; choose by --annotator"
    refuses(words, FORMATS["coralnet"].write, tmp_path / "out.csv", two, writing)


def test_patches_smaller_than_a_pixel_are_left_out(tmp_path, writing):
    fine = Grid(10, 360, 1080)  # a third of a frame of 181 pixels: half a pixel wide
    some = [said("reef", 5, col, grid=fine) for col in range(360)]
    written = FORMATS["coralnet"].write(tmp_path / "out.csv", some, writing)
    left = 360 - written.labels
    assert written.lost == [
        f"{left} labels left out: its patch is too small for a pixel in its middle"
    ]
    assert 0 < left < 360


def test_points_of_coralnet(tmp_path, reading):
    options = replace(reading, classes={"fish": "other"})
    read = FORMATS["coralnet"].read(put(tmp_path, CORALNET, "coral.csv"), options)
    whole = {("left", 3, 0, col, "reef", "eva") for col in (0, 1)}
    assert found(read) == {*whole, ("right", 20, 9, 9, "other", "robot")}
    robot = [(r.source, r.model_version) for r in read.records if r.camera == "right"]
    assert robot == [("model", "robot")]
    assert {record.time for record in read.records} == {"2021-03-09T22:16:08Z"}
    assert sorted(read.lost) == [
        "1 patch left out: points of several classes",
        "1 point left out: in no patch",
        "1 point left out: without a label",
        "1 point of a model: suggestions, not labels",
        "fields that tokt does not read: machine suggestion 1",
    ]


@pytest.mark.parametrize("label", ["Label", "Label ID", "LABEL CODE"])
def test_older_exports_of_coralnet_and_of_excel(tmp_path, reading, label):
    text = f"\ufeffName;Row;Column;{label}\r\ndive_L_3.png;5;5;reef\r\n"
    read = FORMATS["coralnet"].read(put(tmp_path, text, "coral.csv"), reading)
    assert found(read) == {("left", 3, 0, 0, "reef", "coral")}


def test_a_point_corrected_in_a_spreadsheet(tmp_path, reading, writing):
    path = tmp_path / "out.csv"
    FORMATS["coralnet"].write(path, [said("reef", 0, 0), said("reef", 0, 1)], writing)
    text = path.read_text().replace("6,9,reef", "6,9,sand").replace("6,27,reef", "6,45,reef")
    read = FORMATS["coralnet"].read(put(tmp_path, text, "out.csv"), reading)
    assert found(read) == {("left", 3, 0, 0, "sand", "ann"), ("left", 3, 0, 2, "reef", "ann")}
    assert read.lost == [
        "1 point of another class than tokt wrote: labels by hand",
        "1 point moved since tokt wrote the file: read by its new place",
    ]


def test_biigle_sees_a_rectangle_a_patch(tmp_path, writing):
    some = [said("reef", 0, 0), said("sand", 1, 2, annotator="bo"), said("unsure", frame=20)]
    assert FORMATS["biigle"].write(tmp_path / "out.csv", some, writing).lost == []
    first, second, third = rows_of(tmp_path / "out.csv")
    assert (first["label_name"], first["label_hierarchy"]) == ("reef", "reef")
    assert (first["filename"], first["shape_name"]) == ("dive_L_3.png", "Rectangle")
    assert (first["firstname"], first["created_at"]) == ("ann", "2016-04-20 10:00:00")
    points = [36.2, 13.599, 54.3, 13.599, 54.3, 27.199, 36.2, 27.199]
    assert json.loads(second["points"]) == pytest.approx(points, abs=0.01)
    assert json.loads(second["attributes"]) == {"width": 181, "height": 137}
    assert [row["user_id"] for row in (first, second, third)] == ["1", "2", "1"]
    assert [row["image_id"] for row in (first, second, third)] == ["1", "1", "2"]


def test_shapes_of_biigle(tmp_path, reading):
    classes = {"Biota > Fish": "other", "Fine": "sand"}
    options = replace(reading, classes=classes)
    read = FORMATS["biigle"].read(put(tmp_path, BIIGLE, "report.csv"), options)
    reef = {("left", 3, 0, col, "reef", "Eva Ås") for col in (0, 1)}
    fish = {("left", 3, row, col, "other", "Eva Ås") for row in (4, 5) for col in (4, 5)}
    assert reef | fish < found(read)
    rest = {(r.row, r.col) for r in read.records if r.label == "sand"}
    assert (9, 9) not in rest and (9, 0) in rest and (5, 4) not in rest and len(rest) > 10
    assert {record.time for record in read.records} == {"2021-03-09T22:16:08Z"}
    assert sorted(read.lost) == [
        "1 box of pictures of 362x274, where frames have 181x137: scaled",
        "1 point left out: in no patch",
        "1 point of pictures of 362x274, where frames have 181x137: scaled",
        "1 shape left out: 'LineString' with 4 numbers",
        "1 shape left out: 'WholeFrame' with 0 numbers",
        "2 outlines of pictures of 362x274, where frames have 181x137: scaled",
    ]
    words = r"unknown class 'Biota > Fish > Cod, big' \(1\), 'Sediment > Fine' \(2\)"
    refuses(words, FORMATS["biigle"].read, tmp_path / "report.csv", reading)
    exact = replace(options, classes={**classes, "Biota > Fish > Cod, big": ""})
    read = FORMATS["biigle"].read(tmp_path / "report.csv", exact)
    assert "1 outline left out by --map: class 'Biota > Fish > Cod, big'" in read.lost


def test_cvat_sees_boxes_and_the_tasks_labels(tmp_path, writing):
    some = [said("reef", 0, 0), said("sand", 1, 2, camera="right", frame=20)]
    some.append(said("ocean", 5, 5, source="model", annotator="net", model_version="net/3"))
    assert FORMATS["cvat"].write(tmp_path / "out.xml", some, writing).lost == [
        "1 suggestion of models left out: in CVAT they would count as labels"
    ]
    root = ElementTree.fromstring((tmp_path / "out.xml").read_bytes())
    assert root.findtext("version") == "1.1" and root.findtext("meta/task/size") == "2"
    labels = [label.findtext("name") for label in root.findall("meta/task/labels/label")]
    assert labels == ["ocean", "other", "sand", "reef", "subsea_installation"]
    images = root.findall("image")
    names = [(image.get("id"), image.get("name"), image.get("width")) for image in images]
    assert names == [("0", "Left/dive_L_3.png", "181"), ("1", "Right/dive_R_20.png", "181")]
    (box,) = images[1]
    sides = [float(box.get(side)) for side in ("xtl", "ytl", "xbr", "ybr")]
    assert sides == pytest.approx([36.2, 13.6, 54.3, 27.2], abs=0.01)
    sources = {box.get("label"): box.get("source") for box in root.iter("box")}
    assert sources == {"reef": "manual", "sand": "manual"}


def test_shapes_of_cvat(tmp_path, reading):
    read = FORMATS["cvat"].read(put(tmp_path, CVAT, "boxes.xml"), reading)
    people = {(r.row, r.col, r.label) for r in read.records if r.source == "human"}
    assert {(0, 0, "reef"), (0, 1, "reef"), (9, 0, "sand")} <= people
    assert (5, 4, "sand") not in people and (9, 9, "sand") not in people
    models = [(r.row, r.col, r.model_version) for r in read.records if r.source == "model"]
    assert models == [(0, 8, "CVAT automatic")]
    assert sorted(read.lost) == [
        "1 box of pictures of 362x274, where frames have 181x137: scaled",
        "1 outline of pictures of 362x274, where frames have 181x137: scaled",
        "1 point left out: in no patch",
        "1 shape left out: ellipse, not a box, polygon or point",
        "1 shape left out: polyline, not a box, polygon or point",
        "1 shape left out: tag, not a box, polygon or point",
        "1 shape left out: turned box, not a box, polygon or point",
        "1 track left out: export in the format CVAT for images 1.1",
        "2 points of a model: suggestions, not labels",
        "2 points of pictures of 362x274, where frames have 181x137: scaled",
        "fields that tokt does not read: depth",
    ]


GRIDS = (Grid(), Grid(3, 4, 120), Grid(7, 13, 200), Grid(2, 2, None))
CLASSES = ("ocean", "Ålegress-2", "unsure")
KNOWN = Taxonomy(
    (
        LabelClass("ocean", obstacle=False, color="#0072b2", key="1"),
        LabelClass("Ålegress-2", obstacle=True, color="#d55e00", key="2"),
    )
)


def without_ours(name, text):
    """The file as a tool gives it back that keeps nothing but what the format has."""
    if name == "ifdo":
        document = json.loads(text)
        for item in document["image-set-items"].values():
            for annotation in item["image-annotations"]:
                del annotation["tokt"]
        return json.dumps(document)
    if name == "cvat":
        return re.sub("<attribute name=.*?</attribute>", "", text)
    rows = [row[:-1] for row in csv.reader(io.StringIO(text))]
    out = io.StringIO()
    csv.writer(out).writerows(rows)
    return out.getvalue()


@pytest.mark.parametrize("size", [(1024, 1360), (137, 181), (300, 201)])
@pytest.mark.parametrize("name", ["coralnet", "biigle", "cvat", "ifdo"])
def test_places_alone_bring_every_patch_back(tmp_path, name, size):
    (tmp_path / "dive").mkdir()
    cv2.imwrite(str(tmp_path / "dive" / "Åse, 7.png"), np.zeros(size, np.uint8))
    images = MissionImages(open_mission(tmp_path / "dive"))
    suffix = {"cvat": "xml", "ifdo": "json"}.get(name, "csv")
    for grid in GRIDS:
        cells = product(range(grid.rows), range(grid.cols))
        some = [said(CLASSES[(row + col) % 3], row, col, frame=7, grid=grid) for row, col in cells]
        path = tmp_path / f"out.{suffix}"
        assert FORMATS[name].write(path, some, WriteOptions(KNOWN, images)).labels == len(some)
        path.write_text(without_ours(name, path.read_text("utf-8")), "utf-8")
        read = FORMATS[name].read(path, ReadOptions(KNOWN, grid=grid, images=images))
        assert read.lost == []
        came = {(record.cell, record.label) for record in read.records}
        assert came == {(record.cell, record.label) for record in some}


BOMB = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 12))
ODD_XML = {
    "bomb": f'<!DOCTYPE a [<!ENTITY a0 "lol">{BOMB}]><annotations>&a11;</annotations>',
    "file": '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><annotations>&x;</annotations>',
    "outer": '<!DOCTYPE a SYSTEM "http://127.0.0.1:9/a.dtd"><annotations/>',
}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        *((text, "it has a DOCTYPE, which CVAT does not write") for text in ODD_XML.values()),
        ("<annotations>" * 10_000, "not XML: no element found"),
        ("<annotations>" + "<a>" * 10**4 + "</a>" * 10**4 + "</annotations>", "no labels in it"),
        ("", "not XML: no element found"),
        ("<annotations>&x;</annotations>", "not XML: undefined entity"),
        ("<coco/>", "not of CVAT, whose XML begins with <annotations>"),
        (CVAT.replace('ybr="27.00"', ""), "image 1 shape 1: ybr None is not a number"),
        (CVAT.replace("300,20;", "a,20;"), "image 1 shape 4: points 'a' is not a number"),
        (
            CVAT.replace('width="362"', 'width="wide"'),
            "image 1 shape 1: its image: width 'wide' is not a whole",
        ),
    ],
)
def test_odd_xml_is_refused_in_one_line(tmp_path, reading, text, words):
    path = put(tmp_path, text, "boxes.xml")
    assert words in (line := told(FORMATS["cvat"].read, path, reading)) and "\n" not in line


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("coralnet", "Name,Row\na.png,1\n", "line 1: 0 columns 'column' where there must be one"),
        (
            "coralnet",
            "Name,Row,Column\na.png,1,1\n",
            "line 2: 3 fields, too few, or no column 'Label code'",
        ),
        ("coralnet", "Name,Row,Column,Label\na.png,x,1,reef\n", "line 2: row 'x' is not a whole"),
        ("coralnet", "Name,Row,Column,Label\n", "no labels in it"),
        ("coralnet", 'Name,Row,Column,Label\n"a', "line 2: unexpected end of data"),
        ("biigle", "label_name,filename\n", "line 1: 0 columns 'shape_name'"),
        ("biigle", BIIGLE.replace('"[361, 273]"', "[361"), "line 4: points is not a list"),
        ("biigle", BIIGLE.replace("[361, 273]", "[true, 1]"), "points True is not a number"),
        ("biigle", BIIGLE.replace("2021-03-09", "9.3.2021"), "time '9.3.2021 22:16:08Z' is not"),
        ("coralnet", f"{CORALNET}7\n", "line 9: 1 fields, too few"),
    ],
)
def test_mistakes_name_file_and_line(tmp_path, reading, name, text, words):
    options = replace(reading, classes={"Biota > Fish": "other", "Fine": "sand", "fish": "other"})
    assert words in told(FORMATS[name].read, put(tmp_path, text, "table.csv"), options)
