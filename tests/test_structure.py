"""The house rules that a program can check: rooms, names, module docstrings, and a true map."""

import re
from collections import Counter, defaultdict
from pathlib import Path
from pkgutil import resolve_name

import pytest

ROOT = Path(__file__).resolve().parents[1]
STUDIES = "studies/src/tokt_studies"
ROOMS = ("features", "labels", "models", "inference", "training", "src/tokt")
if (ROOT / STUDIES).is_dir():  # tokt's own sources are whole without them
    ROOMS = (*ROOMS, STUDIES)
MAX_FILES = 20  # of one kind in a room, besides its __init__.py
MAX_FILES_OF_INFERENCE = 12  # in its root
KINDS = (".py", ".js", ".css", ".html", ".h")
# A module's docstring says what it holds, not what it answers.
QUESTION = re.compile(r"(What|Whether|How|Where|Which|When|Why)\b")


def modules(*folders):
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("folder", [*ROOMS, "packaging", "tests", "docs"])
def test_a_room_holds_at_most_some_twenty_files(folder):
    counts = Counter(
        (path.parent.relative_to(ROOT).as_posix(), path.suffix)
        for path in (ROOT / folder).rglob("*")
        if path.suffix in KINDS and path.name != "__init__.py"
    )
    assert {room: n for room, n in counts.items() if n > MAX_FILES} == {}


def test_the_root_of_inference_is_the_contracts_and_the_loop():
    assert len(list((ROOT / "inference").glob("*.py"))) <= MAX_FILES_OF_INFERENCE


def test_no_two_classes_have_one_name():
    places = defaultdict(list)
    for path in modules(*ROOMS):
        for name in re.findall(r"(?m)^class (\w+)", path.read_text("utf-8")):
            places[name].append(path.relative_to(ROOT).as_posix())
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def test_a_modules_docstring_says_what_it_holds():
    begins = re.compile(r'\s*r?"""(.*)')
    said = {
        path.relative_to(ROOT).as_posix(): begins.match(path.read_text("utf-8"))
        for path in modules(*ROOMS, "tests/load")
    }
    assert {path: text for path, text in said.items() if not text or QUESTION.match(text[1])} == {}


def test_the_map_names_every_room_and_nothing_that_is_not_there():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    named = set(re.findall(rf"\b(?:{'|'.join([*ROOMS, 'tests'])})/(?:[\w./]*\w/?)?", text))
    assert {name for name in named if not (ROOT / name).exists()} == set()
    rooms = {
        path.parent.relative_to(ROOT).as_posix() + "/"
        for folder in ROOMS
        for path in (ROOT / folder).rglob("__init__.py")
    }
    assert rooms - named == set()


def test_what_docstrings_name_is_there():
    """A rename finds no whole name in backticks, such as `tokt.labels.record.LabelRecord`."""
    named = {
        name
        for path in modules(*ROOMS)
        for name in re.findall(r"`(tokt(?:\.\w+)+)`", path.read_text("utf-8"))
    }
    assert len(named) > 30
    assert [name for name in sorted(named) if not is_there(name)] == []


def is_there(name):
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        owner, _, attribute = name.rpartition(".")
        return attribute in getattr(resolve_name(owner), "__annotations__", {})
    return True


def test_tests_of_tokt_import_nothing_of_the_studies():
    """They run without them: those that need a rendered dive are in studies/tests."""
    imported = re.compile(r"^\s*(from|import) tokt_studies\b", re.MULTILINE)
    importing = {path for path in modules("tests") if imported.search(path.read_text("utf-8"))}
    assert importing == set()
