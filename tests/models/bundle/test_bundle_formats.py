"""Bundles of older formats: one laid out by hand, and files that tokt wrote; they load for ever.

Nothing here may be changed together with models/bundle/bundle.py: it stands for files on ships.
"""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from skimage.feature import local_binary_pattern

from tokt.models.bundle.bundle import bundle_bytes, bundle_from_bytes
from tokt.models.operating_point import MofNRule, OperatingPoint

MANIFEST = """
{
  "classes": [{"name": "ocean", "obstacle": false}, {"name": "other", "obstacle": true}],
  "extractor": {
    "border": "patch", "image": {"gray": "bt601", "resize": "area"},
    "name": "lbp", "points": 8, "radius": 1, "version": 1
  },
  "format_version": 1,
  "grid": {"cols": 2, "rows": 1, "width": 24},
  "metrics": {"patch": {"f1": 0.75}},
  "name": "old",
  "provenance": {"dataset": "drawn@0123456789ab", "mlflow_run_id": "f00d"},
  "version": "1"
}
"""
RULE_OF_2 = MofNRule(0.25, 2, 1, 3)
WEIGHTS = [[-3.0, 2.0, 0.5, 1.0, -1.0, 4.0, 0.25, -2.0, 1.5, -0.5]]


def _npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _frame() -> Any:
    y, x = np.mgrid[0:14, 0:24]
    return ((x * x + 3 * y * x + 7 * y) % 97).astype(np.uint8)


def _values() -> Any:
    rows = []
    for patch in (_frame()[:, :12], _frame()[:, 12:]):
        codes = local_binary_pattern(patch, 8, 1, method="uniform")
        rows.append([np.count_nonzero(codes == code) / codes.size for code in range(10)])
    return np.array(rows) @ np.array(WEIGHTS).T + 0.125


@pytest.mark.parametrize("stamp", [(1980, 1, 1, 0, 0, 0), (2016, 4, 20, 12, 30, 0)])
def test_format_1_loads(stamp):
    values = _values()
    threshold = float(values.mean())
    png = cv2.imencode(".png", _frame())[1].tobytes()
    members = {
        "weights.npz": _npz(
            weights=np.array(WEIGHTS), bias=np.array([0.125]), thresholds=np.array([threshold])
        ),
        "golden.npz": _npz(
            frames=np.frombuffer(png, np.uint8),
            sizes=np.array([len(png)], np.int64),
            decision_values=values[None],
            obstacle=(values[:, 0] > threshold)[None],
        ),
        "lineage.npz": _npz(trained_on=np.array([1, 2**64 - 1], np.uint64)),
        "card.md": b"# old/1\n",
    }
    manifest = json.loads(MANIFEST)
    manifest["members"] = {name: hashlib.sha256(data).hexdigest() for name, data in members.items()}
    bare = json.dumps(manifest, sort_keys=True, separators=(",", ":"))
    manifest["manifest_sha256"] = hashlib.sha256(bare.encode()).hexdigest()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {"manifest.json": json.dumps(manifest).encode(), **members}.items():
            archive.writestr(zipfile.ZipInfo(name, stamp), data)

    bundle = bundle_from_bytes(buffer.getvalue(), "old.tokt")

    assert bundle.label == "old/1"
    assert bundle.sha256 == hashlib.sha256(buffer.getvalue()).hexdigest()
    assert bundle.model.classes == ("ocean", "other")
    assert bundle.model.obstacle == (False, True)
    assert bundle.content.provenance["dataset"] == "drawn@0123456789ab"
    assert bundle.content.trained_on.tolist() == [1, 2**64 - 1]
    np.testing.assert_allclose(bundle.decision_values(_frame()), values, rtol=0, atol=1e-12)
    assert bundle.model.obstacle_patches(values).sum() == 1
    assert bundle.operating_point == OperatingPoint(MofNRule(0.0, 1, 1, 1), {})


@pytest.mark.parametrize(
    ("version", "label", "sha256", "point"),
    [
        (1, "yesterday/3", "a9d11a95918e", OperatingPoint()),
        (2, "lastweek/4", "15f15496898d", OperatingPoint(RULE_OF_2, {"target_rate": 1e-4})),
        (3, "yesterday/5", "dc80d33fbcf3", None),
        (4, "lastweek/6", "cd80ee1e8bf9", None),
        (5, "yesterday/7", "7416143671ac", None),
        (6, "yesterday/8", "27ad07b693a2", None),
    ],
)
def test_a_file_of_an_older_format_is_the_same_model_in_this_one(version, label, sha256, point):
    """Written by the commit before the next format, with three classes each."""
    data = (Path(__file__).parent / f"bundle_of_format_{version}.zip").read_bytes()

    old = bundle_from_bytes(data, "old.tokt")
    new = bundle_from_bytes(bundle_bytes(old.content), "new.tokt")

    assert (old.label, old.sha256[:12]) == (label, sha256)
    assert old.sha256 != new.sha256
    assert old.operating_point == new.operating_point
    assert point is None or old.operating_point == point
    # No map before format 4, no distribution before format 3, no numbers of sight before 5.
    assert old.signature is None
    gammas = [one.model.map and one.model.map.gamma for one in (old, new)]
    assert gammas[0] == gammas[1] and bool(gammas[0]) == (version >= 4)
    kept = [one.distribution and one.distribution.summary() for one in (old, new)]
    assert kept[0] == kept[1] and bool(kept[0]) == (version >= 3)
    assert old.sight == new.sight and bool(old.sight) == (version >= 5)
    assert ("sight was not measured" in old.blindness) == (version < 5)
    # No sizes before format 6: those of the golden frames; and no rounds of a boundary: 6.
    # No prior of gray frames before format 7.
    assert old.frame_sizes == new.frame_sizes == ((32, 48),)
    water = old.operating_point.water
    assert (water and water.rounds) == {5: 6, 6: 30}.get(version)
    assert water is None or water.gray is None
    assert old.model.classes == new.model.classes == ("ocean", "sand", "other")
    assert old.model.obstacle == new.model.obstacle
    np.testing.assert_array_equal(old.model.weights, new.model.weights)
    np.testing.assert_array_equal(old.content.trained_on, new.content.trained_on)
    golden, again = old.content.golden.decision_values, new.content.golden.decision_values
    np.testing.assert_array_equal(golden, again)
