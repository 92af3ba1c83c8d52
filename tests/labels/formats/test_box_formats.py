"""What the formats of boxes have in common: whole there and back, and damage is refused."""

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.common.errors import ToktError
from tokt.labels.formats.formats import FORMATS

from .examples import (
    DIVE,
    SLOW,
    damaged,
    foreign_coco,
    foreign_label_studio,
    said,
    some_records,
    with_odd_values,
)

FOREIGN = {"coco": foreign_coco, "labelstudio": foreign_label_studio}
FILES = {"viame": "boxes.csv", "coco": "boxes.json", "labelstudio": "boxes.json"}
all_formats = pytest.mark.parametrize("name", FILES)


@all_formats
@SLOW
@given(some_records(), st.booleans())
def test_own_files_come_back_whole(tmp_path, reading, writing, name, some, with_frames):
    path = tmp_path / FILES[name]
    if name == "viame":  # holds one camera
        some = [record for record in some if record.camera == some[0].camera]
    written = FORMATS[name].write(path, some, writing)
    assert (written.labels, written.lost) == (len(some), [])
    options = reading if with_frames else replace(reading, images=None)
    read = FORMATS[name].read(path, options)
    assert set(read.records) == set(some) and len(read.records) == len(some)
    assert read.lost == []
    sources = [record.source for record in read.records]
    assert sources == sorted(sources, key=lambda source: source == "settled")


@all_formats
@SLOW
@given(st.data())
def test_damaged_files_are_refused_or_read(tmp_path, reading, writing, name, data):
    path = tmp_path / FILES[name]
    some = [said("sand", 1, 2), said("reef", annotator="7")]
    some.append(said(source="model", annotator="7", model_version="net/3"))
    FORMATS[name].write(path, some, writing)
    whole = path.read_bytes()
    if name == "viame":
        path.write_bytes(data.draw(damaged(whole + DIVE.encode())))
    elif data.draw(st.booleans()):
        path.write_bytes(data.draw(damaged(whole)))
    else:
        seed = data.draw(st.sampled_from([json.loads(whole), FOREIGN[name]()]))
        path.write_text(json.dumps(data.draw(with_odd_values(seed))))
    try:
        FORMATS[name].read(path, replace(reading, classes={"fish": "other", "rock": "reef"}))
    except ToktError as error:
        assert "\n" not in str(error)
