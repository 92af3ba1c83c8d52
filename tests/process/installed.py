"""A fresh environment with nothing of tokt but its wheel, and commands that run in it."""

import os
import subprocess
import sys
import venv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from tests.waiting import MAX_S, until


@dataclass(frozen=True)
class Started:
    process: subprocess.Popen[bytes]
    words: Path

    def said(self) -> str:
        return self.words.read_text("utf-8")

    def until(self, true: Callable[[], Any]) -> Any:
        """Wait until something is true, as it must be before the command ends; what it is."""

        def found() -> Any:
            assert self.process.poll() is None, self.said()
            return true()

        return until(found, self.said)

    def end(self, number: int | None = None) -> None:
        """Wait for a normal end, having asked for it with a signal or not."""
        if number is not None:
            self.process.send_signal(number)
        assert self.process.wait(MAX_S) == 0, self.said()


def _environ() -> dict[str, str]:
    return {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}


def fresh_python(home: Path, wheel: Path, *options: object) -> Path:
    """The Python of a new environment in which pip has installed a wheel."""
    venv.create(home)
    python = home / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
    # Of the installed modules only those are compiled that are imported.
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", python)
    command = map(str, (*pip, "install", "--quiet", "--no-compile", *options, wheel))
    done = subprocess.run([*command], capture_output=True, text=True, cwd=home, env=_environ())
    if "No matching distribution" in done.stderr:
        pytest.skip("no package index can be reached to make a fresh environment")
    assert done.returncode == 0, done.stderr
    return python


class Installed:
    """An environment of its own with the wheel; the tests' packages are found after it."""

    def __init__(self, wheel: Path, home: Path) -> None:
        self.python = fresh_python(home, wheel, "--no-deps")
        words = "import sysconfig; print(sysconfig.get_path('purelib'))"
        self.packages = Path(self.run(self.python, "-c", words).strip())
        # Their .pth files do not count here: no editable install comes along.
        names = ("site-packages", "dist-packages")
        others = [path for path in sys.path if Path(path).name in names]
        (self.packages / "others.pth").write_text("\n".join(others))

    def run(self, *command: object, given: str = "") -> str:
        how = {"capture_output": True, "text": True, "timeout": MAX_S, "check": False}
        where = {"cwd": self.python.parent, "env": _environ()}  # outside of the checkout
        done = subprocess.run([str(part) for part in command], input=given, **how, **where)
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self, folder: Path, words: Path, *arguments: object, **environ: str) -> Started:
        with words.open("wb") as sink:
            command = [self.python.with_stem("tokt"), *map(str, arguments)]
            where = {"cwd": folder, "env": {**_environ(), **environ}}
            process = subprocess.Popen(command, stdout=sink, stderr=sink, **where)
        return Started(process, words)

    def processes(self) -> list[psutil.Process]:
        """What runs on this environment's Python, be it by an emulator."""
        named = [(one, one.info["cmdline"] or [""]) for one in psutil.process_iter(["cmdline"])]
        return [one for one, command in named if str(self.python) in command]
