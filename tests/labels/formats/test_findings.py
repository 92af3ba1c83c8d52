"""Findings become proposals of the labelling page, or one line says why not."""

import copy
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tiers import scaled
from tokt.features.common.errors import ToktError
from tokt.features.frames.grid import Grid
from tokt.inference.replay.findings_file import FORMAT
from tokt.labels.formats.audit_csv import read_audit, write_audit
from tokt.labels.formats.findings import NEWEST, findings_audit

GRID = Grid()
FIRST = {
    "type": "FeatureCollection",
    "tokt_findings": 1,
    "features": [
        {
            "type": "Feature",
            "geometry": None,
            "properties": {
                "label": "net", "first_frame": 4, "last_frame": 10, "best_frame": 7, "frames": 7,
                "confidence": 0.88, "distance_m": None, "along_m": 5.01, "lat_deg": None,
                "lon_deg": None, "depth_m": None, "t": 1.5, "log": "run.jsonl", "run": "run-x",
                "mission": "dive", "grid": "10x10@360", "patches": [44, 55],
            },
        }
    ],
}  # fmt: skip
"""A file of the first format, as it was written then."""


@pytest.fixture
def written(tmp_path):
    """Write a changed file."""

    def write(change=lambda value: None):
        value, path = copy.deepcopy(FIRST), tmp_path / "out.geojson"
        change(value)
        path.write_text(json.dumps(value), "utf-8")
        return path

    return write


def test_the_first_format_is_read(written, tmp_path):
    assert NEWEST == FORMAT  # the reader knows what is written
    audit = findings_audit(written(), "dive", GRID)
    assert (audit.name, audit.grid) == ("out", GRID)
    assert [(it.frame, it.row, it.col, it.group) for it in audit.patches] == [
        (7, 4, 4, 1), (7, 5, 5, 1)
    ]  # fmt: skip
    one = audit.patches[0]
    assert (one.mission, one.camera, one.label, one.suggested) == ("dive", "left", "", "net")
    assert one.reason == "finding 1: net, frames 4 to 10, 5.0 m along the track"
    assert read_audit(write_audit(tmp_path, audit)).patches == audit.patches


def test_an_audit_without_groups_is_read(written, tmp_path):
    path = write_audit(tmp_path, findings_audit(written(), "dive", GRID))
    value = json.loads(path.read_text("utf-8"))
    for patch in value["patches"]:
        del patch["group"]  # as every audit was before there were findings
    path.write_text(json.dumps(value), "utf-8")
    assert [it.group for it in read_audit(path).patches] == [0, 0]


@pytest.mark.parametrize(
    ("where", "wrong", "words"),
    [
        ("tokt_findings", 2, "newer than this tokt reads"),
        ("tokt_findings", None, "holds no findings of tokt"),
        ("mission", "other", "no finding is of dive, but of other"),
        ("mission", 7, "mission"),
        ("grid", "5x5@360", "label with --grid 5x5@360"),
        ("grid", "many", "not a grid"),
        ("patches", [100], "patch 100 is not in the grid"),
        ("patches", ["a"], "is not a whole number"),
        ("best_frame", None, "best_frame"),
    ],
)
def test_what_is_wrong_is_said(written, where, wrong, words):
    def change(value):
        target = value if where in value else value["features"][0]["properties"]
        target[where] = wrong

    with pytest.raises(ToktError, match=words):
        findings_audit(written(change), "dive", GRID)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 120) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


@settings(max_examples=scaled(50))
@given(st.sampled_from(sorted(FIRST["features"][0]["properties"])), JSON)
def test_whatever_stands_there_is_read_or_refused(tmp_path_factory, name, value):
    path = tmp_path_factory.getbasetemp() / "out.geojson"
    changed = copy.deepcopy(FIRST)
    changed["features"][0]["properties"][name] = value
    path.write_text(json.dumps(changed), "utf-8")
    try:
        audit = findings_audit(path, "dive", GRID)
    except ToktError as error:
        assert "\n" not in str(error)
    else:
        assert all(GRID.contains(it.row, it.col) and it.frame >= 0 for it in audit.patches)
