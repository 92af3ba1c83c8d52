"""The notebooks of the documentation are short and use public names; `make docs` runs them."""

import re
from pathlib import Path

import nbformat
import pytest

import tokt

NOTEBOOKS = Path(__file__).resolve().parents[3] / "docs" / "notebooks"
MAX_CELLS = 12
OURS = ("import tokt", "import tempfile", "import matplotlib.pyplot as plt", "import pandas as pd",
        "import cv2", "from pathlib import Path")  # fmt: skip


@pytest.fixture(scope="module", params=sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda one: one.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_there_are_three():
    names = [file.stem for file in sorted(NOTEBOOKS.glob("*.ipynb"))]
    assert names == ["compare_models", "label_to_model", "read_a_log"]


def test_a_notebook_is_small_and_has_no_outputs(notebook):
    nbformat.validate(notebook)
    assert len(notebook.cells) <= MAX_CELLS
    assert [cell.outputs for cell in code(notebook)] == [[]] * len(code(notebook))
    assert {cell.execution_count for cell in code(notebook)} == {None}


def test_a_notebook_uses_the_public_names_alone(notebook):
    text = "\n".join(cell.source for cell in code(notebook))
    assert set(re.findall(r"^(?:import|from) .*", text, re.MULTILINE)) <= {*OURS}
    assert set(re.findall(r"\btokt\.(\w+)", text)) <= {*tokt.__all__}
