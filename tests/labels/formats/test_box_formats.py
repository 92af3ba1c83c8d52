"""What the formats of boxes have in common: whole there and back, and damage is refused."""

import os
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tokt.features.frames.mission import open_mission
from tokt.labels.formats.formats import FORMATS
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import ReadOptions, WriteOptions
from tokt.labels.taxonomy import Taxonomy, UnknownClassError

from .examples import SLOW, TAXONOMY, said, some_records

FILES = {**dict.fromkeys(("coco", "labelstudio", "ifdo"), "boxes.json"), "cvat": "boxes.xml"}
FILES |= dict.fromkeys(("viame", "coralnet", "biigle"), "boxes.csv")
NO_SUGGESTIONS = ("coralnet", "biigle", "cvat", "ifdo")
all_formats = pytest.mark.parametrize("name", FILES)


@all_formats
@SLOW
@given(some_records(), st.booleans())
def test_own_files_come_back_whole(tmp_path, reading, writing, name, some, with_frames):
    path = tmp_path / FILES[name]
    if name == "viame":  # holds one camera
        some = [record for record in some if record.camera == some[0].camera]
    if name == "coralnet":  # holds one label a patch
        some = list({record.cell: record for record in some}.values())
    more = [said("sand", 2, 2, annotator="net", source="model", model_version="net/3")]
    more = [] if name not in NO_SUGGESTIONS else more
    some = [record for record in some if not more or record.source != "model"] or [said()]
    written = FORMATS[name].write(path, [*some, *more], writing)
    lost = [line for line in written.lost if "label codes" not in line and "header" not in line]
    assert (written.labels, len(lost)) == (len(some), len(more)), written.lost
    options = reading if with_frames else replace(reading, images=None)
    read = FORMATS[name].read(path, options)
    assert set(read.records) == set(some) and len(read.records) == len(some)
    assert read.lost == []
    sources = [record.source for record in read.records]
    assert sources == sorted(sources, key=lambda source: source == "settled")


@all_formats
def test_unknown_classes_are_told_by_name(tmp_path, reading, writing, name):
    path = tmp_path / FILES[name]
    FORMATS[name].write(path, [said("reef"), said("sand", 1, 1)], writing)
    known = Taxonomy(tuple(entry for entry in TAXONOMY.classes if entry.name != "reef"))
    with pytest.raises(UnknownClassError, match="unknown class 'reef'") as caught:
        FORMATS[name].read(path, replace(reading, taxonomy=known))
    assert caught.value.names == ["reef"] and str(path) in str(caught.value)


@all_formats
def test_odd_names_of_files(tmp_path, name):
    """Those that text can hold come back; the other ones' labels are left out and counted."""
    folder = tmp_path / os.fsdecode(b"dive\xff")
    folder.mkdir()
    picture = cv2.imencode(".png", np.full((137, 181), 90, np.uint8))[1].tobytes()
    odd = ['a,b "c"\'d;_1.png', "Åse > <b>&amp;_2.png", "=1+1_3.png", "b\xff_4.png", "x\x07_5.png"]
    for file in odd:
        # A name in Latin-1, as an older system wrote it, is not UTF-8.
        kind = "latin-1" if "\xff" in file else "utf-8"
        (folder / os.fsdecode(file.encode(kind))).write_bytes(picture)
    images = MissionImages(open_mission(folder))
    some = [said("reef", 1, 2, frame=frame) for frame in range(1, 6)]
    written = FORMATS[name].write(tmp_path / FILES[name], some, WriteOptions(TAXONOMY, images))
    assert "1 label left out: the name of their file is not UTF-8" in written.lost
    read = FORMATS[name].read(tmp_path / FILES[name], ReadOptions(TAXONOMY, images=images))
    frames = {record.frame for record in read.records}
    assert frames == ({1, 2, 3} if name == "cvat" else {1, 2, 3, 5})  # XML has no bell
