"""Editors and type checkers follow the imports of a user's program, into a checkout or a wheel."""

import subprocess
import sys
from pathlib import Path

import jedi
import pytest

import tokt

from .installed import Installed

ROOT = Path(__file__).resolve().parents[2]

PROGRAM = '''"""Count the frames of a dive that show an obstacle."""

import tokt
from tokt.features.frames.grid import Grid
from tokt.inference.verdict import OBSTACLE
from tokt.labels.taxonomy import Taxonomy

grid, taxonomy = Grid(10, 10, 360), Taxonomy.load()
bundle = tokt.load_model("tower.tokt")
policy = tokt.SinglePolicy(tokt.TextureDetector(bundle))
statuses = [policy.judge(frame).verdict.status for frame in tokt.open_source("dive")]
print(statuses.count(OBSTACLE), grid.n_patches, bundle.label.upper())
'''
WRONG = PROGRAM.replace("bundle.label.upper()", "bundle.label + 1")
NAMES = {  # a name of each room, and the file that defines it
    "tokt.features.frames.grid.Grid": "features/frames/grid.py",
    "tokt.labels.taxonomy.Taxonomy": "labels/taxonomy.py",
    "tokt.models.bundle.bundle.read_bundle": "models/bundle/bundle.py",
    "tokt.inference.runtime.Runtime": "inference/runtime.py",
    "tokt.training.datasets.dataset.write_dataset": "training/datasets/dataset.py",
}


@pytest.fixture(scope="module", params=["editable", "wheel"])
def install(request, tmp_path_factory):
    """A Python in which tokt is installed, and the folder of the package."""
    if request.param == "wheel":
        made = Installed(request.getfixturevalue("wheel"), tmp_path_factory.mktemp("w") / "venv")
        return made.python, made.packages / "tokt"
    if Path(tokt.__file__).parent != ROOT / "src/tokt":
        pytest.skip("tokt is not installed from this checkout")
    return Path(sys.executable), ROOT / "src/tokt"


@pytest.mark.parametrize("name", NAMES)
def test_jedi_goes_to_the_definition(name, install):
    module, _, word = name.rpartition(".")
    python, package = install
    environment = jedi.create_environment(python, safe=False)
    script = jedi.Script(f"from {module} import {word}\n{word}", environment=environment)
    (definition,) = script.goto(line=2, column=0, follow_imports=True)
    assert definition.module_path == package / NAMES[name]
    assert definition.name == word and definition.line > 1


CHECKERS = {
    "pyright": ("-m", "pyright", "--pythonpath"),
    "mypy": ("-m", "mypy", "--strict", "--python-executable"),
}


@pytest.mark.parametrize("checker", CHECKERS)
def test_a_type_checker_knows_the_types_of_a_users_program(
    checker, install, tmp_path, tmp_path_factory, monkeypatch
):
    """One that does not find tokt complains; one that finds it without types passes anything."""
    # What both installs import is checked once.
    monkeypatch.setenv("MYPY_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "mypy"))
    for name, program in (("right.py", PROGRAM), ("wrong.py", WRONG)):
        (tmp_path / name).write_text(program, "utf-8")
    command = [sys.executable, *CHECKERS[checker], install[0], "right.py", "wrong.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    said = done.stdout + done.stderr
    assert done.returncode == 1 and "wrong.py:12" in said and "right.py" not in said, said
