"""Audit files: what is written is read, yesterday's too, and nothing half right is taken."""

import json
from dataclasses import replace

import pytest

from tests.calls import refuses
from tokt.features.frames.grid import Grid
from tokt.labels.formats.audit_csv import Audit, AuditedPatch, audit_files, read_audit, write_audit

PATCH = AuditedPatch(
    "dive", "left", 17, 3, 4, "ocean", "subsea_installation", -1.25, "takes it for obstacle"
)
FORMAT_1 = """{"format": 1, "name": "dive", "of": "dataset dive@0a1b",
 "grid": {"rows": 10, "cols": 10, "width": 360}, "rule": "mean of two margins",
 "patches": [{"mission": "dive", "camera": "left", "frame": 17, "row": 3, "col": 4,
  "label": "ocean", "suggested": "subsea_installation", "margin": -1.25,
  "reason": "takes it for obstacle"}]}"""


def test_yesterdays_file_is_read(tmp_path):
    """Literal text of format 1: it must stay readable."""
    file = tmp_path / "dive.json"
    file.write_text(FORMAT_1, "utf-8")
    audit = Audit("dive", "dataset dive@0a1b", Grid(), "mean of two margins", (PATCH,))
    assert read_audit(file) == audit
    audit = replace(audit, made="2016-04-20T10:11:12.345Z")
    assert read_audit(write_audit(tmp_path / "ws", audit)) == audit
    assert [path.name for path in audit_files(tmp_path / "ws")] == ["dive.json"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *[("margin", "-1.25"), ("row", -1), ("frame", 1.5), ("label", None), ("margin", 1e999)],
        *[("format", 0), ("format", "1"), ("rule", 3), ("name", None)],
        *[("made", 3), ("made", "yesterday"), ("made", "2016-04-20T10:11:12")],
    ],
)
def test_a_damaged_file_is_refused(tmp_path, field, value):
    damaged = json.loads(FORMAT_1)
    (damaged["patches"][0] if field in damaged["patches"][0] else damaged)[field] = value
    file = tmp_path / "dive.json"
    file.write_text(json.dumps(damaged), "utf-8")
    refuses("is damaged; audit again", read_audit, file)


def test_newer_formats_and_names_that_leave_the_folder_are_refused(tmp_path):
    file = tmp_path / "dive.json"
    file.write_text(FORMAT_1.replace('"format": 1', '"format": 2'), "utf-8")
    refuses("newer than this tokt reads", read_audit, file)
    refuses("audit name", Audit, "../dive", "dataset dive", Grid(), "", ())
