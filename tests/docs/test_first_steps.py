"""What a newcomer types first: the lines of README, in an empty folder."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from tests.calls import run_python

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"```\n(tokt simulate .*?)```", re.DOTALL)


def lines_of(page):
    """The commands of the page's first block that begins with a rendered dive, as typed."""
    block = BLOCK.search((ROOT / page).read_text("utf-8"))
    return [shlex.split(line, comments=True) for line in block[1].splitlines()]


@pytest.mark.study
def test_the_lines_of_the_readme_come_to_a_model_that_warns(tmp_path):
    lines = lines_of("README.md")
    assert [line[1] for line in lines] == ["simulate", "dataset", "train", "deploy", "run"]
    for line in [*lines[:-1], [*lines[-1], "--json"]]:
        assert line[0] == "tokt"
        ran = run_python("-m", *line, folder=tmp_path)
        assert ran.returncode == 0, ran.stderr
    came = json.loads(ran.stdout)
    assert came["obstacle"] > 40 and came["clear"] > 40 and came["unknown"] == 0
    assert came["model"] == "tower/1" and came["sent"] == came["frames"]


def test_the_first_tutorial_has_the_lines_of_the_readme():
    assert lines_of("docs/tutorials/first_model.md") == lines_of("README.md")


def test_the_install_page_has_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    page = (ROOT / "docs/install.md").read_text("utf-8")
    told = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert set(told) == project["optional-dependencies"].keys() - {"demo", "dev", "docs", "release"}
