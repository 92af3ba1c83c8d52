"""Reports: one HTML file each that needs no other, and no network, all of one look."""

from collections.abc import Callable, Mapping
from typing import Any

import jinja2


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.3f}"


def report_page(
    room: str, filters: Mapping[str, Callable[..., Any]] | None = None, **values: Any
) -> str:
    """A room's ``report.html``, which extends the ``base.html`` beside this module, filled in.

    Parameters
    ----------
    room : str
        The package that the template lies in, as ``__package__`` has it.
    filters : mapping of str to callable, optional
        The template's own, by name; ``figure`` and ``signed`` are there.
    **values
        What the template names. Text is escaped; JSON holds no NaN.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.PackageLoader(package or "", ".") for package in (room, __package__)]
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(figure=_figure, signed=_signed, **(filters or {}))
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment.get_template("report.html").render(values)
