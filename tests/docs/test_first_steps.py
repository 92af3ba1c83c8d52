"""What a newcomer types first: the lines of README, in an empty folder."""

import json
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from tests.calls import succeeds
from tests.fixtures import BUILD_TINY, TRAIN_TINY

ROOT = Path(__file__).resolve().parents[2]
VERBS = ("simulate", "dataset", "train", "deploy", "run")
BLOCK = re.compile(r"```\n(tokt simulate .*?)```", re.DOTALL)


def lines_of(page):
    """The commands of the page's first block that begins with a rendered dive, as typed."""
    block = BLOCK.search((ROOT / page).read_text("utf-8"))
    return [shlex.split(line, comments=True) for line in block[1].splitlines()]


SMALLER = {
    "simulate": ("--frames", 40, "--width", 360),
    "dataset": BUILD_TINY,
    "train": ("--preset", "plain", *TRAIN_TINY),
}
"""For time: `make demo` goes the same way with a whole dive and the default preset."""


@pytest.mark.study
def test_the_lines_of_the_readme_come_to_a_model_that_warns(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = lines_of("README.md")
    assert [line[:2] for line in lines] == [["tokt", verb] for verb in VERBS]
    for _, verb, *words in lines:
        ran = succeeds(verb, *words, *SMALLER.get(verb, ()), *(["--json"] * (verb == "run")))
    came = json.loads(ran.out)
    assert came["obstacle"] > 5 and came["clear"] > 5 and came["unknown"] == 0
    assert came["model"] == "tower/1" and came["sent"] == came["frames"] == 40


def test_the_first_tutorial_has_the_lines_of_the_readme():
    assert lines_of("docs/tutorials/first_model.md") == lines_of("README.md")


def test_the_install_page_has_every_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    page = (ROOT / "docs/install.md").read_text("utf-8")
    told = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert set(told) == project["optional-dependencies"].keys() - {"demo", "dev", "docs", "release"}
