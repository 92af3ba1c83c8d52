"""Jobs: commands of `tokt` that run beside the page, one job at a time."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from tokt.features.common.errors import ToktError, os_errors_as

RUNNING, DONE, FAILED, CANCELLED = "running", "done", "failed", "cancelled"
GRACE_S = 1.5
"""How long a command that is cancelled may put away what it began."""
_NICE = 10
_LINES, _LONG, _RESULT = 30, 2000, 5
_PROGRESS = re.compile(r"(.+): (\d+)/(\d+)(?:, about .*)?")
_ERROR = "tokt: error: "


@dataclass
class Job:
    """One job: commands, one after the other; and the last lines that they printed."""

    what: str
    steps: int
    step: int = 1  # the one that is running
    state: str = RUNNING
    progress: dict[str, Any] | None = None
    error: str = ""
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=_LINES))
    result: list[str] = field(default_factory=list)  # the last lines of the step that found it
    said: deque[str] = field(default_factory=lambda: deque(maxlen=_RESULT))  # by this step

    def hear(self, line: str) -> None:
        """Take in a line that the command printed."""
        self.lines.append(line[:_LONG])
        if found := _PROGRESS.fullmatch(line):
            self.progress = {"what": found[1], "done": int(found[2]), "total": int(found[3])}
        elif line:
            self.said.append(line[:_LONG])

    def end_step(self, command: str) -> None:
        """Keep what the step said; an export only says where its file is."""
        if command != "export":
            self.result = list(self.said)
        self.said.clear()

    def to_json(self) -> dict[str, Any]:
        """All but what was printed, as pages get it."""
        names = ("what", "steps", "step", "state", "progress", "error")
        return {name: getattr(self, name) for name in names}


class Jobs:
    """Runs one job at a time, and keeps the last one. For any thread."""

    def __init__(self) -> None:
        self.last: Job | None = None
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[str] | None = None

    def start(self, what: str, commands: Sequence[Sequence[str]], then: Callable[[], None]) -> None:
        """Run commands of `tokt` in a thread, then `then`; ToktError while another job runs."""
        with self._lock:
            if self.last is not None and self.last.state == RUNNING:
                raise ToktError("a job is running already: wait for it, or cancel it")
            self.last = Job(what, len(commands))
            run = (self.last, commands, then)
            self._thread = threading.Thread(
                target=self._run, args=run, name="tokt-job", daemon=True
            )
            self._thread.start()

    def cancel(self) -> None:
        """End the job that is running, and whatever it started; nothing half-written stays."""
        with self._lock:
            if self.last is None or self.last.state != RUNNING:
                return
            self.last.state, process = CANCELLED, self._process
        if process is not None:
            _end(process)

    def close(self) -> None:
        """Cancel, and wait."""
        self.cancel()
        if self._thread is not None:
            self._thread.join()

    def _run(self, job: Job, commands: Sequence[Sequence[str]], then: Callable[[], None]) -> None:
        error = "a fault in tokt label; what it printed in the terminal says more"
        try:
            for job.step, words in enumerate(commands, 1):
                self._run_one(job, words)
                job.end_step(words[0])
            if job.state == RUNNING:  # nobody cancelled it in the last moment
                then()
            error = ""
        except ToktError as said:
            error = str(said)
        finally:
            with self._lock:
                self._process = None
                if job.state == RUNNING:
                    job.error, job.state = error, FAILED if error else DONE

    def _run_one(self, job: Job, words: Sequence[str]) -> None:
        with self._lock, os_errors_as(f"tokt {words[0]}"):
            if job.state != RUNNING:
                raise ToktError(job.state)
            job.progress = None
            # A group of its own: Ctrl-C in the terminal is the server's, which then cancels.
            process = self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tokt", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                errors="replace",
                env={**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8"},
                start_new_session=True,
            )
        if sys.platform != "win32":
            with suppress(OSError):  # it ended already
                os.setpriority(os.PRIO_PGRP, process.pid, _NICE)
        with process:
            for line in process.stdout or ():
                job.hear(line.rstrip())
        if process.returncode:
            told = [line for line in job.lines if line.startswith(_ERROR)] or list(job.lines)
            said = told[-1].removeprefix(_ERROR) if told else f"ended with {process.returncode}"
            raise ToktError(said)


def _end(process: subprocess.Popen[str]) -> None:
    if sys.platform == "win32":
        process.terminate()
        return
    with suppress(ProcessLookupError, subprocess.TimeoutExpired):
        os.killpg(process.pid, signal.SIGINT)
        process.wait(GRACE_S)
    with suppress(ProcessLookupError):  # what it started and left
        os.killpg(process.pid, signal.SIGKILL)
