"""The steps of MkDocs that are the site's own: the Python page, notebooks as pages, links outside.

Notebooks are committed without outputs. With ``TOKT_NOTEBOOKS=run`` the build runs them and shows
what they print and draw.
"""

import logging
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

sys.path.insert(0, str(Path(__file__).parent))
from generate_reference import MADE, python

RUN_NOTEBOOKS = os.environ.get("TOKT_NOTEBOOKS") == "run"
MAX_CELL_S = 600
_LOG = logging.getLogger("mkdocs.hooks.tokt")
_EXTERNAL = re.compile(r'href="(https?://[^"]+)"')
_external: dict[str, set[str]] = {}


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Put the long appendix last in the search; have mkdocstrings fill in the Python page."""
    if page.file.src_uri == "thesis.md":
        page.meta["search"] = {"boost": 0.2}
    if page.file.src_uri == "reference/python.md":
        return python(site=True)
    return markdown.replace(MADE, "")  # a title is the first thing of its page


class NotebookFile(File):
    """A notebook, which is a page."""

    def is_documentation_page(self) -> bool:
        """It is."""
        return True

    @property
    def content_string(self) -> str:
        """The notebook as Markdown."""
        return notebook_page(Path(str(self.abs_src_path)))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Take notebooks as pages."""
    for file in [*files]:
        if file.src_uri.endswith(".ipynb"):
            files.remove(file)
            place = (file.src_uri, config.docs_dir, config.site_dir, config.use_directory_urls)
            files.append(NotebookFile(*place))
    return files


def on_page_content(html: str, page: Page, **_: Any) -> None:
    """Note the links that leave the site."""
    for address in _EXTERNAL.findall(html):
        _external.setdefault(address, set()).add(page.file.src_uri)


def on_post_build(config: MkDocsConfig) -> None:
    """List them: nothing is fetched. Away with the page that only a web server shows."""
    (Path(config.site_dir) / "404.html").unlink()
    for address, places in sorted(_external.items()):
        _LOG.info("not fetched: %s in %s", address, ", ".join(sorted(places)))
    _external.clear()


def notebook_page(path: Path) -> str:
    """A notebook as Markdown, with its outputs where it was run."""
    notebook = nbformat.read(path, as_version=4)
    if RUN_NOTEBOOKS:
        from nbclient import NotebookClient

        with tempfile.TemporaryDirectory() as folder:
            place = {"metadata": {"path": folder}}
            NotebookClient(notebook, timeout=MAX_CELL_S, resources=place).execute()
    parts = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        elif cell.cell_type == "code" and cell.source.strip():
            parts.append(f"```python\n{cell.source}\n```")
            parts += [shown for output in cell.outputs if (shown := _output(output))]
    return "\n\n".join(parts) + "\n"


def _output(output: Any) -> str:
    """What a cell printed or gave, as Markdown; nothing of progress and warnings."""
    if output.output_type == "stream":
        return _block(output.text) if output.name == "stdout" else ""
    data = output.get("data", {})
    if "image/png" in data:
        return f"![](data:image/png;base64,{''.join(data['image/png'].split())})"
    if "text/html" in data:
        table = re.sub(r"<style.*?</style>", "", data["text/html"], flags=re.DOTALL)
        table = re.sub(r"<table[^>]*>|<tr style[^>]*>", lambda tag: tag[0].split()[0] + ">", table)
        return re.sub(r"\n\s*\n", "\n", table)
    return _block(data.get("text/plain", ""))


def _block(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```" if text.strip() else ""
