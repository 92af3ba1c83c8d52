"""The report of a run: one HTML file that needs no other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from importlib import resources
from typing import Any

import jinja2

from tokt.training.evaluation.pictures import png_uri

from .exhibit import ClaimAgreement, Exhibit

_CLASSES = {
    ClaimAgreement.YES.value: "yes",
    ClaimAgreement.PARTLY.value: "partly",
    ClaimAgreement.NO.value: "no",
    ClaimAgreement.UNCOMPARABLE.value: "open",
}


def report_html(exhibits: Sequence[Exhibit], results: dict[str, Any]) -> str:
    """The report's text.

    Parameters
    ----------
    exhibits : sequence of Exhibit
        Their pictures.
    results : dict
        Everything else, as `tokt.studies.thesis.results.results_json` gives it.
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
        f"{exhibit.key}/{plot.name}.png": png_uri(plot.png)
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
