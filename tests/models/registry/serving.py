"""MLflow's servers, each in a process of its own on a free loopback port."""

import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.calls import free_port
from tests.waiting import until


@contextmanager
def mlflow_serves(folder: Path, health: str, *words: object, **environ: str) -> Iterator[str]:
    """Run ``mlflow WORDS`` in a folder until the block ends; its address, once `health` answers."""
    url, log = f"http://127.0.0.1:{(port := free_port())}", folder / "log"
    where = ("--host", "127.0.0.1", "--port", str(port))
    command = [sys.executable, "-m", "mlflow", *map(str, words), *where]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"  # uvicorn's
    environ = {**os.environ, "MLFLOW_DISABLE_TELEMETRY": "true", "PATH": path, **environ}
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, env=environ, cwd=folder, stdout=out, stderr=out, start_new_session=True
        )

    def answers() -> bool:
        assert process.poll() is None, log.read_text()
        with suppress(OSError), urllib.request.urlopen(url + health, timeout=2) as answer:
            return bool(answer.status == 200)
        return False

    try:
        until(answers, log.read_text)
        yield url
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)  # it and its worker, of this session only
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait(10)
