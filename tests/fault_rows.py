"""The rows of docs/reference/faults.md, which fault tests hold and the soak injects faults by."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TABLE = Path(__file__).parents[1] / "docs" / "reference" / "faults.md"
_ROW = re.compile(r"^\| (?!---|fault \|)(.*?) \| (.*?) \| (.*?) \|$", re.MULTILINE)
_VERDICT = re.compile(r"(obstacle|clear|unknown) `(\w+)`")


@dataclass(frozen=True)
class FaultRow:
    """One fault, and the two cells that say what it comes to."""

    fault: str
    comes_to: str
    counted: str

    @property
    def verdicts(self) -> frozenset[tuple[str, str]]:
        """Status and reason of the frames with the fault, in words."""
        return frozenset(_VERDICT.findall(self.comes_to))

    @property
    def events(self) -> frozenset[str]:
        """Names of the events that it is reported by."""
        parts = (part for part in self.counted.split("; ") if part.startswith("event"))
        return frozenset(re.findall(r"`(\w+)`", " ".join(parts)))


def read_rows() -> list[FaultRow]:
    """Return all rows, in the order of the page."""
    return [FaultRow(*cells) for cells in _ROW.findall(TABLE.read_text("utf-8"))]


@cache
def rows_by_fault() -> dict[str, FaultRow]:
    """Return all rows, by their faults."""
    return {row.fault: row for row in read_rows()}
