"""The wheel holds what git holds, and what it starts in processes of their own runs from it.

An editable install hides what a wheel lacks: it finds every file of the checkout.
"""

import json
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from fnmatch import fnmatch
from functools import partial
from pathlib import Path, PurePosixPath
from urllib.parse import urljoin
from urllib.request import urlopen

import psutil
import pytest

from tests.calls import run_python
from tests.waiting import MAX_S

from .installed import Installed

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]
EXTENSION_SOURCES = (".pyx", ".h", ".c")
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)  # types are imported in comments
# What scripts import and export, at once or later; what a template fills in is any text.
MODULE = re.compile(r"""\b(?:from|import)\b[\s(]*["'`](\.{0,2}/[^"'`]+)["'`]""")
FILLED_IN = re.compile(r"\$\{[^}]*\}")

pytestmark = pytest.mark.xdist_group("wheel")  # it is built once
on_posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")


def _import_path(name):
    """Where a file of the checkout belongs in the wheel; None for one outside of the product."""
    folder = PurePosixPath(name).parts[0]
    if (ROOT / "src/tokt" / folder).is_symlink():
        return f"tokt/{name}"
    return name.removeprefix("src/") if folder == "src" else None


@pytest.fixture(scope="module")
def product(git_files):
    if not git_files:
        pytest.skip("not a git checkout")
    # The scripts' types are for editors: the sdist holds them.
    placed = {_import_path(name): ROOT / name for name in git_files if not name.endswith(".d.ts")}
    return {path: file for path, file in placed.items() if path and not file.is_symlink()}


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


def test_without_a_compiler_a_wheel_is_for_all_platforms(wheel, sources, tmp_path):
    """Though one with compiled kernels was built before in the same folder."""
    command = ("-m", "pip", "wheel", "--verbose", "--no-build-isolation", "--no-deps")
    environ = {"CC": "false", "TOKT_REPOSITORY": "https://example.org/tokt"}
    done = run_python(*command, "--wheel-dir", tmp_path, sources, **environ)
    assert done.returncode == 0, done.stderr
    assert "no compiler: the wheel has numpy's kernels alone" in done.stdout + done.stderr
    (made,) = tmp_path.glob("*.whl")
    assert made.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(made) as archive:
        assert not [name for name in archive.namelist() if name.endswith((".so", ".pyd"))]
        (about,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        page = archive.read(about).decode()
    assert "![" in page and "](https://example.org/tokt/raw/HEAD/docs/pictures/" in page
    links = re.findall(r"\]\(([^)]+)\)", page)
    files = [link.removeprefix("https://example.org/tokt/").split("/", 2)[2] for link in links]
    assert len(files) > 10 and all((ROOT / file).is_file() for file in files)
    assert "Project-URL: Changelog, https://example.org/tokt/blob/HEAD/CHANGELOG.md" in page


def git(folder, *words):
    who = ("-c", "user.name=tests", "-c", "user.email=tests@example.org")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


def checked_in(sources, folder):
    shutil.copytree(sources, folder, symlinks=True)
    for words in (("init", "--quiet"), ("add", "--all"), ("commit", "--quiet", "-m", "all")):
        git(folder, *words)
    return folder


def test_an_sdist_holds_every_file_once(sources, product, tmp_path):
    """`make wheels` builds what is published from it."""
    checkout = checked_in(sources, tmp_path / "checkout")
    program = f"import setuptools.build_meta as b; print(b.build_sdist({str(tmp_path)!r}))"
    assert run_python("-c", program, folder=checkout).returncode == 0
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = ["/".join(one.name.split("/")[1:]) for one in archive.getmembers() if one.isfile()]
    assert len(names) == len({*names})
    assert [path for path in product if f"src/{path}" not in names] == []
    assert "src/tokt/labels/page/static/core/types.d.ts" in names
    folders = {path.name for path in (ROOT / "src/tokt").iterdir() if path.is_symlink()}
    assert len(folders) == 5 and {name.split("/")[0] for name in names}.isdisjoint(folders)


def test_a_checkout_without_links_says_how_to_get_them(sources, tmp_path):
    """As git makes it on Windows by default: a link is a text file."""
    checked_in(sources, tmp_path / "origin")
    git(tmp_path, "clone", "--quiet", "-c", "core.symlinks=false", "origin", "plain")
    version = partial(run_python, "setup.py", "--version", folder=tmp_path / "plain")
    said = version()
    assert said.returncode == 1 and said.stdout == "" and said.stderr.count("\n") == 1
    assert said.stderr.startswith("tokt: error: ") and "is a text file, not a link" in said.stderr
    for command in re.findall("`git (.*?)`", said.stderr):
        git(tmp_path / "plain", *command.split())
    assert version().returncode == 0


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
