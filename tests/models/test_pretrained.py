"""The model that comes with tokt: whole, within its bounds, without a picture of anybody's."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.calls import refused, refuses, succeeds
from tokt.features.frames.image_file import decode_image
from tokt.models.pretrained.packaged import packaged_bundle
from tokt.models.registry.load import is_registered_name, load_model
from tokt.models.registry.registry import check_model_name
from tokt.training.fitting.adapt import packaged_model
from tokt.training.fitting.carried import install_carried
from tokt.training.fitting.train import rendered_other_image

ROOT = Path(__file__).parents[2]
NOT_OURS_TO_GIVE = {"approach", "photos", "thruster", "pipe", "reef"}


@pytest.fixture(scope="module")
def waters():
    return load_model("waters")


@pytest.fixture(scope="module")
def maker():
    spec = importlib.util.spec_from_file_location("maker", ROOT / "packaging" / "make_waters.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A rough wall that fills the view, as a folder of frames in colour."""
    folder = tmp_path_factory.mktemp("dive")
    (folder / "Left").mkdir()
    for number in range(1, 7):
        wall = cv2.resize(rendered_other_image(number), (640, 480), interpolation=cv2.INTER_AREA)
        colours = (wall[..., None] * np.array([0.9, 1.0, 0.8])).astype(np.uint8)
        cv2.imwrite(str(folder / "Left" / f"dive_L_{number}.png"), colours)
    return folder


def test_it_is_whole_and_may_guard(waters):
    assert waters.label == "waters/1" and not is_registered_name("waters")
    assert load_model("waters/1").sha256 == waters.sha256
    assert is_registered_name("waters/2") and is_registered_name("waters.basin")
    assert not waters.deployment_fault and not waters.blindness and not waters.silence
    smooth = replace(waters.sight[0], height=90, width=120, blurred=0.0)
    sizes = ((90, 120), *waters.frame_sizes)
    partly = replace(waters, sight=(*waters.sight, smooth), frame_sizes=sizes)
    assert not partly.blindness and "in frames of 120x90, 1280x720, " in partly.partly_blind
    assert waters.masks == () and not waters.needs_colour and waters.operating_point.water
    assert len(waters.sight) > 5 and len(waters.frame_sizes) > 5


def test_it_is_as_small_and_says_what_was_promised(waters, maker):
    assert len(waters.data) <= maker.MAX_BYTES == 1_500_000
    for words in ("Roboflow", "CC-BY-4.0", "Apache-2.0", "BSD-3-Clause", "MIT", "not known"):
        assert words in waters.card, words
    assert set(waters.metrics["dives"]) == set(map(maker.dive_name, maker.GROUPS))
    assert not NOT_OURS_TO_GIVE & set(maker.GROUPS)
    assert "whole sites" in waters.metrics["split"]


def test_it_holds_no_picture(waters, maker, tmp_path):
    """Its golden frames are rendered anew here, to the pixel; its dataset has rows alone."""
    golden = [decode_image(png, "golden") for png in waters.golden.frames]
    for found, rendered in zip(golden, maker.golden_frames(), strict=True):
        assert np.array_equal(found, rendered)
    dataset = install_carried(waters, tmp_path).dataset
    sites = {maker.dive_name(one): maker.dive_name(site) for one, site in maker.GROUPS.items()}
    assert not dataset.pictured.any() and set(dataset.frames.mission) == set(sites)
    most = dataset.frames.groupby("mission").size().max()
    assert most <= maker.FRAMES_A_DIVE and dataset.sites == sites
    assert {path.suffix for path in (dataset.path / "frames").iterdir()} == {".rows"}
    known = packaged_model(waters, tmp_path)
    folds = known.split.cut(dataset.patches, dataset.targets())
    assert len(folds) == len(known.fold_choices) == len(set(maker.GROUPS.values()))


def test_a_run_begins_with_it(dive):
    out = succeeds("run", "--model", "waters", "--source", dive, "--policy", "texture").err
    assert "model waters/1: status 1" in out and "6 obstacle, 0 clear, 0 unknown" in out


def test_its_name_is_taken(dive):
    refuses("is that of a model that comes with tokt", check_model_name, "waters")
    refuses("100 at most", check_model_name, "x" * 101)
    refuses("no model 'water' comes with tokt", packaged_bundle, "water")
    refused("no model 'pond' comes with tokt", "run", "--model", "pond", "--source", dive)


def test_adapt_asks_for_labels_first(dive, tmp_path):
    refused(
        "label six of its frames: tokt label",
        *("adapt", "waters", "--mission", dive, "--workspace", tmp_path / ".tokt"),
    )


def test_what_it_held_out_no_registry_knows(trained):
    command = "compare", "waters", "tiny-lbp", "--workspace", trained
    assert "give --mission DIR" in refused("waters is not of this workspace's registry", *command)
