"""Links between pages, followed as files of a checkout; the site's build follows its own."""

import json
import re
from functools import cache
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
TOP = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
DOCS = ROOT / "docs"
PAGES = sorted([*TOP, *DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")])
MARKDOWN = MarkdownIt("commonmark").enable("table")


class _Links(HTMLParser):
    """The addresses and the anchors of a page."""

    def __init__(self, html):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[name] for name in ("href", "src") if given.get(name)]
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}


@cache
def read(page):
    """The links of a page and the anchors that code hosts give it."""
    text = page.read_text("utf-8")
    if page.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join(
            "".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"
        )
    found = _Links(MARKDOWN.render(text))
    tokens = MARKDOWN.parse(text)
    for before, token in pairwise(tokens):
        if before.type == "heading_open":
            shown = (it.content for it in token.children if it.type in ("text", "code_inline"))
            slug = re.sub(r"[^\w\- ]", "", "".join(shown).lower()).replace(" ", "-")
            same = [slug, *(f"{slug}-{number}" for number in range(1, 99))]
            found.anchors.add(next(each for each in same if each not in found.anchors))
    return found


def dead_links(page):
    dead = []
    for link in read(page).links:
        scheme, host, path, _, anchor = urlsplit(link)
        if scheme or host:
            continue
        there = (page.parent / unquote(path)).resolve() if path else page
        known = there.suffix in (".md", ".ipynb") and there.is_file()
        if not there.exists() or (anchor and known and anchor not in read(there).anchors):
            dead.append(link)
    return dead


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page):
    assert dead_links(page) == []


def test_a_dead_link_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# One `word`: two\n\n# Same\n\n# Same\n\n![](gone.jpg) <a href='gone.md'>x</a>\n\n"
        "[](#one-word-two) [](#same-1) [](#same-2) [](page.md#no) [](other.md) [](https://x.org/y)"
    )
    assert dead_links(page) == ["gone.jpg", "gone.md", "#same-2", "page.md#no", "other.md"]
