"""Build, describe and test what is published: an sdist and wheels, the same bytes each time.

The wheel of tokt-studies is built beside those of tokt, from the same commit.
"""

import argparse
import gzip
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WHEEL_TESTS = ("process/test_wheel.py", "process/test_slim_install.py")
KERNEL_TESTS = ("features/kernels", "models/bundle")
"""For the wheel with compiled kernels: all other files are the same in the one without."""
NO_COMPILER = {"CC": "false"}


def run(*command: object, cwd: Path = ROOT, **environ: str) -> str:
    """What a command prints; a failure of it ends this program."""
    words = [str(word) for word in command]
    print("--", *words, file=sys.stderr)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    how = {"cwd": cwd, "env": os.environ | {"PATH": path} | environ, "stdout": subprocess.PIPE}
    return subprocess.run(words, text=True, check=True, **how).stdout


def pip(python: Path, *arguments: object, constraints: Path = ROOT / "constraints.txt") -> None:
    """Install for another Python, in the versions that the tests ran with; by uv if it is there."""
    words: tuple[object, ...] = ("uv", "pip", "install", "--python", python)
    if shutil.which("uv") is None:
        words = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python)
        words += ("install", "--no-compile")
    run(*words, "--quiet", "-c", constraints, *arguments)


def build(out: Path) -> None:
    """Build the last commit's sdist, and from it a wheel with and one without compiled kernels."""
    os.umask(0o022)
    when = run("git", "log", "-1", "--format=%ct").strip()
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run("git", "clone", "--quiet", ROOT, folder / "checkout")
        pack = (sys.executable, "-m", "build", "--no-isolation", "--outdir", folder)
        run(*pack, "--sdist", folder / "checkout", SOURCE_DATE_EPOCH=when)
        (sdist,) = folder.glob("*.tar.gz")
        pack_again(sdist, out / sdist.name, int(when))
        for environ in ({}, NO_COMPILER):
            with tempfile.TemporaryDirectory(dir=folder) as sources:
                shutil.unpack_archive(out / sdist.name, sources)
                (unpacked,) = Path(sources).iterdir()
                run(*pack, "--wheel", unpacked, SOURCE_DATE_EPOCH=when, **environ)
        run(*pack, "--wheel", folder / "checkout/studies", SOURCE_DATE_EPOCH=when)
        for wheel in folder.glob("*.whl"):
            if "-linux_" in wheel.name:
                # Under the oldest manylinux tag that what it links to allows.
                repair = (sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", out)
                run(*repair, wheel, SOURCE_DATE_EPOCH=when)
            else:
                (out / wheel.name).write_bytes(wheel.read_bytes())


def pack_again(sdist: Path, target: Path, when: int) -> None:
    """Write an sdist without what differs between builds: owners, times, order."""
    with (
        tarfile.open(sdist) as archive,
        target.open("wb") as raw,
        gzip.GzipFile("", "wb", fileobj=raw, mtime=when) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as again,
    ):
        for member in sorted(archive.getmembers(), key=lambda one: one.name):
            content = archive.extractfile(member) if member.isfile() else None
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            member.mtime, member.pax_headers = when, {}
            member.uid = member.gid = 0
            member.uname = member.gname = ""
            again.addfile(member, content)


def describe(out: Path) -> None:
    """Write the SBOM and the licences of a wheel with all its extras, and the hashes of all."""
    wheel = next(out.glob("tokt-*-none-any.whl"))
    version = wheel.name.split("-")[1]
    name = f"tokt-{version}"
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder)
        python = Path(folder, "bin/python")
        pip(python, f"{wheel}[all]")
        words = ("--output-reproducible", "--pyproject", ROOT / "pyproject.toml", python)
        sbom = json.loads(run(sys.executable, "-m", "cyclonedx_py", "environment", *words))
        sbom["metadata"]["component"]["version"] = version  # it is not in pyproject.toml
        (out / f"{name}.cdx.json").write_text(json.dumps(sbom, indent=1))
        words = ("--format=markdown", "--with-urls", "--order=license")
        (out / f"{name}.licenses.md").write_text(run("pip-licenses", "--python", python, *words))
    studies = out.glob(f"tokt_studies-{version}-*.whl")
    files = sorted(file for file in [*out.glob(f"{name}*"), *studies] if file.is_file())
    lines = [f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}" for file in files]
    (out / "SHA256SUMS").write_text("\n".join([*lines, ""]))


def test(wheels: list[Path]) -> None:
    """Run the tests that a wheel must pass on each wheel, which stands before this checkout."""
    where = "import tokt; print(tokt.__file__)"
    words = ("-m", "pytest", "-q", "-n", "2", "--dist", "loadgroup", "--hypothesis-profile=quick")
    for wheel in wheels:
        kernel_tests = () if wheel.name.endswith("-none-any.whl") else KERNEL_TESTS
        files = [f"tests/{test}" for test in (*kernel_tests, *WHEEL_TESTS)]
        with tempfile.TemporaryDirectory() as folder:
            pip(Path(sys.executable), "--no-deps", "--target", folder, wheel)
            environ = {"TOKT_WHEEL": str(wheel), "PYTHONPATH": folder}
            imported = run(sys.executable, "-c", where, **environ).strip()
            if not Path(imported).is_relative_to(folder):
                sys.exit(f"the tests of {wheel.name} would import {imported}")
            print(wheel.name, run(sys.executable, *words, *files, **environ), sep="\n")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name, function in (("build", build), ("describe", describe)):
        command = commands.add_parser(name, help=function.__doc__)
        command.add_argument("--out", type=Path, default=ROOT / "dist")
    command = commands.add_parser("test", help=test.__doc__)
    command.add_argument("wheels", type=lambda name: Path(name).resolve(), nargs="+")
    given = vars(parser.parse_args())
    command = {"build": build, "describe": describe, "test": test}[given.pop("command")]
    try:
        command(**given)
    except subprocess.CalledProcessError as error:
        sys.exit(error.stdout or str(error))


if __name__ == "__main__":
    main()
