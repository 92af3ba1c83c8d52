"""The reference made from the code: complete, and true to what is sent, served and said."""

import ast
import re
import runpy
from pathlib import Path

import pytest

from tokt.inference.config import OPTIONS
from tokt.inference.reason import Fault, Reason
from tokt.inference.report import FIELDS, LOG_ONLY, MEANINGS, SINCE, V2_FIELDS, Report
from tokt.inference.verdict import unknown_verdict

ROOT = Path(__file__).parents[2]
VERSION = re.compile(r"_?([A-Z]+_)*(FORMAT|VERSION)")


@pytest.fixture(scope="module")
def reference():
    return runpy.run_path(str(ROOT / "docs/generate_reference.py"))


def cells(page, title):
    """The first column of the first table under a heading."""
    below = page[page.index(f"{title}\n") :].split("\n| ", 1)[1].split("\n\n")[0]
    return [line.split("`")[1] for line in below.splitlines()[2:]]


def test_the_committed_pages_are_what_the_code_says(reference):
    """`python docs/generate_reference.py` makes them anew."""
    stale = {path.name for path, text in reference["pages"]().items() if path.read_text() != text}
    assert stale == set()


def test_every_field_has_its_meaning_and_stands_in_the_order_it_is_sent(reference):
    assert list(MEANINGS) == [each.name for each in FIELDS]
    assert set(SINCE) == {each.since for each in FIELDS}
    page = reference["report"]()
    sent = Report(1, 412, 2.5, 3.5, unknown_verdict(Fault(Reason.DARK, "dark"))).fields()
    assert cells(page, "## UDP v2") == [*sent] == [each.name for each in V2_FIELDS]
    assert cells(page, "## Log lines") == [each.name for each in LOG_ONLY]


def test_every_reason_says_what_it_is_and_what_to_do(reference):
    page = reference["reasons"]()
    assert cells(page, "# Reasons") == [*Reason]
    rows = re.findall(r"^\| `\w+` \| ([A-Z].*\.) \| ([A-Z].*\.) \|$", page, re.MULTILINE)
    assert len(rows) == len(Reason)
    prose = runpy.run_path(str(ROOT / "docs/prose.py"))
    said = [prose["Text"]("reasons", 0, cell) for row in rows for cell in row]
    assert not list(prose["too_long"](said))


def test_the_metrics_are_those_of_the_fields_and_more(reference):
    names = cells(reference["metrics"](), "# Metrics")
    assert {f"tokt_{each.metric}" for each in FIELDS if each.metric} < {*names}
    assert len(names) == len({*names}) > 30


def test_every_option_of_a_run_is_a_key_of_the_page(reference):
    keys = re.findall(r"^\| `([\w-]+)` \|", reference["config"](), re.MULTILINE)
    assert keys == [each.key for each in OPTIONS.values()]


def test_every_command_and_option_of_help_is_on_the_page(reference, run_tokt):
    page = reference["command_line"]()
    for command in ("train", "labels import", "run", "models promote"):
        section = page.split(f"\n## tokt {command}\n", 1)[1].split("\n## ")[0]
        options = re.findall(r"(?<=  )--[a-z][\w-]+", run_tokt(*command.split(), "--help").out)
        assert len(options) > 2
        missing = {each for each in options if each not in section} - {"--help"}
        assert missing == set()
    assert len(re.findall(r"^## tokt ", page, re.MULTILINE)) > 35


def test_exit_codes_are_those_of_help(reference, run_tokt):
    found = cells(reference["exit_codes"](), "# Exit codes")
    assert found == ["0", "1", "2", "70", "130"]
    assert all(f"{code} " in run_tokt("--help").out for code in found)


def test_every_version_of_a_file_format_is_on_the_page(reference):
    """What the code calls a format's version: a whole number, by such a name."""
    rooms = [*(ROOT / "src/tokt").iterdir(), ROOT / "studies/src/tokt_studies"]
    found = {
        f"{module}.{target.id}"
        for room in rooms
        for path in room.rglob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        if type(node.value.value) is int
        for target in node.targets
        if isinstance(target, ast.Name) and VERSION.fullmatch(target.id)
        for module in [".".join(path.with_suffix("").parts).rpartition(".src.")[2]]
    }
    found = {name.removeprefix("tokt.") for name in found}
    assert found - {*reference["FORMATS"]} == set()
    assert "version" in reference["formats"]()
