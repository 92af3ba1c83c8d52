"""Times that were measured, and how all measurements print and write what they found."""

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from tokt.features.common import atomic

_PLAIN_WIDTH = 170
WORST = 100


def percentiles(values: Sequence[float], **asked: float) -> dict[str, float]:
    """Percentiles of some values, by the names that are given to them."""
    return dict(zip(asked, np.percentile(values, [*asked.values()]).tolist(), strict=True))


@dataclass(frozen=True)
class Timing:
    name: str
    what: str  # from when to when, in words
    times_ms: Sequence[float]
    asked_ms: float | None = None  # the longest that is allowed; None where nothing is asked
    percentile: int = 95  # which of the times `asked_ms` is for; `WORST` means all of them

    def at(self, percentile: int) -> float:
        return float(np.percentile(self.times_ms, percentile))

    @property
    def holds(self) -> bool | None:
        return None if self.asked_ms is None else self.at(self.percentile) <= self.asked_ms

    def to_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "what": self.what,
            "count": len(self.times_ms),
            **percentiles(self.times_ms, p50_ms=50, p95_ms=95, worst_ms=WORST),
            "asked_ms": self.asked_ms,
            "asked_of": "worst" if self.percentile == WORST else f"p{self.percentile}",
            "holds": self.holds,
        }


@dataclass(frozen=True)
class Found:
    name: str  # of its files
    figures: dict[str, Any]  # one JSON object
    report: Sequence[Table | str]  # the same, to be printed
    chart: bytes | None = None  # a PNG file
    fault: str = ""

    def write(self, out: Path) -> Path:
        """Write figures and chart into a folder; the file that a person looks at."""
        text = json.dumps(self.figures, indent=2, ensure_ascii=False, allow_nan=False)
        atomic.write_text(file := out / f"{self.name}.json", text + "\n")
        if self.chart is not None:
            atomic.write_bytes(file := out / f"{self.name}.png", self.chart)
        return file


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], *folded: str) -> Table:
    """A table of names and figures, and of texts, which are `folded` where they are long."""
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for place, heading in enumerate(headings):
        if heading in folded:
            made.add_column(heading, overflow="fold")
        else:
            made.add_column(heading, no_wrap=True, justify="right" if place else "left")
    for row in rows:
        made.add_row(*row)
    return made


def machine_words(about: Mapping[str, Any]) -> str:
    computer = about["machine"]
    return f"machine: {computer['cpu']}, {computer['cores']} core(s); python {computer['python']}"


def yes_or_no(holds: bool | None) -> str:
    return {True: "yes", False: "NO", None: ""}[holds]


def print_report(parts: Iterable[Table | str]) -> None:
    """Print tables and lines on standard output, as wide as the terminal or as plain text."""
    console = Console(width=None if sys.stdout.isatty() else _PLAIN_WIDTH, highlight=False)
    for part in parts:
        console.print(part, markup=False)
