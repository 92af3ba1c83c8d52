"""Reports: one HTML file each that needs no other, and no network, all of one look."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jinja2


def _figure(value: float | None, form: str = ".3f") -> str:
    return "–" if value is None else format(value, form)


def report_page(
    room: str, filters: Mapping[str, Callable[..., Any]] | None = None, **values: Any
) -> str:
    """A room's ``report.html``, which extends the ``base.html`` beside this module, filled in.

    The room is a package, as ``__package__`` has it. Filters are the template's own, by name;
    ``figure`` and ``signed`` are there. Values are what it names. Text is escaped; JSON holds no
    NaN.
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
    signed = partial(_figure, form="+.3f")
    environment.filters.update(figure=_figure, signed=signed, **(filters or {}))
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment.get_template("report.html").render(values)
