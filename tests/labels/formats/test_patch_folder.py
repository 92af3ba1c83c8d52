from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings

from tests.calls import refuses
from tests.tiers import scaled
from tokt.features.extractors.extractor import Lbp
from tokt.features.frames.grid import Grid
from tokt.features.frames.mission import open_mission
from tokt.labels.formats.images import MissionImages
from tokt.labels.formats.options import WriteOptions
from tokt.labels.formats.patch_folder import MANIFEST, read_patch_folder, write_patch_folder
from tokt.training.datasets.mission_source import plan_from_patch_folder

from .examples import SLOW, TAXONOMY, said, some_records

QUICK = settings(SLOW, max_examples=scaled(12))
CELLS = [said("sand", 1, 2), said("reef", 9, 9), said("unsure", camera="right", frame=20)]


@pytest.fixture
def folder(tmp_path, writing):
    written = write_patch_folder(tmp_path / "patches", CELLS, writing)
    assert (written.labels, written.lost) == (3, [])
    return tmp_path / "patches"


@QUICK
@given(some_records(grids=(Grid(3, 4, 120),)))
def test_a_folder_comes_back_whole(tmp_path_factory, reading, writing, some):
    path = tmp_path_factory.mktemp("out") / "patches"
    one_a_patch = list({record.cell: record for record in some}.values())
    assert write_patch_folder(path, one_a_patch, writing).lost == []
    read = read_patch_folder(path, replace(reading, images=None))
    assert set(read.records) == set(one_a_patch) and read.lost == []


def test_training_reads_the_features_of_the_frames(folder, images):
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*.png"))
    assert names == [
        "reef/dive_left_000003_r09_c09.png",
        "sand/dive_left_000003_r01_c02.png",
        "unsure/dive_right_000020_r00_c00.png",
    ]
    patch = cv2.imread(str(folder / names[1]), cv2.IMREAD_ANYCOLOR)
    assert patch.shape == (27, 36, 3)
    lbp = Lbp(10, 5, "patch")
    of_frame = lbp.describe(images.mission.read(3), Grid())[1 * 10 + 2]
    assert np.array_equal(lbp.describe(patch, Grid(1, 1, None))[0], of_frame)
    plan = plan_from_patch_folder("p", "classes", folder, TAXONOMY)
    assert sorted(plan.patches.label) == ["reef", "sand"] and plan.unsure == 1


def test_a_patch_moved_to_another_class_is_relabelled(folder, reading):
    name = "dive_left_000003_r01_c02.png"
    (folder / "ocean").mkdir()
    (folder / "sand" / name).rename(folder / "ocean" / name)
    read = read_patch_folder(folder, reading)
    moved = next(record for record in read.records if record.row == 1)
    assert (moved.label, moved.annotator, moved.source) == ("ocean", "ann", "human")
    assert moved.time > CELLS[0].time
    assert [r for r in read.records if r.row != 1] == [
        r for r in sorted(CELLS, key=lambda r: r.label or "") if r.row != 1
    ]
    assert read.lost == ["1 patch moved to another class: labels by hand"]
    by_bob = read_patch_folder(folder, replace(reading, annotator="bob")).records
    assert sorted(record.annotator for record in by_bob) == ["ann", "ann", "bob"]


def test_a_suggestion_that_was_moved_is_a_label_by_hand(tmp_path, reading, writing):
    record = said(source="model", annotator="net", model_version="net/3")
    write_patch_folder(tmp_path / "sorted", [record], writing)
    assert read_patch_folder(tmp_path / "sorted", reading).records == [record]
    (tmp_path / "sorted" / "reef").rename(tmp_path / "sorted" / "sand")
    (moved,) = read_patch_folder(tmp_path / "sorted", reading).records
    assert (moved.source, moved.annotator, moved.model_version) == ("human", "sorted", None)


def test_other_images_and_gone_ones_are_counted(folder, reading):
    (folder / "reef" / "dive_left_000003_r09_c09.png").unlink()
    (folder / "sand" / "from_elsewhere.png").write_bytes(b"")
    (folder / "sand" / "Thumbs.db").write_bytes(b"")
    (folder / "some_thing_else").mkdir()
    read = read_patch_folder(folder, reading)
    assert len(read.records) == 2
    assert read.lost == [
        f"1 image left out: not in {MANIFEST}, so of no frame",
        "1 patch gone from the folder: what was said of them stays",
    ]


def test_unknown_folders_and_patches_in_two(folder, reading):
    (folder / "sand").rename(folder / "fish")
    refuses(r"unknown class 'fish' \(1\).* --map THEIRS=OURS", read_patch_folder, folder, reading)
    read = read_patch_folder(folder, replace(reading, classes={"fish": "other"}))
    assert sorted(record.label or "" for record in read.records) == ["other", "reef", "unsure"]
    read = read_patch_folder(folder, replace(reading, classes={"fish": ""}))
    assert sorted(record.label or "" for record in read.records) == ["reef", "unsure"]
    assert read.lost == ["1 patch left out by --map: class 'fish'"]
    (folder / "sand").mkdir()
    (folder / "sand" / "dive_left_000003_r01_c02.png").write_bytes(b"")
    refuses(r"c02\.png is in fish and in sand", read_patch_folder, folder, reading)


def test_nothing_is_written_over_and_nothing_half(tmp_path, folder, writing):
    before = sorted(tmp_path.rglob("*"))
    refuses("is there already", write_patch_folder, folder, CELLS, writing)
    refuses("is there already", write_patch_folder, folder / MANIFEST, CELLS, writing)
    for wrong, message in (
        ([*CELLS, said("ocean", 9, 9, annotator="bob")], "by ann and by bob.*--annotator"),
        (
            [*CELLS, said(grid=Grid(2, 2, None))],
            "grids 10x10@360, 2x2@native: choose one by --grid",
        ),
        ([*CELLS, replace(said(), mission="wreck")], "missions dive, wreck"),
        ([said(frame=4)], "no patch could be written; 1 label left out: .* has no such frames"),
    ):
        refuses(message, write_patch_folder, tmp_path / "new", wrong, writing)
    blind = WriteOptions(TAXONOMY)
    refuses("--mission-dir DIR", write_patch_folder, tmp_path / "new", CELLS, blind)
    failed = "cannot write .*(File exists|Not a directory)"
    refuses(failed, write_patch_folder, folder / MANIFEST / "below", CELLS, writing)

    def stop(items, total, what):
        yield next(iter(items))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_patch_folder(tmp_path / "new", CELLS, replace(writing, progress=stop))
    assert sorted(tmp_path.rglob("*")) == before
    (tmp_path / "empty").mkdir()
    assert write_patch_folder(tmp_path / "empty", CELLS, writing).labels == 3


def test_a_settlement_is_written_and_its_opinions_are_not(tmp_path, reading, writing):
    opinions = [said("reef"), said("sand", annotator="bob")]
    settled = said("sand", annotator="eva", source="settled")
    written = write_patch_folder(tmp_path / "out", [*opinions, settled], writing)
    assert (written.labels, written.lost) == (1, ["2 opinions on patches that were settled"])
    assert read_patch_folder(tmp_path / "out", reading).records == [settled]


def test_unreadable_frames_are_counted(tmp_path, dive, writing):
    copy = tmp_path / "dive"
    copy.mkdir()
    (copy / "dive_3.png").write_bytes((dive / "Left" / "dive_L_3.png").read_bytes())
    (copy / "dive_7.png").write_bytes(b"\x89PNG\r\n\x1a\n cut")
    options = replace(writing, images=MissionImages(open_mission(copy)))
    written = write_patch_folder(tmp_path / "out", [said(), said(frame=7)], options)
    assert written.lost == ["1 label left out: their frames cannot be read"]


def test_folders_without_our_manifest(tmp_path, reading):
    (tmp_path / "reef").mkdir()
    words = f"no {MANIFEST}: .* belong to no frame .*--patches DIR"
    refuses(words, read_patch_folder, tmp_path, reading)
    for text, message in (
        ("", "not JSON"),
        ("[]", "the manifest is not an object"),
        ('{"format": 2}', "format 2; this tokt reads 1"),
        ('{"format": 1}', "patches is not an object"),
        ('{"format": 1, "patches": {"a.png": {"label": "reef"}}}', "'a.png' is of no frame"),
        ('{"format": 1, "patches": {"a.png": {"tokt_format": 1}}}', "no tokt_mission"),
    ):
        (tmp_path / MANIFEST).write_text(text)
        refuses(message, read_patch_folder, tmp_path, reading)
