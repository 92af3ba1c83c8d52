"""Findings as files: GeoJSON (RFC 7946) for maps and the labelling page, CSV for a spreadsheet."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from tokt.features.common.atomic import write_text
from tokt.features.common.errors import os_errors_as
from tokt.features.common.spreadsheet import guarded

from .findings import InspectionFinding

FORMAT = 1
"""Of the GeoJSON file. To change it: raise this, keep reading the older ones in
`tokt.labels.formats.findings`, and prove it with a test."""
GEOJSON, CSV, HTML = ENDINGS = (".geojson", ".csv", ".html")


def write_findings(path: Path, findings: Sequence[InspectionFinding]) -> None:
    """Write them all as a ``.geojson`` or ``.csv`` file; ToktError if it cannot be written."""
    text = _table(findings) if path.suffix.lower() == CSV else _collection(findings)
    with os_errors_as(f"cannot write {path}"):
        write_text(path, text)


def _collection(findings: Sequence[InspectionFinding]) -> str:
    features = [each.to_json() for each in findings]
    value = {"type": "FeatureCollection", "tokt_findings": FORMAT, "features": features}
    return json.dumps(value, indent=1, allow_nan=False) + "\n"


def _table(findings: Sequence[InspectionFinding]) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    names = [each.name for each in fields(InspectionFinding)]
    rows.writerow(["finding", *names])
    for number, found in enumerate(findings, 1):
        values = {name: getattr(found, name) for name in names}
        values["patches"] = " ".join(map(str, found.patches))
        cells = (guarded(value) if isinstance(value, str) else value for value in values.values())
        rows.writerow([number, *cells])
    return text.getvalue()
