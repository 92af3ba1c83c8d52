"""Calls of the command line, calls that must be refused, and Python programs run in processes."""

import io
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import Any

import pytest

from tests.waiting import MAX_S
from tokt.cli.app import main
from tokt.features.common.errors import ToktError


@dataclass(frozen=True)
class Ran:
    """How a command ended."""

    code: int
    out: str
    err: str


def call_tokt(*arguments: object, program: Callable[[], None] = main) -> Ran:
    """Run the command line in this process."""
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["tokt", *map(str, arguments)]
    try:
        with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
            program()
    finally:
        sys.argv = before
    code = ended.value.code
    return Ran(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


def succeeds(*arguments: object) -> Ran:
    """Run the command line in this process to a normal end."""
    ran = call_tokt(*arguments)
    assert ran.code == 0, ran.err
    return ran


def refused(words: str, *arguments: object) -> str:
    """Run the command line, which must fail and say why in its last line; all that it said."""
    ran = call_tokt(*arguments)
    assert (ran.code, ran.out) == (2, "") and words in ran.err, (ran.out, ran.err)
    assert ran.err.splitlines()[-1].startswith("tokt: error: ")
    assert "Traceback" not in ran.err
    return ran.err


def refuses(words: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """Call what must raise a ToktError of one line with `words` in it, or with any; that line."""
    with pytest.raises(ToktError, match=words or None) as caught:
        call(*arguments, **options)
    line = str(caught.value)
    assert "\n" not in line, line
    return line


@contextmanager
def answering(program: str, *arguments: object) -> Iterator[Callable[[object], str]]:
    """A Python program in a process, which has said ``ready``: a line to it gives its answer."""
    with subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ) as process:
        assert process.stdin and process.stdout and process.stdout.readline() == "ready\n"

        def ask(line: object) -> str:
            assert process.stdin and process.stdout
            process.stdin.write(f"{line}\n")
            process.stdin.flush()
            return process.stdout.readline().strip()

        yield ask
        process.stdin.close()


def free_port() -> int:
    """A port of this machine that nothing listens to."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def run_python(*arguments, folder=None, **environment):
    """Run ``python ARGUMENTS`` in a folder, with more in its environment, to its end."""
    command, where = [sys.executable, *map(str, arguments)], {**os.environ, **environment}
    # Some work for a minute where nothing runs beside them.
    how = {"capture_output": True, "text": True, "timeout": 10 * MAX_S, "check": False}
    return subprocess.run(command, cwd=folder, env=where, **how)
