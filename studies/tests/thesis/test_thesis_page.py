"""The page from the thesis to this code: its figures come from results, and from nowhere else."""

import hashlib
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tokt.features.common.errors import ToktError
from tokt_studies.thesis.exhibits.exhibit import Claim, ClaimAgreement, Exhibit, Table
from tokt_studies.thesis.page import template_text, thesis_page, write_thesis_page
from tokt_studies.thesis.report import exhibit_json

ROOT = Path(__file__).parents[3]

SETTINGS = {"360", "10x10", "v1", "v2"}
"""What may have a digit in code: settings of the thesis, and the datagrams' formats."""
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
PLACEHOLDER = re.compile(r"{{.*?}}|{%.*?%}", re.DOTALL)
PLACE = r"\d+(?:\.\d+)*"
REFERENCE = re.compile(
    rf"\b(?:section|figure|table)s?\s+{PLACE}(?:(?:,\s+|\s+and\s+|\s+to\s+){PLACE})*\b"
)
EDITION = "NTNU 2016"
TIMED = "table-5.1-to-5.4"
"""The exhibit of which the page shows a table."""
SEAL = re.compile(r"\n<!-- template ([0-9a-f]{64}), page ([0-9a-f]{64}) -->\n\Z")


def typed_figures(template: str) -> list[str]:
    """Numbers of a template that are no place in the thesis and no setting."""
    text = PLACEHOLDER.sub("", template)
    in_code = [
        token
        for code in CODE.findall(text)
        for token in re.findall(r"[\w.]*\d[\w.]*", code)
        if token not in SETTINGS
    ]
    prose = REFERENCE.sub("", CODE.sub("", text)).replace(EDITION, "")
    return in_code + re.findall(r"\S*\d\S*", prose)


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def page_faults(page: str) -> list[str]:
    """What is wrong with a page that somebody has: not made from this template, or edited."""
    seal = SEAL.search(page)
    if seal is None:
        return ["it has no seal"]
    faults = []
    if seal[1] != sha256(template_text()):
        faults.append("it was made from another template")
    if seal[2] != sha256(page[: seal.start()]):
        faults.append("it was edited after it was made")
    return faults


def results_of(missing: str = "") -> dict[str, Any]:
    """Results of made-up exhibits, each with a figure of its own."""
    counter = iter(range(70001, 80000))
    table = pd.DataFrame({"method": ["a|b", "c"], "ms": [0.123456, None]})
    exhibits = []
    for key in ("a", TIMED):
        found = f"no, {next(counter)} px"
        why, no = "it\nis not so.", ClaimAgreement.NO
        claim = Claim("is it so", "yes, 12.5 %", found, why, agreement=no)
        made = Exhibit(
            ("Split by a | and <em>.", f"Theirs, of {key}.", f"Here: {key} 70.1."),
            (claim,),
            (Table("printed_rows", f"Caption of {key}.", table),),
            key=key,
            title=f"Title of {key}",
            section="figure 1.1",
            missing=missing,
        )
        exhibits.append(exhibit_json(made))
    mission = {"name": "dive", "frames": 60001, "pairs": 60002}
    return {
        "format": 1,
        "mission": mission,
        "seconds": 60004.5,
        "machine": {"cores": 60005},
        "about": ["ocean is frame 60003"],
        "exhibits": exhibits,
    }


def test_the_template_has_no_typed_figure():
    assert typed_figures(template_text()) == []


@pytest.mark.parametrize(
    "slipped",
    ["0.42 px off", "23 % of the view", "`0.42`", "figure 3.8 has 12 frames", "in 2026", "19.7x"],
)
def test_a_typed_figure_is_found(slipped):
    assert typed_figures(template_text() + slipped)


def test_every_figure_of_the_results_is_on_the_page():
    results = results_of()
    page = thesis_page(results)
    for exhibit in results["exhibits"]:
        assert exhibit["claims"][0]["found"] in page
    for number in ("60001", "60002", "60003", "60004.5 s on 60005 cores"):
        assert number in page
    assert "| is it so | yes, 12.5 % |" in page
    assert "| *does not agree*; it is not so |\n" in page


def test_the_run_times_table_is_on_the_page_and_no_other():
    page = thesis_page(results_of())
    assert f"Caption of {TIMED}.\n" in page and "Caption of a." not in page
    assert f"\nTheirs, of {TIMED}. Here: {TIMED} 70.1.\n" in page and "Theirs, of a" not in page
    assert "| method | ms |\n|---|---|\n| a\\|b | 0.1235 |\n| c |  |\n" in page


def test_a_table_that_the_run_lacks_is_an_error_and_writes_nothing(tmp_path):
    results = results_of()
    results["exhibits"][-1]["tables"].clear()
    with pytest.raises(ToktError, match="cannot be made"):
        write_thesis_page(results, tmp_path / "thesis.md")
    assert not list(tmp_path.iterdir())


def test_a_mission_without_pairs_or_labels_has_a_page_too():
    page = thesis_page(results_of(missing="needs two cameras"))
    assert "Not made in this run: Title of a, figure 1.1. needs two cameras." in page
    assert "Caption" not in page


def test_what_the_page_points_to_is_there():
    text = template_text()
    pages = set(re.findall(r"\]\(([\w/-]+\.md)\)", text))
    assert pages >= {"reference/udp.md", "explanation/stereo.md"}
    paths = set(re.findall(r"`((?:features|labels|models|training|inference)/[\w./]*)`", text))
    assert len(paths) > 10
    gone = [name for name in sorted(paths) if not (ROOT / name).exists()]
    gone += [name for name in sorted(pages) if not (ROOT / "docs" / name).exists()]
    assert gone == []


def test_the_committed_page_is_a_made_one():
    page = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
    assert page_faults(page) == []
