"""Labels of a small mission, and files gone wrong."""

import json

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from tests.tiers import scaled
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
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def put(folder, value, name="boxes.json"):
    """A file of this text, or of this as JSON."""
    path = folder / name
    path.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return path


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


@st.composite
def damaged(draw, data):
    """A file that was cut, or had some bytes changed, put in or taken out."""
    if draw(st.booleans()):
        return data[: draw(st.integers(0, len(data)))]
    found = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(found)))
        words = [b'"', b",", b"\n", b"-", b"NaN", b"null", b"9" * 400, b"1e999", b"[]"]
        put_in = draw(st.binary(max_size=2) | st.sampled_from(words))
        found[at : at + draw(st.integers(0, 3))] = put_in
    return bytes(found)


NUMBERS = [True, -1, 0, 3.5, 10**30, float("nan"), float("inf")]
ODD_VALUES = st.sampled_from([None, *NUMBERS, "", "x", "3", "\ud800", [], [1], {}])


@st.composite
def with_odd_values(draw, value):
    """A JSON value some of whose parts are another kind of thing."""
    places = list(_places(value))
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(places))
        holder[key] = draw(ODD_VALUES)
    return value


def _places(value):
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, part in items:
        yield value, key
        if isinstance(part, dict | list):
            yield from _places(part)


# --- files of other tools

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
            {"id": 1, "file_name": "some/where/Left/dive_L_3.png", **image},
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
