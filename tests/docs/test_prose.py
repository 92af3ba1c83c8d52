"""The hand-written prose is short, and so are its sentences; `docs/prose.py` finds those that are
not.
"""

import importlib.util
import json
from pathlib import Path

import pytest
import typer

SCRIPT = Path(__file__).parents[2] / "docs" / "prose.py"
LONG = " ".join(f"word{number}" for number in range(26))


@pytest.fixture(scope="module")
def prose():
    spec = importlib.util.spec_from_file_location("prose", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def found(prose, texts):
    return [(each.line, each.words) for each in prose.too_long(texts)]


def test_pages_have_no_long_sentence(prose):
    texts = [
        text
        for page in prose.pages()
        for text in (*prose.page_texts(page), *prose.cell_texts(page))
    ]
    assert len(texts) > 1000
    assert not [str(each) for each in prose.too_long(texts)]


def test_pages_have_no_more_words_than_a_newcomer_reads(prose):
    counts = prose.counts()
    assert counts["README.md"] > 0
    assert sum(counts.values()) <= prose.MAX_WORDS


def test_help_and_errors_have_no_long_sentence(prose):
    texts = list(prose.product_texts())
    kinds = {Path(text.where).suffix for text in texts if "/" in text.where}
    assert kinds == {".py", ".html", ".js"}
    assert {"tokt", "tokt run --source", "tokt.Grid", "tokt.Store.deploy", "tokt.sklearn.LBP"} <= {
        text.where for text in texts
    }
    assert not [str(each) for each in prose.too_long(texts)]


@pytest.mark.parametrize(
    ("texts", "written", "line"),
    [
        ("paragraphs", f"Short.\n\n{LONG}.\n", 3),
        ("paragraphs", f"A table.\n\n!!! warning\n    {LONG}.\n", 4),
        ("paragraphs", f"A link.\n\n{LONG.replace('word0', '[word0](x.md#a.b)')}.\n", 3),
        ("said_texts", f'"""Short."""\n\nraise ToktError("{LONG[:80]}" f"{LONG[80:]}")\n', 3),
        ("said_texts", f'"""Short."""\n\nsay("{LONG}" if known else "short")\n', 3),
        ("html_texts", f"<p>Short.</p><p>{LONG.replace('word3', '<b>word3</b>')}</p>", 1),
        ("html_texts", f'<img alt="{LONG}">', 1),
        ("script_texts", f'\nsay("{LONG[:79]}" +\n  "{LONG[79:]}");', 2),
        ("docstring_texts", f"Short.\n\nParameters\n----------\nname : str\n    {LONG}\n", 6),
    ],
)
def test_a_long_sentence_is_found(prose, texts, written, line):
    read = getattr(prose, texts)
    assert found(prose, read("where", written)) == [(line, 26)]
    assert not found(prose, read("where", written.replace("word25", "")))


@pytest.mark.parametrize(
    "page",
    [
        LONG.replace("word9", "word9. And"),
        LONG.replace("word9 ", "word9\n- "),
        f"1. Step:\n\n    ```\n    {LONG}\n    ```\n",
        f"| a |\n|---|\n| {LONG} |",
        f"`{LONG}` is one word.",
        f"<!-- {LONG} -->",
        f"---\ntitle: {LONG}\n---\n",
        f"Head.\n\n<!-- Made by a program. -->\n\n{LONG}\n",
    ],
)
def test_no_sentence_is_made_of_several_nor_of_code(prose, page):
    assert not found(prose, prose.paragraphs("page", page))


def test_an_abbreviation_ends_no_sentence(prose):
    text = "L. S. Brusletto says so, e.g. in fig. 3 (cf. the thesis). Version 1.2 does, too. Done!"
    assert [len(prose.words(each)) for each in prose.sentences(text)] == [12, 4, 1]


def test_a_long_sentence_in_a_notebook_is_found(prose, tmp_path, monkeypatch):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    cells = [{"cell_type": kind, "source": [LONG]} for kind in ("code", "markdown")]
    book = tmp_path / "book.ipynb"
    book.write_text(json.dumps({"cells": cells}))
    assert [each.where for each in prose.too_long(prose.page_texts(book))] == ["book.ipynb, cell 2"]


def test_a_long_sentence_in_help_is_found(prose):
    app, below = typer.Typer(help=LONG), typer.Typer(help=LONG)
    app.add_typer(below, name="below")

    @below.command("do", epilog=LONG)
    def _do(argument: str = typer.Argument(help=LONG), option: str = typer.Option(help=LONG)):
        """Do it."""

    where = [each.where for each in prose.too_long(prose.help_texts(typer.main.get_command(app)))]
    parts = ("below do", "below do argument", "below do --option")
    assert where == ["tokt", "tokt below", *(f"tokt {part}" for part in parts)]


def test_words_are_counted_without_code_and_tables_but_for_the_glossary(
    prose, tmp_path, monkeypatch
):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    (tmp_path / "docs").mkdir()
    text = f"Two `code of it` words.\n\n```\nno word\n```\n\n| a | b |\n|---|---|\n| x | {LONG} |\n"
    pages = [tmp_path / "README.md", tmp_path / "docs" / "glossary.md"]
    for page in pages:
        page.write_text(text)
        assert found(prose, prose.cell_texts(page)) == [(9, 26)]
    monkeypatch.setattr(prose, "pages", lambda: pages)
    assert prose.counts() == {"README.md": 3, "docs/glossary.md": 32}


def test_the_script_fails_where_there_is_too_much(prose, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    monkeypatch.setattr(prose, "product_texts", lambda: [])
    (tmp_path / "studies/src/tokt_studies/thesis").mkdir(parents=True)
    for page in ("README.md", "CONTRIBUTING.md", prose.TEMPLATE):
        (tmp_path / page).write_text("Short.")
    assert prose.main([]) == 0
    (tmp_path / "README.md").write_text(LONG)
    assert prose.main([]) == 1
    assert prose.main(["CONTRIBUTING.md"]) == 0
    assert f"README.md:1: 26 words: {LONG}" in capsys.readouterr().out
    (tmp_path / "README.md").write_text("Short. " * (prose.MAX_WORDS + 1))
    assert prose.main([]) == 1
