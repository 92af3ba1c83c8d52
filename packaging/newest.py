"""Try the newest versions of all dependencies, and print which of them break which tests."""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from wheels import ROOT, pip, run

(QUICK,) = re.findall(r"^QUICK := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
PINS = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE))


def packages(python: Path, *options: str) -> dict[str, str]:
    """Installed packages and their versions; with ``--outdated`` the newest that is left out."""
    words = ("-m", "pip", "--disable-pip-version-check", "--python", python, "list")
    found = json.loads(run(sys.executable, *words, "--format=json", *options))
    return {one["name"]: one.get("latest_version", one["version"]) for one in found}


def failures(python: Path, *tests: str) -> list[str]:
    """The tests that fail: these, or those of `make test`."""
    words = ("-m", "pytest", "-q", "--tb=no", "-rfE", "-p", "no:cacheprovider")
    words += tests or ("-m", QUICK, "-n", "2", "--dist", "loadgroup")
    command = [str(word) for word in (python, *words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        sys.exit(f"the tests did not run:\n{done.stdout}{done.stderr}")
    return re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)


def environment(folder: Path, constraints: Path) -> Path:
    """A fresh environment's Python, with tokt and all that its tests need."""
    run(sys.executable, "-m", "venv", "--clear", folder)
    python = folder / "bin/python"
    pip(python, f"{ROOT}[all,dev]", ROOT / "studies", constraints=constraints)
    return python


def write(constraints: Path, versions: dict[str, str]) -> None:
    """Write the versions that are to be installed."""
    constraints.write_text("".join(f"{name}=={versions[name]}\n" for name in versions))


def main() -> None:
    """Print what is newer, then for what fails each package that alone makes it fail."""
    with tempfile.TemporaryDirectory() as name:
        folder, constraints = Path(name), Path(name, "constraints.txt")
        constraints.touch()
        python = environment(folder / "all", constraints)
        newer = {
            package: version
            for package, version in packages(python).items()
            if package not in ("pip", "tokt", "tokt-studies") and PINS.get(package) != version
        }
        for package, version in newer.items():
            print(f"newer: {package} {PINS.get(package, 'not pinned')} -> {version}")
        for package, version in packages(python, "--outdated").items():
            print(f"held back by a bound: {package}, newest {version}")
        failed = failures(python)
        if failed:
            write(constraints, PINS)
            before = failures(environment(folder / "one", constraints), *failed)
            failed = [test for test in failed if test not in before]
        print(f"{len(failed)} tests fail with all of them alone", *failed, sep="\n  ")
        for package, version in newer.items() if failed else ():
            write(constraints, PINS | {package: version})
            try:
                alone = failures(environment(folder / "one", constraints), *failed)
            except subprocess.CalledProcessError:
                print(f"{package} {version}: cannot be installed with the others as pinned")
            else:
                print(f"{package} {version}: breaks {len(alone)}", *alone, sep="\n  ")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
