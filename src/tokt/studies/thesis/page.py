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

TEMPLATE = "page.md.in"
QUOTED_TABLES = {"table-5.1-to-5.4": "printed_rows"}
"""By exhibit, the table that the page shows; the others are in the report."""
ASKED = ("claims", "quoted_table")
"""Methods of `Results` that the template may call."""
_SPECIAL = re.compile(r"([*|<])")


class Results:
    """A run's results, which results.json holds, as the template may ask for them."""

    def __init__(self, results: dict[str, Any]) -> None:
        self._exhibits = {one["key"]: one for one in results["exhibits"]}

    def _exhibit(self, key: str) -> dict[str, Any]:
        if key not in self._exhibits:
            known = ", ".join(self._exhibits)
            raise ToktError(f"the page asks for {key!r}, which the run has not (it has {known})")
        return dict(self._exhibits[key])

    def claims(self, key: str) -> str:
        """A table of what the thesis printed, what came out, and whether it agrees."""
        exhibit = self._exhibit(key)
        if exhibit["missing"]:
            return f"Not made in this run: {plain(exhibit['missing'])}."
        rows = [["claim", "the thesis", "this run", "whether they agree"]]
        for claim in exhibit["claims"]:
            what, printed, found, agreement, why = (
                plain(claim[name]) for name in ("what", "printed", "found", "agreement", "why")
            )
            rows.append([f"**{what}**", printed, found, f"*{agreement}*: {why}"])
        return _table(rows)

    def quoted_table(self, key: str) -> str:
        """The table of an exhibit that is one of `QUOTED_TABLES`; nothing for the others."""
        exhibit = self._exhibit(key)
        name = QUOTED_TABLES.get(key)
        if name is None or exhibit["missing"]:
            return ""
        table = next((one for one in exhibit["tables"] if one["name"] == name), None)
        if table is None:
            raise ToktError(f"the page shows the table {name!r} of {key}, which it has not")
        rows = [table["columns"], *table["rows"]]
        cells = [[_cell(value) for value in row] for row in rows]
        return f"{_table(cells)}\n\n{plain(table['caption'])}."


def _table(rows: list[list[str]]) -> str:
    """A table in Markdown; its first row is the heading."""
    first, *rest = ("| " + " | ".join(row) + " |" for row in rows)
    return "\n".join([first, "|" + " --- |" * len(rows[0]), *rest])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return format(value, ".3g") if isinstance(value, float) else plain(str(value))


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
    try:
        asked = {name: getattr(Results(results), name) for name in ASKED}
        body = environment.from_string(text).render(run=results, plain=plain, **asked)
    except jinja2.TemplateError as error:
        raise ToktError(f"the page of the thesis cannot be made: {error}") from error
    body = body.rstrip() + "\n"
    return f"{body}\n<!-- template {_sha256(text)}, page {_sha256(body)} -->\n"


def write_thesis_page(results: dict[str, Any], path: Path) -> None:
    """Write `thesis_page` to a file, as a whole or not at all. Raises ToktError as that does."""
    atomic.write_text(path, thesis_page(results))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
