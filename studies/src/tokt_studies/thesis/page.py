"""docs/thesis.md: from the thesis to this code, with every figure taken from a run.

The text is `TEMPLATE`, beside this file; its figures are placeholders that are filled in from what
``tokt reproduce`` wrote into results.json. A page carries a seal: hashes of the template it was
made from and of itself, so that a test finds a figure typed into it afterwards.
"""

import hashlib
import re
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2

from tokt.features.common import atomic
from tokt.features.common.errors import ToktError

from .report import cell

TEMPLATE = "page.md.in"
_SPECIAL = re.compile(r"([*|<])")


def plain(text: str) -> str:
    """A sentence in one line, without its full stop, and nothing in it taken for Markdown."""
    return _SPECIAL.sub(r"\\\1", " ".join(text.split())).rstrip(".")


def template_text() -> str:
    """The page's text with its placeholders."""
    return resources.files(__package__).joinpath(TEMPLATE).read_text(encoding="utf-8")


def thesis_page(results: dict[str, Any], template: str | None = None) -> str:
    """The page, in Markdown, of results as ``tokt reproduce`` writes them into results.json.

    The template is by default the one that comes with tokt. Raises ToktError if it asks for what
    the results do not hold.
    """
    text = template_text() if template is None else template
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["cell"] = lambda value: plain(cell(value))
    try:
        body = environment.from_string(text).render(run=results, plain=plain)
    except jinja2.TemplateError as error:
        raise ToktError(f"the page of the thesis cannot be made: {error}") from error
    body = body.rstrip() + "\n"
    return f"{body}\n<!-- template {_sha256(text)}, page {_sha256(body)} -->\n"


def write_thesis_page(results: dict[str, Any], path: Path) -> None:
    """Write `thesis_page` to a file, as a whole or not at all. Raises ToktError as that does."""
    atomic.write_text(path, thesis_page(results))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
