"""Notebooks as pages of the docs' site."""

import runpy
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="make docs installs what builds the site")
nbformat = pytest.importorskip("nbformat")
v4 = nbformat.v4

HOOKS = Path(__file__).parents[3] / "docs/site_hooks.py"


def page_of(tmp_path, *cells):
    path = tmp_path / "some.ipynb"
    nbformat.write(v4.new_notebook(cells=[*cells]), path)
    return runpy.run_path(str(HOOKS))["notebook_page"](path)


def test_a_notebook_without_outputs_is_its_text_and_code(tmp_path):
    page = page_of(tmp_path, v4.new_markdown_cell("# Title"), v4.new_code_cell("1 + 1"))
    assert page == "# Title\n\n```python\n1 + 1\n```\n"


def test_outputs_are_shown_and_progress_is_not(tmp_path):
    pandas = (
        '<div>\n<style scoped>\n  td {}\n\n</style>\n<table border="1"><td>7</td>\n\n</table></div>'
    )
    cell = v4.new_code_cell("train()")
    cell.outputs = [
        v4.new_output("stream", name="stdout", text="folds 5\n"),
        v4.new_output("stream", name="stderr", text="12 of 100"),
        v4.new_output("execute_result", data={"text/html": pandas, "text/plain": "no"}),
        v4.new_output("display_data", data={"image/png": "aGk=\n", "text/plain": "<Figure>"}),
        v4.new_output("execute_result", data={"text/plain": "'a'"}),
    ]
    page = page_of(tmp_path, cell)
    shown = page.split("```python\ntrain()\n```\n\n")[1].split("\n\n")
    assert shown == [
        "```text\nfolds 5\n```",
        "<div>\n\n<table><td>7</td>\n</table></div>".replace("\n\n", "\n"),
        "![](data:image/png;base64,aGk=)",
        "```text\n'a'\n```\n",
    ]
