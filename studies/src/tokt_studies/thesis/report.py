"""Exhibits of ``tokt reproduce`` as results.json has them, and as one HTML file for people.

To change the format of results.json: raise `FORMAT`, and say in docs what changed.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from tokt.training.evaluation.pictures import file_uri
from tokt.training.evaluation.report import report_page

from .exhibits.exhibit import ClaimAgreement, Exhibit, Table

FORMAT = 2
"""Of results.json. 1 had `numbers` of each exhibit; they stand in its tables."""
SHOWN_ROWS = 60
"""Rows of a table that the results and the report hold; its CSV file holds all."""
_CLASSES = dict(zip(map(str, ClaimAgreement), ("good", "partly", "bad", "open"), strict=True))


def exhibit_json(exhibit: Exhibit) -> dict[str, Any]:
    """An exhibit as results.json has it."""
    return {
        "key": exhibit.key,
        "title": exhibit.title,
        "section": exhibit.section,
        "words": list(exhibit.words),
        "missing": exhibit.missing,
        "claims": [asdict(claim) for claim in exhibit.claims],
        "tables": [_table(exhibit, table) for table in exhibit.tables],
        "plots": [
            {"name": plot.name, "caption": plot.caption, "file": plot_file(exhibit, plot.name)}
            for plot in exhibit.plots
        ],
    }


def _table(exhibit: Exhibit, table: Table) -> dict[str, Any]:
    shown = table.frame.head(SHOWN_ROWS)
    words = table.name.replace("_", " ").replace("-", " ")
    return {
        "name": table.name,
        "title": words[:1].upper() + words[1:],
        "caption": table.caption,
        "file": f"{exhibit.key}/{table.name}.csv",
        "columns": [str(name) for name in table.frame.columns],
        "n_rows": len(table.frame),
        "rows": [[plain(value) for value in row] for row in shown.itertuples(index=False)],
    }


def plain(value: Any) -> Any:
    """A value as JSON has it: NumPy's and pandas' numbers as Python's, what is missing as None."""
    if value is None or value is pd.NA:
        return None
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, int) else str(value)


def report_html(exhibits: Sequence[Exhibit], results: dict[str, Any]) -> str:
    """The report's text, of the exhibits' pictures and of all else as results.json has it."""
    pictures = {
        plot_file(exhibit, plot.name): file_uri("png", plot.png)
        for exhibit in exhibits
        for plot in exhibit.plots
    }
    claims = Counter(
        claim["agreement"] for exhibit in results["exhibits"] for claim in exhibit["claims"]
    )
    counts = [(word, claims[word]) for word in _CLASSES if claims[word]]
    filters = {"cell": cell, "agreement_class": _CLASSES.__getitem__}
    return report_page(__package__, filters, run=results, pictures=pictures, counts=counts)


def plot_file(exhibit: Exhibit, name: str) -> str:
    """Where a picture of an exhibit is written, below the folder of the run."""
    return f"{exhibit.key}/{name}.png"


def cell(value: Any) -> str:
    """A value as a table shows it: four figures, nothing where it is not known."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
