"""A watchdog: a process that starts the runtime, and starts it again when it dies or hangs.

What systemd does with docs/tokt.service, for a PC without systemd.
"""

import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TextIO

from tokt.features.common.errors import os_words
from tokt.inference.clock import Clock

if sys.platform == "win32":
    import msvcrt

SYSTEMD_VARIABLE = "NOTIFY_SOCKET"
WATCHDOG_VARIABLE = "TOKT_WATCHDOG"
"""The pipe by which the runtime tells its watchdog that it lives: an inherited file descriptor, on
Windows a handle. Nobody else can write to it."""

LENGTH = struct.Struct(">Q")
"""Bytes of what the run began with, which follows on the runtime's standard input."""

READY, ALIVE, STOPPING = b"READY=1", b"WATCHDOG=1", b"STOPPING=1"

EVERY_S = 0.2
"""Seconds between two signs of life, however fast the loop goes."""
_STDIN, _PIECE_BYTES = 0, 4096


def restarts() -> int:
    """Return how often a watchdog has started this run again."""
    return int(os.environ.get(RESTARTS_VARIABLE, "0"))


class Notifier:
    """Signs of life of this process; none where nobody asked for them.

    The words are those of systemd's ``sd_notify`` (READY=1, WATCHDOG=1, STOPPING=1): one datagram
    each to the socket that ``NOTIFY_SOCKET`` names, or a line each to the pipe of
    ``tokt run --watchdog``, which runs where there is no systemd as well.

    `dismissed` becomes True where ``tokt run --watchdog`` started this process and wants it to end,
    or has died: then standard input ends. Another process may have been started since, and two
    loops would contradict each other.
    """

    def __init__(
        self, clock: Clock, environ: Mapping[str, str] = os.environ, commands: int = _STDIN
    ) -> None:
        self.dismissed = False
        self._clock = clock
        self._alive_at: float | None = None
        self._systemd: socket.socket | None = None
        self._pipe: int | None = None
        path = environ.get(SYSTEMD_VARIABLE, "")
        if path:
            # A leading @ is a name in Linux's abstract namespace: sd_notify(3).
            self._open("\0" + path[1:] if path.startswith("@") else path)
        pipe = environ.get(WATCHDOG_VARIABLE, "")
        if pipe.isdigit():
            self._pipe = _inherited(int(pipe))
            threading.Thread(
                target=self._await_end, args=(commands,), name="tokt watched", daemon=True
            ).start()

    def _open(self, path: str) -> None:
        if sys.platform == "win32":  # has no such sockets
            return
        opened = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            opened.connect(path)
        except OSError:
            opened.close()  # who asked has gone
        else:
            self._systemd = opened

    def _await_end(self, commands: int) -> None:
        with suppress(OSError):
            while os.read(commands, _PIECE_BYTES):
                continue
        self.dismissed = True

    def _tell(self, words: bytes) -> None:
        with suppress(OSError):  # who watches may have gone; the loop goes on
            if self._systemd is not None:
                self._systemd.send(words)
            if self._pipe is not None:
                os.write(self._pipe, words + b"\n")

    def ready(self) -> None:
        """Frames are being waited for."""
        self._tell(READY)

    def alive(self) -> None:
        """The loop has come round."""
        now = self._clock.monotonic()
        if self._alive_at is None or now - self._alive_at >= EVERY_S:
            self._alive_at = now
            self._tell(ALIVE)

    def stopping(self) -> None:
        """The source has ended, and the loop with it: there is nothing to be started again for."""
        self._tell(STOPPING)

    def close(self) -> None:
        """Tell nothing more."""
        if self._systemd is not None:
            self._systemd.close()
        if self._pipe is not None:
            os.close(self._pipe)
        self._systemd = self._pipe = None


def _inherited(number: int) -> int | None:
    """Take the pipe over that a parent named; None where there is none."""
    try:
        if sys.platform == "win32":
            return msvcrt.open_osfhandle(number, os.O_WRONLY)
        os.set_inheritable(number, False)
        os.set_blocking(number, False)
    except OSError:
        return None
    return number


def _to_inherit(descriptor: int) -> int:
    """Return what names a pipe in a child that inherits it."""
    if sys.platform == "win32":
        handle = msvcrt.get_osfhandle(descriptor)
        os.set_handle_inheritable(handle, True)
        return handle
    return descriptor


START_S, HANG_S, STOP_S = 60.0, 2.0, 5.0
"""Seconds until the runtime is killed: from its start until it is ready, without a sign of life,
and from being asked to end."""
STEADY_S = 5.0
"""Seconds after which a runtime that dies is started again at once, as it had worked."""
RESTARTS_VARIABLE = "TOKT_RESTARTS"
"""How often the runtime has been started again."""

_FAILED, _USER_ERROR, _KILLED = 1, 2, -9
_POLL_S = 0.02
_MAX_PAUSE_S = 2.0


class _Life:
    """One process of the runtime, and the two pipes to it."""

    def __init__(
        self, command: Sequence[str], restarts: int, beginning: bytes, stderr: TextIO | None
    ) -> None:
        self.signs: SimpleQueue[bytes] = SimpleQueue()  # what it tells, in its order
        self._ended = threading.Event()
        ours, theirs = os.pipe()
        environ = {**os.environ, RESTARTS_VARIABLE: str(restarts)}
        environ[WATCHDOG_VARIABLE] = str(_to_inherit(theirs))
        environ.pop(SYSTEMD_VARIABLE, None)
        windows = sys.platform == "win32"
        try:
            self.process = subprocess.Popen(
                command,
                env=environ,
                stdin=subprocess.PIPE,
                stderr=stderr,
                pass_fds=() if windows else (theirs,),
                close_fds=not windows,
            )
        except OSError:
            os.close(ours)
            raise
        finally:
            os.close(theirs)
        # A runtime that hangs reads nothing and says nothing, and holds a thread each.
        try:
            threading.Thread(target=self._read, args=(ours,), daemon=True).start()
            threading.Thread(target=self._feed, args=(beginning,), daemon=True).start()
        except RuntimeError as error:  # no thread can be started
            self.process.kill()
            raise OSError(str(error)) from None

    def _read(self, pipe: int) -> None:
        with os.fdopen(pipe, "rb") as lines:
            for line in lines:
                self.signs.put(line.rstrip(b"\n"))

    def _feed(self, beginning: bytes) -> None:
        """Write what the run began with, and end the pipe when it is to end."""
        assert self.process.stdin is not None
        with suppress(OSError), self.process.stdin as pipe:
            pipe.write(LENGTH.pack(len(beginning)) + beginning)
            pipe.flush()
            self._ended.wait()

    def next_sign(self) -> bytes | None:
        """Return what the runtime tells in the next moment, or None."""
        try:
            return self.signs.get(timeout=_POLL_S)
        except Empty:
            return None

    def ask_to_end(self) -> None:
        """Ask the runtime to end: at the end of its standard input, where there is no SIGTERM."""
        self._ended.set()
        if os.name == "posix":
            self.process.terminate()

    def kill(self) -> int:
        """End the process, if it has not ended, and return its exit code."""
        self.process.kill()
        self._ended.set()
        # One that the kernel holds, in a driver or a disk that hangs, dies when it is let go.
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(HANG_S)
        return _KILLED if self.process.returncode is None else self.process.returncode


@dataclass(eq=False)
class Watchdog:
    """Keep one command running, a program that tells its signs of life as `Notifier` does."""

    command: Sequence[str]
    say: Callable[[str], None]  # given one line for people each time something happens
    notifier: Notifier  # passes the runtime's signs of life on
    stderr: TextIO | None = None  # the runtime's; by default this process's own
    beginning: Callable[[], bytes] = bytes  # written to the runtime's standard input at each start

    def __post_init__(self) -> None:
        self.restarts = 0
        self._asked_to_stop = False
        self._was_ready = False
        self._finished = False

    def stop(self) -> None:
        """End the runtime and then this; may be called from a signal handler."""
        self._asked_to_stop = True

    def run(self) -> int:
        """Go on until the runtime says that its source has ended, or `stop` was called.

        A runtime that ends without a word is started again, whatever its exit code: SIGTERM to it
        alone (as from earlyoom, where memory is short) makes it end as it should, with code 0.

        Gives the runtime's exit code: 0, or 2 where it never got ready because of what a user
        wrote.
        """
        code = quick = 0
        while not self._asked_to_stop:
            started = time.monotonic()
            code, why = self._one_life()
            never_ready = code == _USER_ERROR and not self._was_ready
            if self._asked_to_stop or self._finished or never_ready:
                break
            lived_s = time.monotonic() - started
            quick = 0 if lived_s > STEADY_S else quick + 1
            self.restarts += 1
            self.say(f"{why}; started again ({self.restarts})")
            self._pause(quick)
        return max(code, 0)

    def _one_life(self) -> tuple[int, str]:
        """Run the command once; its exit code, and why it ended."""
        try:
            life = _Life(self.command, self.restarts, self.beginning(), self.stderr)
        except OSError as error:  # such as no memory, for which the last one may have died
            return _FAILED, f"the runtime cannot be started: {os_words(error)}"
        why = ""
        try:
            why = self._watch(life)
        finally:
            code = life.kill()
        return code, why

    def _pause(self, quick: int) -> None:
        """None the first time, then longer ones for a runtime that cannot stay up."""
        if quick > 1:
            until = time.monotonic() + min(0.1 * 2**quick, _MAX_PAUSE_S)
            while time.monotonic() < until and not self._asked_to_stop:
                time.sleep(_POLL_S)

    def _watch(self, life: _Life) -> str:
        """Wait until the runtime has ended, or is to be killed; why."""
        ready = False
        # Not the runtime's clock: this one, as both processes, stands still in a suspend.
        until = time.monotonic() + START_S
        asked = ended = False
        sign: bytes | None = None
        while not ended or sign is not None:
            # Looked at before the signs are: what it said last is heard.
            ended = life.process.poll() is not None
            sign = life.next_sign()
            if self._asked_to_stop and not asked:
                life.ask_to_end()
                asked, until = True, time.monotonic() + STOP_S
            elif sign in (READY, ALIVE) and not asked:
                ready = ready or sign == READY
                self._pass_on(sign)
                until = time.monotonic() + (HANG_S if ready else START_S)
            elif sign == STOPPING and not asked:
                self._finished = asked = True
                until = time.monotonic() + STOP_S
            elif time.monotonic() > until and not ended:
                what = "does not answer" if ready else "did not get ready"
                return f"the runtime {what} and was killed"
        code = life.process.returncode
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"the runtime ended with {how}"

    def _pass_on(self, sign: bytes) -> None:
        if sign == ALIVE:
            self.notifier.alive()
        elif not self._was_ready:
            self._was_ready = True
            self.notifier.ready()
