"""The sdist holds every file once; wheels are built from any checkout, or it is said why not."""

import re
import shutil
import subprocess
import tarfile
import zipfile
from functools import partial

from tests.calls import run_python
from tests.fixtures import ROOT


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
