"""A real `tokt label` process on a free port of this computer, ended with the block."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tokt.features.common.errors import ToktError

_ADDRESS = re.compile(r"http://\S+")
_END_S = 20


@contextmanager
def label_server(mission: Path, workspace: Path, options: Sequence[str] = ()) -> Iterator[str]:
    """Start the labelling page's server and yield its address once it answers.

    Parameters
    ----------
    mission, workspace : Path
    options : sequence of str
        Further options of ``tokt label``.

    Raises
    ------
    ToktError
        If it ends before it answers; with the last line it wrote.
    """
    errors = workspace / "server-errors.txt"
    workspace.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "tokt", "label", str(mission), "--no-browser", "--port", "0"]
    command += ["--workspace", str(workspace), *options]
    with errors.open("wb") as sink:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sink, text=True)
    try:
        yield _address(process, errors)
    finally:
        _end(process)


def _address(process: subprocess.Popen[str], errors: Path) -> str:
    for line in process.stdout or ():
        found = _ADDRESS.search(line)
        if found:
            return found[0]
    last = (errors.read_text("utf-8", "replace").strip().splitlines() or ["it said nothing"])[-1]
    raise ToktError(f"tokt label ended with {process.wait(_END_S)}: {last}")


def _end(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT if sys.platform != "win32" else signal.SIGTERM)
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
