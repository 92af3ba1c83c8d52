"""Programs of tokt in forked children of one process, which has imported already what they need.

Starting Python and importing a server or a training takes a second or two of a processor, a fork
some milliseconds. A child has its own memory, signals, standard streams, environment and folder:
for a test it is a process like any other.
"""

import array
import json
import os
import select
import signal
import socket
import subprocess
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, Any

TOKT = "from tokt.cli import main; main()"
LONGEST_REQUEST = 1 << 17
"""Bytes: arguments and an environment; Linux hands over somewhat more in one message."""


class ForkedProcess:
    """A forked child, with what tests use of `subprocess.Popen`; its streams are text.

    Parameters
    ----------
    pid : int
    status : int
        File descriptor from which its wait status can be read once it has ended.
    stdout, stderr : text file
    """

    def __init__(self, pid: int, status: int, stdout: IO[str], stderr: IO[str]) -> None:
        self.pid, self.stdout, self.stderr = pid, stdout, stderr
        self.returncode: int | None = None
        self._status = status

    def poll(self) -> int | None:
        """Exit code, or minus the signal that ended it; None while it runs."""
        return self._ended_within(0)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; `subprocess.TimeoutExpired` where that takes too many seconds."""
        code = self._ended_within(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it ends just now
                os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def _ended_within(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], timeout)[0]:
            said = os.read(self._status, 16)
            os.close(self._status)
            # Without a word the process that forked it is gone.
            self.returncode = os.waitstatus_to_exitcode(int(said)) if said else -signal.SIGKILL
        return self.returncode


class ForkHost:
    """The process that forks.

    Parameters
    ----------
    imports : str
        Python that imports what the programs need.
    program : str
        Python that a child runs, with its words in `sys.argv`.
    """

    def __init__(self, imports: str, program: str = TOKT) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        words = (sys.executable, "-u", __file__, str(theirs.fileno()), imports, program)
        with theirs:
            self._process = subprocess.Popen(words, pass_fds=[theirs.fileno()])
        self._socket.recv(16)  # it has imported all: what it runs is not slower the first time

    def start(self, *words: object) -> ForkedProcess:
        """Run the program with these words, in this process's folder and environment."""
        here = {"folder": str(Path.cwd()), "environ": dict(os.environ)}
        request = {"words": [*map(str, words)], **here}
        pipes = [os.pipe() for _ in range(3)]
        out, err, status = (end for end, _ in pipes)
        theirs = array.array("i", [end for _, end in pipes])
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, theirs)]
        self._socket.sendmsg([json.dumps(request).encode()], rights)
        for end in theirs:
            os.close(end)
        pid = int(self._socket.recv(16))
        return ForkedProcess(pid, status, os.fdopen(out, "r"), os.fdopen(err, "r"))

    def close(self) -> None:
        """End the process that forks; its children go on."""
        self._socket.close()
        self._process.wait()


def _fork_until_closed(connection: socket.socket) -> dict[str, Any] | None:
    """Fork a child for each request; in a child, what was requested. None at the end."""
    ended, wakes = os.pipe()
    os.set_blocking(wakes, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wakes)
    statuses: dict[int, int] = {}
    connection.send(b"ready")
    while True:
        ready, _, _ = select.select([connection, ended], [], [])
        if ended in ready:
            os.read(ended, 4096)
            for pid in [*statuses]:
                gone, status = os.waitpid(pid, os.WNOHANG)
                if gone:
                    os.write(statuses[pid], str(status).encode())
                    os.close(statuses.pop(pid))
        if connection in ready:
            request, fds, _, _ = socket.recv_fds(connection, LONGEST_REQUEST, 3)
            if not request:
                return None
            out, err, status = fds
            if pid := os.fork():
                statuses[pid] = status
                connection.send(str(pid).encode())
                for fd in (out, err):
                    os.close(fd)
                continue
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            os.dup2(out, 1)
            os.dup2(err, 2)
            for fd in (out, err, status, ended, wakes, *statuses.values()):
                os.close(fd)
            return dict(json.loads(request))


def _main() -> None:
    exec(sys.argv[2], {})
    with closing(socket.socket(fileno=int(sys.argv[1]))) as connection:
        request = _fork_until_closed(connection)
    if request is not None:
        os.environ.clear()
        os.environ.update(request["environ"])
        os.chdir(request["folder"])
        program, sys.argv = sys.argv[3], ["tokt", *request["words"]]
        exec(program, {})


if __name__ == "__main__":
    _main()
