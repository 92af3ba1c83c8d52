"""Every test has its tier, ``make test`` has the proof in it, and what it leaves out is run too."""

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from _pytest.mark.expression import Expression

from tests.fixtures import pytest_ignore_collect
from tests.tiers import CORE, HERE, PROOF, STUDIES, TIERS, is_proof, tier_of

ROOT = HERE.parent
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")
FILES = sorted(HERE.rglob("test_*.py"))


def in_make_test(*markers):
    """Whether `make test` runs a test with these markers."""
    (words,) = re.findall(r"^QUICK := (.*)$", MAKEFILE, re.MULTILINE)
    return Expression.compile(words).evaluate(lambda name, **_: name in markers)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("test_tiers.py", "core"),
        ("inference/test_faults.py", "core"),
        ("inference/process/test_run_command.py", "process"),
        ("process/test_kill.py", "process"),
        ("labels/page/api/test_access.py", "process"),
        ("labels/page/state/test_review_sheet.py", "core"),
        ("labels/page/browser/frame_view/test_browser_frame.py", "browser"),
        ("training/compare/test_compare.py", "study"),
        ("load/test_soak.py", "load"),
        ("fuzz/test_fuzz.py", "fuzz"),
    ],
)
def test_a_folder_decides(file, name):
    assert (HERE / file).is_file() and tier_of(HERE / file).name == name
    assert tier_of(STUDIES / "speed" / "test_bench.py").name == "study"


def test_every_folder_of_a_tier_and_all_of_the_proof_is_there():
    tiers = {tier_of(path) for path in FILES}
    assert tiers == set(TIERS) and CORE in tiers
    folders = {folder for tier in TIERS for folder in tier.folders}
    assert [folder for folder in folders if not list(HERE.rglob(f"{folder}/**/test_*.py"))] == []
    for proof in PROOF:
        path = HERE / proof
        tests = [path] if path.is_file() else list(path.rglob("test_*.py"))
        assert tests and all(map(is_proof, tests)), proof


def test_the_markers_are_the_tiers():
    options = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["pytest"]
    markers = {line.partition(":")[0] for line in options["ini_options"]["markers"]}
    assert markers == {tier.name for tier in TIERS} | {"proof", "mission"}


def test_make_test_has_the_proof_and_the_rest_is_run_after_it():
    quick = [tier.name for tier in TIERS if in_make_test(tier.name)]
    assert quick == ["core"]
    assert all(in_make_test(tier.name, "proof") for tier in TIERS)
    (rest,) = re.findall(r"^test-rest:.*\n\t(.*)$", MAKEFILE, re.MULTILINE)
    assert rest == '$(PYTEST) -m "not ($(QUICK))" $(EXCEPT)'
    (everything,) = re.findall(r"^test-all:.*\n\t(.*)$", MAKEFILE, re.MULTILINE)
    assert everything == "$(PYTEST)"
    landing = (ROOT / ".ci" / "run").read_text("utf-8")
    made = " ".join(re.findall(r"\b(?:make|one_by_one) (.*)", landing)).split()
    assert {"demo", "test", "test-rest", "docs", "check", "wheels", "test-wheels"} <= {*made}
    # What the rest leaves out is tested on each wheel.
    of_wheels = (ROOT / "packaging" / "wheels.py").read_text("utf-8")
    assert all(name in of_wheels for name in re.findall(r"t=tests/(\S+\.py)", landing))


def test_a_run_of_the_missions_tests_leaves_none_of_their_files_out():
    config = SimpleNamespace(option=SimpleNamespace(markexpr="mission"))
    files = [path for path in FILES if "pytest.mark.mission" in path.read_text("utf-8")]
    assert any(tier_of(path) is not CORE for path in files)
    assert [path for path in files if pytest_ignore_collect(path, config)] == []


def test_every_test_carries_one_tier(request):
    """Of those of this run: all, unless some were named."""
    names = {tier.name for tier in TIERS}
    for item in request.session.items:
        own = {marker.name for marker in item.iter_markers()} & names
        assert len(own) == 1, (item.nodeid, own)
        assert is_proof(Path(item.path)) == (item.get_closest_marker("proof") is not None)
