"""Dives with a mask: what is no view is neither learnt from, nor scored, nor judged."""

import json
import shutil

import cv2
import numpy as np
import pandas as pd
import pytest

from tests.fixtures import BUILD_TINY, TRAIN_TINY, TinyMission
from tokt.features.frames.mission import open_mission
from tokt.features.frames.view_mask import CameraMasks, parse_masks, write_masks
from tokt.models.bundle.bundle import read_bundle
from tokt.training.datasets.dataset import open_dataset

CORNER = parse_masks(["left:0.8,0,0.2,0.1"])  # two patches: water in each of the frames


@pytest.fixture
def marked(own_tiny):
    """The tiny mission with a clock in each frame."""
    for file in (own_tiny.path / "Left").iterdir():
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        words = f"12:{file.stem.rpartition('_')[2]}"
        cv2.putText(picture, words, (292, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.7, 255, 2)
        cv2.imwrite(str(file), picture)
    return own_tiny


@pytest.fixture
def build(begun, tmp_path, done):
    workspace = begun(tmp_path / ".tokt")

    def make(dive):
        given = ("--mission", dive.path, "--labels", dive.labels)
        ran = done("dataset", "build", "tiny", *given, *BUILD_TINY, "--workspace", workspace)
        return open_dataset("tiny", workspace / "datasets"), ran.err

    return make


def test_a_dataset_leaves_out_what_is_masked_and_has_another_name(marked, build):
    whole, said = build(marked)
    assert not whole.masks and "masks" not in whole.info and "masked" not in said
    write_masks(marked.path, CORNER)
    dataset, said = build(marked)
    assert "80 labels of mission 'tiny' in masked patches left out" in said
    assert len(whole.patches) - len(dataset.patches) == 80
    assert not ((dataset.patches.row == 0) & (dataset.patches.col >= 8)).any()
    assert dataset.hash != whole.hash and dataset.masks == {"tiny": CORNER}
    dataset.check()
    # Frames are stored as the camera gave them, and read with the clock covered.
    pd.testing.assert_frame_equal(dataset.frames[["digest"]], whole.frames[["digest"]])
    own, covered = whole.read_frame(0), dataset.read_frame(0)
    hidden = CORNER.left.pixels(*own.shape[:2])
    assert own[hidden].max() == 255 and covered[hidden].max() < 60
    np.testing.assert_array_equal(own[~hidden], covered[~hidden])
    assert dataset.patches_in_view(0) == 98
    # Without the mask it is the one of before.
    write_masks(marked.path, CameraMasks())
    assert build(marked)[0].hash == whole.hash


def test_the_first_frame_need_not_be_readable(own_tiny, build):
    write_masks(own_tiny.path, CORNER)
    (own_tiny.path / "Left" / "tiny_L_0.png").write_bytes(b"no picture")
    dataset, said = build(own_tiny)
    assert "80 labels" in said and dataset.patches_in_view(0) == 98


def test_labels_of_water_where_nothing_is_seen_are_told(own_tiny, build):
    for file in (own_tiny.path / "Left").iterdir():
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        picture[:27, 288:] = 0  # a part of the vehicle
        cv2.imwrite(str(file), picture)
    dataset, said = build(own_tiny)
    assert "80 patches labelled clear show nothing (80 dark)" in said
    assert dataset.info["unseen_clear"] == {"dark": 80}
    write_masks(own_tiny.path, CORNER)
    dataset, said = build(own_tiny)
    assert "show nothing" not in said and dataset.info["unseen_clear"] == {}


def test_a_dataset_whose_mask_was_changed_on_disk_is_refused(marked, build, refused):
    write_masks(marked.path, CORNER)
    dataset, _ = build(marked)
    file = dataset.path / "dataset.json"
    file.write_text(file.read_text().replace("0.8,", "0.7,").replace("0.8\n", "0.7\n"))
    where = ("--workspace", dataset.path.parents[2])
    refused("changed on disk", "train", "tiny", "--extractor", "lbp", *TRAIN_TINY, *where)


def test_a_model_of_masked_frames_keeps_the_mask_and_judges_by_it(
    marked, tiny, build, told, done, tmp_path
):
    free = TinyMission(tmp_path / "free" / "tiny", tiny.labels)
    shutil.copytree(tiny.path, free.path)
    bundles = []
    for dive in (free, marked):
        write_masks(dive.path, CORNER)
        dataset, _ = build(dive)
        where = ("--workspace", dataset.path.parents[2])
        preset = ("--extractor", "lbp", "--preset", "plain", "--name", "masked")
        done("train", "tiny", *preset, *TRAIN_TINY, *where)
        done("export", "masked", "-o", tmp_path / "m.tokt", *where)
        bundles.append(read_bundle(tmp_path / "m.tokt"))
    without, bundle = bundles
    # What the clock hides makes no difference.
    np.testing.assert_array_equal(bundle.model.weights, without.model.weights)
    frames = bundle.content.metrics["frames"]
    assert frames == without.content.metrics["frames"] and bundle.masks == (CORNER,)
    assert frames["ocean_frames"] > 0, "frames whose patches in view are labelled are whole"
    evaluated = ("--mission", marked.path, "--labels", marked.labels, *where)
    found = told("evaluate", "masked", *evaluated)
    assert found["frames"]["ocean_frames"] > 0
    # In a run the mask is the dive's, or the model's where one says so.
    run = ("run", "--bundle", tmp_path / "m.tokt", "--policy", "texture", "--accept-blind")
    beside = done(*run, "--source", marked.path, "--json")
    write_masks(marked.path, CameraMasks())
    unmasked = done(*run, "--source", marked.path, "--json")
    assert "--mask model" in unmasked.err and "WARNING" in unmasked.err
    learnt = done(*run, "--source", marked.path, "--mask", "model", "--json")
    assert "WARNING" not in beside.err + learnt.err
    counts = [json.loads(ran.out) for ran in (beside, learnt)]
    assert all(counts[0][name] == counts[1][name] for name in ("obstacle", "clear", "unknown"))
    assert not open_mission(marked.path).masks


def test_patches_that_alarm_in_nearly_all_open_water_are_named(own_tiny, trained, told, done):
    rng = np.random.default_rng(5)
    for file in (own_tiny.path / "Left").iterdir():
        picture = cv2.imread(str(file), cv2.IMREAD_UNCHANGED).astype(float)
        picture[:27, 288:] += rng.normal(0, 30, (9, 24)).repeat(3, 0).repeat(3, 1)
        cv2.imwrite(str(file), picture.clip(0, 255).astype(np.uint8))
    where = ("--mission", own_tiny.path, "--labels", own_tiny.labels, "--workspace", trained)
    found = told("evaluate", "tiny-lbp", *where)
    assert found["always_alarming"] == {"tiny": [[0.8, 0.0, 0.2, 0.1]]}
    said = done("evaluate", "tiny-lbp", *where).err
    assert "--mask left:0.8,0,0.2,0.1" in said
    write_masks(own_tiny.path, CORNER)
    assert told("evaluate", "tiny-lbp", *where)["always_alarming"] == {"tiny": []}


def test_models_are_compared_by_what_is_view(marked, build, told, done):
    write_masks(marked.path, CORNER)
    dataset, _ = build(marked)
    where = ("--workspace", dataset.path.parents[2])
    for name, extractor in (("one", "lbp"), ("two", "haralick")):
        preset = ("--extractor", extractor, "--preset", "plain", "--name", name)
        done("train", "tiny", *preset, *TRAIN_TINY, *where)
    found = told("compare", "one", "two", *where)
    text = json.dumps(found)
    assert "NaN" not in text and "Infinity" not in text
