"""The program `tokt` in a process of its own, ended with the block."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from tokt.features.common.errors import ToktError

_ADDRESS = re.compile(r"http://\S+")
_END_S = 20


@contextmanager
def program(
    *arguments: object,
    said: Path,
    start: Sequence[object] = ("-m", "tokt"),
    env: Mapping[str, str] | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """Start ``tokt`` with some arguments; `said` gets what it writes to standard error."""
    command = [sys.executable, *map(str, (*start, *arguments))]
    with said.open("wb") as sink:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sink, text=True, env=env)
    with process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT if sys.platform != "win32" else signal.SIGTERM)
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()


def ended(name: str, process: subprocess.Popen[str], said: Path) -> ToktError:
    """The error of a program that ended too soon, or hangs, with the last line it wrote."""
    last = (said.read_text("utf-8", "replace").strip().splitlines() or ["it said nothing"])[-1]
    with suppress(subprocess.TimeoutExpired):
        process.wait(_END_S)
    how = "hangs" if process.returncode is None else f"ended with {process.returncode}"
    return ToktError(f"tokt {name} {how}: {last}")


@contextmanager
def label_server(mission: Path, workspace: Path, *options: object) -> Iterator[str]:
    """Start the labelling page's server on a free port and yield its address once it answers.

    Raises ToktError with the last line it wrote if it ends before it answers.
    """
    workspace.mkdir(parents=True, exist_ok=True)
    said = workspace / "server-errors.txt"
    more = ("--no-browser", "--no-token", "--port", 0, "--workspace", workspace, *options)
    with program("label", mission, *more, said=said) as process:
        found = next(filter(None, map(_ADDRESS.search, process.stdout or ())), None)
        if found is None:
            raise ended("label", process, said)
        yield found[0]
