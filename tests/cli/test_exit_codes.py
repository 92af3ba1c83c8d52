"""How a command ends when something is wrong that is no mistake of the user's."""

import os
import sys
import tempfile

import pytest
import typer

from tests.calls import call_tokt
from tests.inference.test_faults import hold_row
from tokt.cli.app import run_app
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.watchdog import Notifier, Watchdog

DIES_ONCE = """
import pathlib, sys
from tokt.cli.app import run_app
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.monitoring.watchdog import Notifier

def run(standalone_mode):
    if not pathlib.Path("been").exists():
        pathlib.Path("been").touch()
        raise RuntimeError("nobody thought of it")
    Notifier(SYSTEM_CLOCK).stopping()

run_app(run)
"""


def ends_with(error):
    """A command that raises it, run to its end."""

    def command():
        raise error

    app = typer.Typer()
    app.command("doctor")(command)
    return call_tokt(program=lambda: run_app(app))


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    "error",
    [
        ValueError("a\nb\x1b[2J"),
        ModuleNotFoundError("x", name="x"),
        MemoryError(),
        UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad \udc80"),
        OSError("no number"),
    ],
)
def test_an_unexpected_error_is_one_line_and_a_file_with_the_traceback(error, temporary):
    ran = ends_with(error)
    (file,) = temporary.iterdir()
    assert (ran.code, ran.out, ran.err.count("\n")) == (70, "", 1)
    assert f" report it: {type(error).__name__}" in ran.err
    assert ran.err.endswith(f"; the traceback is in {file}\n") and "\x1b" not in ran.err
    assert f"-{os.getpid()}-" in file.name
    text = file.read_text()
    assert text.startswith("Traceback") and "raise error" in text


def test_without_room_for_the_file_it_is_still_one_line(temporary):
    temporary.rmdir()
    ran = ends_with(KeyError("x"))
    assert (ran.code, ran.err.count("\n")) == (70, 1)
    assert ran.err.endswith(
        "KeyError: 'x'; the traceback cannot be written: No such file or directory\n"
    )
    ends = "one line and exit code 70, without the traceback; back with the same model"
    hold_row("an error nobody thought of, and no room for its traceback", ends, "restarts +1")


@pytest.mark.parametrize("year", [2016, 2999])
def test_what_dies_again_and_again_does_not_fill_the_disk(year, temporary):
    """Nor where the clock was set back since."""
    others = temporary / "tokt-other.txt"
    others.touch()
    for day in range(30):
        (temporary / f"tokt-traceback-{year}01{day:02}-000000-1-x.txt").touch()
    said = ends_with(KeyError("x")).err
    kept = sorted(path.name for path in temporary.iterdir())
    assert len(kept) == 21 and others.name in kept
    (new,) = (name for name in kept if f"-{os.getpid()}-" in name)
    assert said.endswith(f"; the traceback is in {temporary / new}\n")


@pytest.mark.parametrize(
    ("error", "code"), [(typer.Abort(), 130), (KeyboardInterrupt(), 130), (typer.Exit(1), 1)]
)
def test_other_ends_leave_no_file(error, code, temporary):
    ran = ends_with(error)
    assert (ran.code, ran.err, [*temporary.iterdir()]) == (code, "", [])


@pytest.mark.process
def test_the_watchdog_starts_it_again(temporary, monkeypatch, capfd):
    monkeypatch.chdir(temporary)
    monkeypatch.setenv("TMPDIR", str(temporary))
    said = []
    command = [sys.executable, "-c", DIES_ONCE]
    dog = Watchdog(command, said.append, Notifier(SYSTEM_CLOCK, {}))
    assert (dog.run(), dog.restarts) == (0, 1)
    assert said == ["the runtime ended with exit code 70; started again (1)"]
    (file,) = temporary.glob("tokt-traceback-*")
    assert "nobody thought of it" in file.read_text() and file.name in capfd.readouterr().err
    ends = "one line and exit code 70, the traceback in a file; back with the same model"
    hold_row("an error nobody thought of ends the runtime", ends, "restarts +1")
