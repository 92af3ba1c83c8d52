"""results.json: everything a run of ``tokt reproduce`` found, for other programs and pages.

To change the format: raise `FORMAT`, and say in docs what changed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from .exhibit import Exhibit, Table

FORMAT = 1
SHOWN_ROWS = 60
"""Rows of a table that the results and the report hold; its CSV file holds all."""


def results_json(
    exhibits: Sequence[Exhibit],
    mission: dict[str, Any],
    about: list[str],
    machine: dict[str, Any],
    seconds: float,
) -> dict[str, Any]:
    """The JSON object of a run.

    Parameters
    ----------
    exhibits : sequence of Exhibit
        In the order of the report.
    mission : dict
        name, frames, pairs.
    about : list of str
        What the figures rest on.
    machine : dict
        Where the times were measured.
    seconds : float
        That the run took.
    """
    return {
        "format": FORMAT,
        "mission": mission,
        "about": about,
        "machine": machine,
        "seconds": round(seconds, 1),
        "exhibits": [_exhibit(one) for one in exhibits],
    }


def results_text(results: dict[str, Any]) -> str:
    """The file's text. Raises ValueError for a number that is not finite."""
    return json.dumps(results, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def table_csv(table: Table) -> str:
    """A table as CSV text, floats short."""
    return str(table.frame.to_csv(index=False, lineterminator="\n", float_format="%.6g"))


def _exhibit(exhibit: Exhibit) -> dict[str, Any]:
    return {
        "key": exhibit.key,
        "title": exhibit.title,
        "section": exhibit.section,
        "words": list(exhibit.words),
        "missing": exhibit.missing,
        "claims": [
            {
                "what": claim.what,
                "printed": claim.printed,
                "found": claim.found,
                "agreement": claim.agreement.value,
                "why": claim.why,
            }
            for claim in exhibit.claims
        ],
        "numbers": {name: plain(value) for name, value in exhibit.numbers.items()},
        "tables": [_table(exhibit, table) for table in exhibit.tables],
        "plots": [
            {
                "name": plot.name,
                "caption": plot.caption,
                "file": f"{exhibit.key}/{plot.name}.png",
            }
            for plot in exhibit.plots
        ],
    }


def _table(exhibit: Exhibit, table: Table) -> dict[str, Any]:
    shown = table.frame.head(SHOWN_ROWS)
    return {
        "name": table.name,
        "title": table.heading,
        "caption": table.caption,
        "file": f"{exhibit.key}/{table.name}.csv",
        "columns": [str(name) for name in table.frame.columns],
        "n_rows": len(table.frame),
        "rows": [[plain(value) for value in row] for row in shown.itertuples(index=False)],
    }


def plain(value: Any) -> Any:
    """A value as JSON has it: NumPy's and pandas' numbers as Python's, what is missing as None."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if value is None or value is pd.NA:
        return None
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return str(value)
