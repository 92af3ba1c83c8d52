"""The wheel of the studies: its files, the tokt it is pinned to, and its commands beside tokt's."""

import os
import re
import sys
import zipfile
from functools import partial
from pathlib import Path

import pytest

import tokt
from tests.fixtures import ROOT, build_wheel
from tests.process.installed import Installed
from tokt_studies.simulation.rendering.synthetic_mission import simulate_mission

PACKAGE = "studies/src/"


@pytest.fixture(scope="module")
def studies_wheel(sources, shared_folder):
    """tokt-studies as a wheel; one that is built already lies beside that of tokt."""
    if "TOKT_WHEEL" in os.environ:
        return next(Path(os.environ["TOKT_WHEEL"]).parent.glob("tokt_studies-*.whl"))
    built = shared_folder("studies-wheel", partial(build_wheel, sources / "studies"))
    return next(built.glob("*.whl"))


def test_it_holds_what_git_holds_and_is_pinned_to_tokt_of_its_version(
    studies_wheel, wheel, git_files
):
    if not git_files:
        pytest.skip("not a git checkout")
    product = {name.removeprefix(PACKAGE) for name in git_files if name.startswith(PACKAGE)}
    with zipfile.ZipFile(studies_wheel) as archive:
        packed = archive.namelist()
        (about,) = (name for name in packed if name.endswith("/METADATA"))
        metadata = archive.read(about).decode()
        files = {name: archive.read(name) for name in packed if ".dist-info/" not in name}
    assert {*files} == product and len(packed) == len(set(packed))
    assert [name for name in files if (ROOT / PACKAGE / name).read_bytes() != files[name]] == []
    (pinned,) = re.findall(r"^Requires-Dist: tokt\[demo\]==(\S+)$", metadata, re.MULTILINE)
    (version,) = re.findall(r"^Version: (\S+)$", metadata, re.MULTILINE)
    assert pinned == version == wheel.name.split("-")[1]


def test_its_commands_join_those_of_an_installed_tokt(studies_wheel, wheel, tmp_path):
    installed = Installed(wheel, tmp_path / "venv")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", installed.python)
    installed.run(*pip, "install", "--quiet", "--no-compile", "--no-deps", studies_wheel)
    helped = installed.run(installed.python, "-m", "tokt", "--help")
    assert re.search(r"^Studies:\n  demo .*\n  simulate .*\n  reproduce .*\n  bench ", helped, re.M)
    dive = tmp_path / "dive"
    options = ("--frames", "2", "--width", "360", "--jobs", "1")
    said = installed.run(installed.python, "-m", "tokt", "simulate", dive, *options)
    assert "2 stereo pairs of 360x271" in said and (dive / "labels.csv").is_file()


def test_the_public_name_of_tokt_is_that_of_the_studies():
    assert tokt.simulate_mission is simulate_mission and "simulate_mission" in dir(tokt)
