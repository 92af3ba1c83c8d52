"""The wheel holds what git holds, and what it starts in processes of their own runs from it.

An editable install hides what a wheel lacks: it finds every file of the checkout.
"""

import json
import re
import signal
import sys
import tomllib
import zipfile
from fnmatch import fnmatch
from pathlib import Path
from urllib.parse import urljoin
from urllib.request import urlopen

import psutil
import pytest

from tests.waiting import MAX_S

from .installed import Installed

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]
EXTENSION_SOURCES = (".pyx", ".h", ".c")
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)  # types are imported in comments
# What scripts import and export, at once or later; what a template fills in is any text.
MODULE = re.compile(r"""\b(?:from|import)\b[\s(]*["'`](\.{0,2}/[^"'`]+)["'`]""")
FILLED_IN = re.compile(r"\$\{[^}]*\}")

on_posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


@pytest.fixture(scope="module")
def packed(wheel):
    with zipfile.ZipFile(wheel) as archive:
        files = [name for name in archive.namelist() if not name.endswith("/")]
        names = [name for name in files if ".dist-info/" not in name]
        return {name: archive.read(name) for name in names}


def test_the_wheel_holds_what_git_holds(wheel, product, packed):
    missing = sorted(product.keys() - packed.keys())
    assert [name for name in missing if not name.endswith(EXTENSION_SOURCES)] == []
    assert {"tokt/py.typed", "tokt/__init__.pyi"} <= packed.keys()  # users' type checkers read them
    suffix = ".pyd" if sys.platform == "win32" else ".abi3.so"
    modules = [module["name"].replace(".", "/") for module in SETUPTOOLS["ext-modules"]]
    compiled = set() if "-none-any" in wheel.name else {name + suffix for name in modules}
    assert packed.keys() - product.keys() == compiled
    both = sorted(product.keys() & packed.keys())
    assert len(both) > 100
    assert [name for name in both if product[name].read_bytes() != packed[name]] == []


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The wheel in an environment of its own; nothing goes on in it after the tests."""
    made = Installed(wheel, tmp_path_factory.mktemp("installed").resolve() / "venv")
    yield made
    _, alive = psutil.wait_procs(made.processes(), 10)
    for process in alive:
        process.kill()
    assert not alive


@pytest.fixture
def start(installed, tmp_path):
    """Start `tokt` outside of the checkout; it is asked to end when the test does."""
    started = []

    def begin(*arguments, **environ):
        words = tmp_path / f"said-{len(started)}"
        started.append(installed.start(tmp_path, words, *arguments, **environ))
        return started[-1]

    yield begin
    for one in started:
        one.process.terminate()  # not killed: a watchdog first ends what it watches
        one.process.wait(MAX_S)


def _lines(log):
    """The whole lines of a log, which may still be written."""
    text = log.read_text("utf-8") if log.exists() else ""
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def test_every_module_is_imported_from_the_wheel(installed, packed):
    files = [name for name in packed if name.endswith(".py")]
    modules = [re.sub(r"(/__init__)?\.py$", "", name).replace("/", ".") for name in files]
    program = """
import importlib.util, json, sys
sys.path.remove(sys.argv[1])
assert importlib.util.find_spec("tokt") is None, "not only the wheel has a tokt"
sys.path.append(sys.argv[1])
print(json.dumps([importlib.util.find_spec(name).origin for name in json.load(sys.stdin)]))
"""
    command = (installed.python, "-c", program, installed.packages)
    origins = json.loads(installed.run(*command, given=json.dumps(modules)))
    assert origins == [str(installed.packages / file) for file in files]


@on_posix
def test_the_page_serves_every_file_and_no_other_is_asked_for(start, product, tiny, tmp_path):
    options = ("--no-browser", "--no-token", "--port", 0, "--workspace", tmp_path / "w")
    server = start("label", tiny.path, *options)
    found = server.until(lambda: re.search(r"http://\S+", server.said()))
    (index,) = (path for path in product if path.endswith("/static/index.html"))
    folder = index.removesuffix("index.html")
    files = {
        "/static/" + path.removeprefix(folder): file
        for path, file in product.items()
        if path.startswith(folder)
    }
    kinds = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
    asked = set()
    for url, file in {**files, "/": product[index]}.items():
        with urlopen(urljoin(found[0], url), timeout=MAX_S) as answer:
            assert (answer.status, answer.read()) == (200, file.read_bytes()), url
        text = file.read_text("utf-8")
        if file.suffix in kinds:
            assert answer.headers.get_content_type() == kinds[file.suffix], url
        if file.suffix == ".html":
            asked.update(re.findall(r'\b(?:src|href)="(/[^"]*)"', text))
        if file.suffix == ".js":
            modules = MODULE.findall(COMMENT.sub("", text))
            asked.update(urljoin(url, FILLED_IN.sub("*", one)) for one in modules)
    del files["/static/index.html"]  # asked for as /
    assert [url for url in sorted(asked) if not any(fnmatch(one, url) for one in files)] == []
    assert [one for one in sorted(files) if not any(fnmatch(one, url) for url in asked)] == []
    server.end(signal.SIGINT)


@on_posix
def test_a_watched_run_that_is_killed_is_back(start, tiny, tiny_bundle, tmp_path):
    log, rated = tmp_path / "log.jsonl", ("--source", tiny.path, "--rate", 10)
    dog = start("run", "--watchdog", "--bundle", tiny_bundle, *rated, "--log", log)
    dog.until(lambda: _lines(log))
    (runtime,) = psutil.Process(dog.process.pid).children()
    runtime.kill()
    dog.until(lambda: len({line["run"] for line in _lines(log)}) == 2)
    assert "signal 9; started again (1)" in dog.said()
    dog.end()


@on_posix
def test_a_camera_s_process_sends_its_pictures(installed, start, tiny_bundle, tmp_path):
    pytest.importorskip("harvesters")
    genicam = pytest.importorskip("genicam")  # brings a producer with simulated cameras
    log, rig = tmp_path / "log.jsonl", ("--source", "genicam:0", "--camera-rate", 20)
    producers = str(Path(genicam.__file__).parent)
    command = ("run", *rig, "--bundle", tiny_bundle, "--log", log)
    run = start(*command, GENICAM_GENTL64_PATH=producers)
    run.until(lambda: [line for line in _lines(log) if isinstance(line.get("left"), str)])
    (camera,) = psutil.Process(run.process.pid).children()
    assert camera in installed.processes()
    run.end(signal.SIGTERM)
