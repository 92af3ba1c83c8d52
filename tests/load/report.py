"""How the measurements print and write what they found."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError

LEFT: dict[str, Any] = {"no_wrap": True}
RIGHT: dict[str, Any] = {"no_wrap": True, "justify": "right"}
FOLD: dict[str, Any] = {"overflow": "fold"}
"""Kinds of columns."""
_PLAIN_WIDTH = 170


def check_folder(out: Path) -> None:
    """Raise ToktError if results cannot be written there: before all the work."""
    if out.exists() and not out.is_dir():
        raise ToktError(f"{out} is not a folder; choose another with --out")


def write_json(path: Path, found: Mapping[str, Any]) -> None:
    """Write what was found as one JSON object."""
    text = json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False)
    atomic.write_text(path, text + "\n")


def table(columns: Mapping[str, dict[str, Any]], rows: Iterable[Sequence[str]]) -> Table:
    """A table of rows under these headings."""
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading, kind in columns.items():
        made.add_column(heading, **kind)
    for row in rows:
        made.add_row(*row)
    return made


def machine_words(about: Mapping[str, Any]) -> str:
    """The computer that was measured on."""
    computer = about["machine"]
    return f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}"


def yes_or_no(holds: bool | None) -> str:
    """Whether what was asked is kept, in a word."""
    return {True: "yes", False: "NO", None: ""}[holds]


def print_report(parts: Iterable[Table | str]) -> None:
    """Print tables and lines on standard output, as wide as the terminal or as plain text."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    for part in parts:
        console.print(part, markup=False)
