"""Labels of a small mission, and files gone wrong."""

import csv
import io
import json

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.labels.record import LabelRecord, utc_text
from tokt.labels.taxonomy import Taxonomy

TAXONOMY = Taxonomy.load()
FRAMES = (3, 7, 20)
HEIGHT, WIDTH = 137, 181
GRIDS = (Grid(), Grid(3, 4, 120), Grid(2, 2, None))
TIME = "2016-04-20T10:00:00Z"

SLOW = settings(
    max_examples=scaled(25),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def put(folder, value, name="boxes.json"):
    """A file of this text, or of this as JSON."""
    path = folder / name
    path.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return path


def told(read, path, options):
    """All that a reader says of a file: why it refused it, or what it left out."""
    try:
        return "; ".join(read(path, options).lost)
    except ToktError as error:
        assert str(path) in str(error)
        return str(error)


def said(label="reef", row=0, col=0, **more):
    """A label of the mission."""
    values = {"camera": "left", "frame": 3, "grid": Grid(), "annotator": "ann", "time": TIME}
    values.update(more)
    return LabelRecord(mission="dive", row=row, col=col, label=label, **values)


# Names that a spreadsheet, a CSV reader or DIVE would take for something else.
names = st.sampled_from(
    ["7", "007", "1e5", "true", "nan", '"q"', "a,b", "0x1f", "Åse Ø.", "(atr) x"]
)
names |= st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8)
moments = st.datetimes(timezones=st.timezones()).filter(lambda t: 2 < t.year < 9998)


@st.composite
def _records(draw, cameras, grids):
    grid = draw(st.sampled_from(grids))
    source = draw(st.sampled_from(["human", "human", "model", "settled"]))
    return said(
        draw(st.sampled_from([*TAXONOMY.names, "unsure"])),
        draw(st.integers(0, grid.rows - 1)),
        draw(st.integers(0, grid.cols - 1)),
        camera=draw(st.sampled_from(cameras)),
        frame=draw(st.sampled_from(FRAMES)),
        grid=grid,
        annotator=draw(names),
        time=utc_text(draw(moments).isoformat()),
        source=source,
        model_version=draw(names if source == "model" else st.none() | names),
        blind=source != "model" and draw(st.booleans()),
    )


def some_records(cameras=("left", "right"), grids=GRIDS):
    """Labels in force: one a patch and annotator, one settlement and any suggestions a patch."""
    return st.lists(
        _records(cameras, grids),
        min_size=1,
        max_size=12,
        unique_by=lambda r: (r.cell, "" if r.source == "settled" else r.annotator, r.source),
    )


# What DIVE writes: 2x2 patches of the 10x10 grid are 36.2 px wide and 26.9 px high here (the
# resized frame is 360x272, so a patch is 18.1 x 13.6 px of the 181x137 frame).
DIVE = """# 1: Detection or Track-id,2: Video or Image Identifier,3: Unique Frame Identifier
# metadata,"exported_by: ""dive:python\""",fps: 5
0,dive_L_3.png,0,0,0,37,28,1,-1,fish,1,(atr) depth 12.0,(poly) 0 0 37 0 37 28
1,dive_L_7.png,1,100,100,104,104,1,-1,fish,1
2,dive_L_20.png,2,0,0,37,14,0.4,-1,rock,0.1,fish,0.4
"""


def foreign_coco():
    """A file of another tool, of pictures of twice our frames' size."""
    image = {"width": 362, "height": 274}
    reef = {"id": 1, "image_id": 1, "category_id": 7}
    return {
        "images": [
            {"id": 1, "file_name": "some/dive/Left/dive_L_3.png", **image},
            {"id": 2, "file_name": "dive_R_20.png", **image},
        ],
        "categories": [{"id": 5, "name": "fish"}, {"id": 7, "name": "reef"}],
        "annotations": [
            # Patches are 36.2 x 27.2 of 362x274 here: two, and a third by less than half.
            {**reef, "bbox": [0, 0, 89, 27], "segmentation": [[1]]},
            {"id": 2, "image_id": 2, "category_id": 5, "bbox": [36, 27, 37, 28], "score": 0.7},
            {"id": 3, "image_id": 2, "category_id": 7, "bbox": [0, 0, 90, 28], "iscrowd": 1},
            {"id": 4, "image_id": 2, "category_id": 7},
        ],
    }


def _box(label, x, y, width, height):
    what = {"type": "rectanglelabels", "from_name": "tag", "to_name": "img"}
    size = {"original_width": 1810, "original_height": 1370, "image_rotation": 0}
    place = {"x": x, "y": y, "width": width, "height": height, "rotation": 0}
    return {"id": "Dx_aB91ISN", **what, **size, "value": {**place, "rectanglelabels": [label]}}


def foreign_label_studio():
    """A project that two people labelled, and a model."""
    turned = _box("reef", 0, 0, 10, 10)
    turned["value"]["rotation"] = 30
    eva = {"completed_by": {"email": "eva@example.org", "id": 7}}
    results = [_box("reef", 0, 0, 20, 10), turned, {"type": "choices"}]
    annotations = [
        {"id": 1001, **eva, "created_at": "2021-03-09T22:16:08.728353Z", "result": results},
        {"completed_by": 10, "result": [_box("sand", 0, 0, 10, 10)]},
        {"was_cancelled": True, "result": [_box("sand", 50, 50, 10, 10)]},
    ]
    predictions = [{"model_version": "model 1", "result": [_box("ocean", 90, 90, 10, 10)]}]
    left = {"img": "/data/upload/3/0a1b2c3d-dive_L_3.png", "note": "deep"}
    right = {"img": "https://example.org/Right/dive_R_7.png?d=Right/dive_R_7.png"}
    return [
        {"id": 1, "data": left, "annotations": annotations, "predictions": predictions},
        {"data": right, "completions": [{"result": [_box("reef", 0, 0, 10, 10)]}]},
    ]


# What CoralNet exports with the annotator, of a whole patch, a patch of two minds, a robot's and a
# point in the strip under the patches.
CORALNET = """Name,Row,Column,Label code,Annotator,Date annotated,Machine suggestion 1
dive_L_3.png,0,0,reef,eva,2021-03-09 22:16:08+00:00,sand
dive_L_3.png,13,18,reef,eva,2021-03-09 22:16:08+00:00,
dive_L_7.png,20,30,sand,Imported,2021-03-09 22:16:08+00:00,
dive_L_7.png,25,20,reef,Imported,2021-03-09 22:16:08+00:00,
dive_R_20.png,136,0,fish,eva,,
dive_R_20.png,135,180,fish,robot,2021-03-09 22:16:08+00:00,fish
dive_R_20.png,5,5,,eva,,
"""

_BIIGLE_SIZE = json.dumps({"mimetype": "image/png", "width": 362, "height": 274})
_BIIGLE_ROWS = [
    ["Biota > Sponges > reef", "reef", "Rectangle", [0, 0, 89, 0, 89, 27, 0, 27]],
    ["Biota > Fish > Cod, big", "Cod, big", "Circle", [181, 137, 30]],
    ["Sediment > Fine", "Fine", "Point", [361, 273]],
    ["Sediment > Fine", "Fine", "Polygon", [0, 135, 0, 272, 181, 272]],
    ["Sediment > Fine", "Fine", "LineString", [0, 0, 300, 200]],
    ["Sediment > Fine", "Fine", "WholeFrame", []],
]


def _biigle():
    """A report as BIIGLE writes it, of pictures of twice our frames' size."""
    out = io.StringIO()
    writer = csv.writer(out)
    names = "annotation_label_id,label_id,label_name,label_hierarchy,user_id,firstname,lastname"
    names += ",image_id,filename,image_longitude,image_latitude,shape_id,shape_name,points"
    writer.writerow(f"{names},attributes,annotation_id,created_at".split(","))
    for n, (path, label, shape, points) in enumerate(_BIIGLE_ROWS):
        who = [7, "Eva", "Ås"]
        where = [3, "dive_L_3.png", "", "", 1, shape, json.dumps(points), _BIIGLE_SIZE]
        writer.writerow([n, 9, label, path, *who, *where, n, "2021-03-09 22:16:08"])
    return out.getvalue()


BIIGLE = _biigle()

CVAT = """<?xml version="1.0" encoding="utf-8"?>
<annotations>
  <version>1.1</version>
  <meta><job><id>1</id><labels><label><name>reef</name></label></labels></job></meta>
  <image id="0" name="Left/dive_L_3.png" width="362" height="274">
    <box label="reef" source="manual" occluded="0" xtl="0.00" ytl="0.00" xbr="89.00" ybr="27.00"
      z_order="0"><attribute name="depth">12</attribute></box>
    <box label="reef" source="manual" occluded="0" xtl="0" ytl="0" xbr="90" ybr="90" rotation="30"/>
    <polygon label="sand" source="manual" points="0.00,135.00;0.00,272.00;181.00,272.00"/>
    <points label="reef" source="auto" points="300,20;361,273"/>
    <polyline label="reef" points="0,0;9,9"/>
    <tag label="reef" source="manual"/>
  </image>
  <image id="1" name="dive_R_20.png"><ellipse label="fish" cx="3" cy="3" rx="2" ry="2"/></image>
  <track id="0" label="reef"/>
</annotations>
"""


def foreign_ifdo():
    """Metadata with annotations, of pictures of our frames' size."""
    said = {"label": "8a45", "annotator": "0000-0002", "created-at": "2021-03-09 22:16:08.5"}
    guessed = {**said, "label": "sand", "annotator": "net", "confidence": 0.7}
    half = [0, 67.5, 0, 136, 90.5, 136, 0, 67.5]
    return {
        "image-set-header": {
            "image-set-name": "dive",
            "image-set-uuid": "f840644a-fe4a-46a7-9791-e32c211bcbf5",
            "image-set-handle": "https://example.org/f840644a",
            "image-set-ifdo-version": "v2.1.0",
            "image-altitude-meters": -310.5,
            "image-annotation-labels": [{"id": "8a45", "name": "reef"}],
            "image-annotation-creators": [{"id": "0000-0002", "name": "Eva Ås"}],
        },
        "image-set-items": {
            "dive_L_3.png": {
                "image-datetime": "2016-04-20 10:00:00.250",
                "image-latitude": 63.4,
                "image-longitude": 10.4,
                "image-camera-yaw-degrees": 271.0,
                "image-meters-above-ground": 2.5,
                "image-annotations": [
                    {"shape": "single-pixel", "coordinates": [[0, 0]], "labels": [said, guessed]},
                    {"shape": "polygon", "coordinates": [half], "labels": [guessed]},
                    {"shape": "whole-image", "coordinates": [[]], "labels": [said]},
                ],
            },
            "dive_R_20.png": [{"image-altitude-meters": -300}],
            "other_5.png": {},
        },
    }
