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
    "page",
    [
        f"Short.\n\n{LONG}.\n",
        f"# Title\n\n- {LONG}\n- short\n",
        f"A table.\n\n!!! warning\n    {LONG}.\n",
        f"A link.\n\n{LONG.replace('word0', '[word0](x.md#a.b)')}.\n",
        f'<style>\n</style><div class="a">{LONG}</div>',
    ],
    ids=["paragraph", "item", "admonition", "link", "html"],
)
def test_a_long_sentence_in_a_page_is_found(prose, page):
    line = 1 + page[: page.index("word0")].count("\n")
    assert found(prose, prose.paragraphs("page", page)) == [(line, 26)]
    assert not found(prose, prose.paragraphs("page", page.replace("word25", "")))


@pytest.mark.parametrize(
    "page",
    [
        LONG.replace("word9", "word9. And"),
        LONG.replace("word9", "word9 (in short.)"),
        LONG.replace("word9 ", "word9\n\n"),
        LONG.replace("word9 ", "word9\n- "),
        f"```\n{LONG}\n```",
        f"1. Step:\n\n    ```\n    {LONG}\n    ```\n",
        f"| a |\n|---|\n| {LONG} |",
        f"    {LONG}",
        f"`{LONG}` is one word.",
        f"<!-- {LONG} -->",
        f"---\ntitle: {LONG}\n---\n",
        f"{{% if {LONG} %}}yes{{% endif %}}",
    ],
)
def test_no_sentence_is_made_of_several_nor_of_code(prose, page):
    assert not found(prose, prose.paragraphs("page", page))


def test_an_abbreviation_ends_no_sentence(prose):
    text = "L. S. Brusletto says so, e.g. in fig. 3 (cf. the thesis). Version 1.2 does, too. Done!"
    assert [len(prose.words(each)) for each in prose.sentences(text)] == [12, 4, 1]


def test_words_are_counted_without_tables_and_code(prose, tmp_path):
    page = (
        "# A page\n\nThree `code of it` words.\n\n| no | word |\n|---|---|\n\n```\nno word\n```\n"
    )
    assert sum(len(prose.words(text.text)) for text in prose.paragraphs("page", page)) == 5


def test_a_long_sentence_in_a_notebook_is_found(prose, tmp_path, monkeypatch):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    cells = [{"cell_type": kind, "source": [LONG]} for kind in ("code", "markdown")]
    book = tmp_path / "book.ipynb"
    book.write_text(json.dumps({"cells": cells}))
    assert [each.where for each in prose.too_long(prose.page_texts(book))] == ["book.ipynb, cell 2"]


def test_a_long_sentence_in_help_is_found(prose):
    app = typer.Typer(help=LONG)
    below = typer.Typer(help=LONG)
    app.add_typer(below, name="below")

    @below.command("do", epilog=LONG)
    def _do(argument: str = typer.Argument(help=LONG), option: str = typer.Option(help=LONG)):
        """Do it."""

    where = [each.where for each in prose.too_long(prose.help_texts(typer.main.get_command(app)))]
    assert where == [
        "tokt",
        "tokt below",
        "tokt below do",
        "tokt below do argument",
        "tokt below do --option",
    ]


def test_the_options_of_a_run_are_read(prose):
    from tokt.cli.app import app

    texts = {text.where for text in prose.help_texts(typer.main.get_command(app))}
    assert {"tokt run --source", "tokt labels import"} <= texts


@pytest.mark.parametrize(
    "text",
    [
        f'raise ToktError("{LONG}")',
        f'raise ToktError("{LONG[:80]}" f"{LONG[80:]}")',
        f'raise ToktError(f"{{path}} {LONG[6:]}")',
        f'raise ToktError("{LONG[:79]}" + SO + "{LONG[79:]}")',
        f'DARK = Fault("dark", "{LONG}")',
        f'say("{LONG}" if known else "short")',
        f'raise BadParameter("short" if known else f"{LONG}")',
        f'return "{LONG}"',
    ],
)
def test_a_long_sentence_that_is_said_is_found(prose, text):
    source = f'"""{LONG}"""\n\n{text}\n'
    assert [line for line, _ in found(prose, prose.said_texts("module", source))] == [3]
    short = source.replace("word25", "").replace("word24", "").replace("word3", ". Word3")
    assert not found(prose, prose.said_texts("module", short))


def test_a_long_sentence_in_a_table_is_found_and_only_the_glossary_counts_it(
    prose, tmp_path, monkeypatch
):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    (tmp_path / "docs").mkdir()
    table = f"Two words.\n\n| a | b |\n|---|---|\n| x | Short. {LONG} |\n"
    pages = [tmp_path / "README.md", tmp_path / "docs" / "glossary.md"]
    for page in pages:
        page.write_text(table)
        assert found(prose, prose.cell_texts(page)) == [(5, 26)]
    monkeypatch.setattr(prose, "pages", lambda: pages)
    assert prose.counts() == {"README.md": 2, "docs/glossary.md": 32}


@pytest.mark.parametrize(
    "page",
    [
        f"<p>{LONG}</p>",
        f"<p>Short.</p>\n<p>{LONG.replace('word3', '<b>word3</b>')}</p>",
        f"<p>{LONG.replace('word3', '{{ word3 }}')}</p>",
        f"<p>{LONG.replace('word3', '{% if a %}word3{% endif %}')}</p>",
        f'<img alt="{LONG}">',
    ],
)
def test_a_long_sentence_in_html_is_found(prose, page):
    assert [count for _, count in found(prose, prose.html_texts("page", page))] == [26]
    hidden = (
        f"<style>{LONG}</style><script>{LONG}</script>{{% block style %}}{LONG}{{% endblock %}}"
    )
    short = page.replace("word20", "</p><p>word20") if "alt" not in page else "<p></p>"
    assert not found(prose, prose.html_texts("page", hidden + short))


@pytest.mark.parametrize(
    ("script", "line"),
    [
        (f'say("{LONG}");', 1),
        (f"say(`{LONG.replace('word3', '${a(b)}')}`);", 1),
        (f'\nsay("{LONG[:79]}" +\n  "{LONG[79:]}");', 2),
    ],
)
def test_a_long_sentence_in_a_script_is_found(prose, script, line):
    assert found(prose, prose.script_texts("script", script)) == [(line, 26)]
    assert not found(prose, prose.script_texts("script", f"// {script}"[: len(LONG)]))
    assert not found(prose, prose.script_texts("script", script.replace("word20", "word. Word")))


def test_a_long_sentence_in_a_docstring_is_found(prose):
    parts = (
        f"Short.\n\nParameters\n----------\nname : str\n    {{}}\n\nExamples\n--------\n{LONG}\n"
    )
    assert found(prose, prose.docstring_texts("name", parts.format(LONG))) == [(6, 26)]
    assert not found(prose, prose.docstring_texts("name", parts.format("Short.")))


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
