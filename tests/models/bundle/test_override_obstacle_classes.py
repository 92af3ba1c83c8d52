"""Obstacle flags set when a model is shipped: new bytes, a void operating point, and told so."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.calls import refuses
from tokt.features.frames.image_file import decode_image
from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.bundle.override_obstacle_classes import override_obstacle_classes
from tokt.models.operating_point import MofNRule
from tokt.models.store.store import Store

THREE = (("ocean", False), ("sand", False), ("tower", True))
METRICS = {
    "split": "five folds",
    "patch": {"f1": 0.9, "precision": 0.9, "recall": 0.9, "average_precision": 0.9}
    | {"macro_f1": 0.8, "per_class": {"sand": {"f1": 0.7, "n": 5}}},
    "folds": [{"f1": 0.9}],
    "frames": {"ocean_frames": 9, "false_status": 1},
    "frames_at_zero": {"ocean_frames": 9, "false_status": 2},
    "stress": {"gain_0.5": {}},
}


def write_taxonomy(path: Path, **flags: bool) -> Path:
    lines = ["format = 1"]
    for index, (name, flag) in enumerate(flags.items()):
        lines += ["[[classes]]", f'name = "{name}"', f"obstacle = {str(flag).lower()}"]
        lines += [f'color = "#11223{index}"', f'key = "{index}"']
    path.write_text("\n".join(lines))
    return path


@pytest.fixture(scope="module")
def three(make_content):
    content = replace(make_content(4, classes=THREE), metrics=METRICS)
    return bundle_from_bytes(bundle_bytes(content), "three")


def test_deployed_with_another_taxonomy(three, tmp_path, run_tokt):
    file, store = tmp_path / "three.tokt", tmp_path / "store"
    file.write_bytes(three.data)
    flags = write_taxonomy(tmp_path / "dive.toml", ocean=False, sand=True, tower=True, kelp=True)

    ran = run_tokt("deploy", file, store, "--taxonomy", flags, "--json")

    assert ran.code == 0, ran.err
    assert "sand is an obstacle" in ran.err and "void" in ran.err
    found = Store(store).active()
    assert found.sha256 == json.loads(ran.out)["sha256"] != three.sha256
    assert found.label == three.label
    assert found.model.obstacle == (False, True, True)
    np.testing.assert_array_equal(found.model.weights, three.model.weights)
    image = decode_image(three.content.golden.frames[0], "golden")
    values = three.decision_values(image)
    expected = np.isin(three.model.predicted(values), [1, 2])
    told = found.model.obstacle_patches(found.decision_values(image))
    np.testing.assert_array_equal(told, expected)
    assert expected.sum() > three.model.obstacle_patches(values).sum()
    # What was measured and chosen for the old flags is gone, and the bundle says so.
    assert found.operating_point.rule == MofNRule() != three.operating_point.rule
    assert set(found.operating_point.chosen) == {"void"}
    assert found.content.metrics["patch"]["f1"] is None
    assert found.content.metrics["patch"]["macro_f1"] == 0.8
    assert set(found.content.metrics) == {"split", "patch", "folds", "voided"}
    told = found.content.provenance["obstacle_flags"]
    assert told["taxonomy"] == "dive.toml" and told["changed"] == {"sand": True}
    assert told["sha256"] == hashlib.sha256(flags.read_bytes()).hexdigest()
    assert told["was"] == three.sha256
    assert "sand (obstacle)" in found.content.card and "do not hold" in found.content.card
    assert "dive.toml" in found.content.card
    assert "dive.toml" in run_tokt("store", store).out


def test_flags_that_cannot_be_are_one_line(three, make_content, tmp_path, run_tokt):
    two = bundle_from_bytes(bundle_bytes(make_content(5)), "two")
    never = dict.fromkeys(("ocean", "sand", "tower"), False)
    for bundle, flags, words in (
        (two, {"ocean": True, "other": False}, "training fixed which side"),
        (three, {"ocean": True}, "taxonomy t.toml has no class sand, tower"),
        (three, never, "never warn"),
    ):
        refuses(words, override_obstacle_classes, bundle, flags, "t.toml", "0")
    file = tmp_path / "three.tokt"
    file.write_bytes(three.data)
    missing = tmp_path / "none.toml"
    ran = run_tokt("deploy", file, tmp_path / "store", "--taxonomy", missing)
    assert ran.code == 2 and len(ran.err.splitlines()) == 1 and "none.toml" in ran.err
    assert not (tmp_path / "store").exists()
