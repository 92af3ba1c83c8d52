"""Label audits as files: labels that a model which did not learn them contradicts, ranked.

``audits/NAME.json`` in the workspace::

    {"format": 1, "name": "approach", "of": "dataset approach@0a1b...", "grid": {...},
     "rule": "how the patches were found, in words", "made": "2016-04-20T10:11:12.345Z",
     "patches": [{"mission": "approach", "camera": "left", "frame": 17, "row": 3, "col": 4,
                  "label": "ocean", "suggested": "subsea_installation", "margin": -1.25,
                  "reason": "in words"}]}

``made`` may be missing, as it is in older files. An audit proposes; it changes no label.
`tokt.training.fitting.label_audit` makes one, the labelling page shows it.
"""

import json
import math
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError, check_format
from tokt.features.frames.grid import Grid

from .label_csv import AUDIT_COLUMNS, COLUMNS
from .text_file import save_table, save_text

FOLDER = "audits"

FORMAT = 1
"""To change the format: raise this, keep reading the older ones, and prove it with a test."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,99}")


@dataclass(frozen=True)
class AuditedPatch:
    """One label that is doubted."""

    mission: str
    camera: str
    frame: int
    row: int
    col: int
    label: str  # what people labelled it; empty where nobody did
    suggested: str  # the class that it is taken for
    margin: float  # below 0: by how much, in decision values, the label's class loses
    reason: str  # for people
    group: int = 0  # patches of one group are decided at once; 0 stands alone


@dataclass(frozen=True)
class Audit:
    """A ranked list of doubted labels; ToktError if its name cannot be a file's."""

    name: str  # of its file
    of: str  # the dataset or model that was audited
    grid: Grid  # which rows and columns count in
    rule: str  # how the patches were found and ranked, in words
    patches: tuple[AuditedPatch, ...]  # the worst first
    made: str = ""  # when, as `record.utc_text` writes it; empty where the file does not say

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ToktError(f"audit name {self.name!r}: use letters, digits, '-', '_', '.', '@'")


def write_audit(workspace: Path, audit: Audit) -> Path:
    """Keep an audit in the workspace, in place of an earlier one of its name."""
    file = workspace / FOLDER / f"{audit.name}.json"
    value = {"format": FORMAT, **asdict(audit), "grid": audit.grid.to_json()}
    save_text(file, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return file


def read_audit(file: Path) -> Audit:
    """Read what `write_audit` wrote; ToktError if the file is damaged or of a newer format."""
    try:
        value = json.loads(file.read_bytes())
        check_format(value["format"], FORMAT, f"audit {file}")
        patches = tuple(_patch(item) for item in value["patches"])
        texts = (value["name"], value["of"], value["rule"], value.get("made", ""))
        if not all(isinstance(text, str) for text in texts):
            raise ValueError(texts)
        if texts[3] and datetime.fromisoformat(texts[3]).tzinfo is None:
            raise ValueError(texts[3])
        grid = Grid.from_json(value["grid"])
        return Audit(texts[0], texts[1], grid, texts[2], patches, texts[3])
    except OSError as error:
        raise ToktError(f"audit {file}: {error.strerror or error}") from None
    except (ValueError, TypeError, KeyError, RecursionError):
        raise ToktError(f"audit {file} is damaged; audit again") from None


def _patch(item: Any) -> AuditedPatch:
    item = {"group": 0, **item}  # older files have none
    for field in fields(AuditedPatch):
        if type(item[field.name]) is not field.type:
            raise ValueError(field.name)
    patch = AuditedPatch(**item)
    if min(patch.frame, patch.row, patch.col) < 0 or not math.isfinite(patch.margin):
        raise ValueError(patch)
    return patch


def audit_files(workspace: Path) -> list[Path]:
    """The audits kept in a workspace, by name."""
    return sorted((workspace / FOLDER).glob("*.json"))


def write_audit_csv(file: Path, audit: Audit) -> None:
    """Write doubted labels as a label file with the grid and `AUDIT_COLUMNS` more, worst first.

    `read_label_csv` reads it: labels corrected in it, in a spreadsheet, can be imported.
    """
    names = (*COLUMNS, "grid", *AUDIT_COLUMNS)
    rows: list[Iterable[object]] = [names]
    for patch in audit.patches:
        row = {**asdict(patch), "grid": str(audit.grid), "margin": f"{patch.margin:.4f}"}
        rows.append([row[name] for name in names])
    save_table(file, rows)
