"""The report of a run: one HTML file that needs no other."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Sequence
from importlib import resources
from typing import Any

import jinja2

from .exhibit import Agreement, Exhibit

_CLASSES = {
    Agreement.YES.value: "yes",
    Agreement.PARTLY.value: "partly",
    Agreement.NO.value: "no",
    Agreement.UNCOMPARABLE.value: "open",
}


def report_html(exhibits: Sequence[Exhibit], results: dict[str, Any]) -> str:
    """The report's text.

    Parameters
    ----------
    exhibits : sequence of Exhibit
        Their pictures.
    results : dict
        Everything else, as `tokt.training.reproduce.results.results_json` gives it.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["cell"] = cell
    environment.filters["agreement_class"] = _CLASSES.__getitem__
    template = environment.from_string(
        resources.files(__package__).joinpath("report.html").read_text("utf-8")
    )
    pictures = {
        f"{exhibit.key}/{plot.name}.png": _data_uri(plot.png)
        for exhibit in exhibits
        for plot in exhibit.plots
    }
    claims = Counter(
        claim["agreement"] for exhibit in results["exhibits"] for claim in exhibit["claims"]
    )
    counts = [(word, claims[word]) for word in _CLASSES if claims[word]]
    return str(template.render(run=results, pictures=pictures, counts=counts))


def cell(value: Any) -> str:
    """A value as a table shows it: four figures, nothing where it is not known."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
