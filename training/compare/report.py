"""The comparison as one HTML file that needs no other, and no network."""

from __future__ import annotations

from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from tokt.training.evaluation import plots as shared_plots

from . import plots
from .gallery import pictures
from .predictions import ComparedModels


def _text(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text("utf-8")


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.3f}"


def _plots(compared: ComparedModels, result: dict[str, Any]) -> dict[str, Any]:
    curve = result["learning_curve"]
    ranked = compared.two_sided and compared.truth.any() and not compared.truth.all()
    curves = {item.label: (compared.truth, item.score) for item in compared.models}
    return {
        "statuses": shared_plots.data_uri(plots.statuses_along(compared))
        if compared.has_frames
        else None,
        "errors": shared_plots.data_uri(plots.errors_along(result))
        if result["stretches"]
        else None,
        "precision_recall": shared_plots.data_uri(shared_plots.precision_recall(curves))
        if ranked
        else None,
        "confusion": [
            (model["model"], shared_plots.data_uri(shared_plots.confusion(table)))
            for model in result["models"]
            for table in [model["patch"]["confusion"]]
            if len(table["classes"]) > 2
        ],
        "learning": None
        if "missing" in curve
        else shared_plots.data_uri(plots.learning_curve(curve)),
    }


def report_html(compared: ComparedModels, result: dict[str, Any]) -> str:
    """The page.

    Parameters
    ----------
    compared : ComparedModels
    result : dict
        As `compare_models` gives it; embedded in the page as it is.
    """
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters.update(figure=_figure, signed=_signed)
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    sizes: dict[str, int] = {}
    for model in result["models"]:
        for name, row in model["patch"]["per_class"].items():
            sizes.setdefault(name, row["n"])
    return environment.from_string(_text("report.html")).render(
        r=result,
        # Our own files, with no end of a style or script in them.
        css=Markup(_text("report.css")),
        js=Markup(_text("explorer.js")),
        plots=_plots(compared, result),
        pictures=pictures(compared, result["errors"]),
        class_names=list(sizes),
        two_sided=compared.two_sided,
        class_sizes=sizes,
    )
