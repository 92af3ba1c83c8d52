"""A watchdog: a process that starts the runtime, and starts it again when it dies or hangs.

What systemd does with docs/tokt.service, for a PC without systemd.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

from tokt.features.common.errors import os_words
from tokt.inference.clock import Clock

SYSTEMD_VARIABLE = "NOTIFY_SOCKET"
WATCHDOG_VARIABLE = "TOKT_WATCHDOG"
"""``PORT:TOKEN:PID``: a port on loopback, what each datagram to it begins with, and whose it is."""

READY, ALIVE, STOPPING = b"READY=1", b"WATCHDOG=1", b"STOPPING=1"
END = b"END=1"
"""What the watchdog answers to have the process end, where there is no SIGTERM (Windows)."""

EVERY_S = 0.2
"""Seconds between two signs of life, however fast the loop goes."""


def restarts() -> int:
    """Return how often a watchdog has started this run again."""
    return int(os.environ.get(RESTARTS_VARIABLE, "0"))


class Notifier:
    """Signs of life of this process; none where nobody asked for them.

    The words are those of systemd's ``sd_notify`` (READY=1, WATCHDOG=1, STOPPING=1): one datagram
    each to the socket that ``NOTIFY_SOCKET`` names, or, from ``tokt run --watchdog``, which runs
    where there is no systemd as well, to a port on loopback.
    """

    def __init__(self, clock: Clock, environ: Mapping[str, str] = os.environ) -> None:
        self._clock = clock
        self._sockets: list[tuple[socket.socket, bytes]] = []
        self._alive_at: float | None = None
        path = environ.get(SYSTEMD_VARIABLE, "")
        if path and sys.platform != "win32":
            # A leading @ is a name in Linux's abstract namespace: sd_notify(3).
            self._open(socket.AF_UNIX, "\0" + path[1:] if path.startswith("@") else path, b"")
        port, _, rest = environ.get(WATCHDOG_VARIABLE, "").partition(":")
        token, _, parent = rest.partition(":")
        # On Windows a parent that has died goes on being named.
        self._parent = int(parent) if parent.isdigit() and os.name == "posix" else None
        if port.isdigit():
            self._open(socket.AF_INET, ("127.0.0.1", int(port)), token.encode() + b" ")

    def _open(self, family: int, address: str | tuple[str, int], start: bytes) -> None:
        opened = socket.socket(family, socket.SOCK_DGRAM)
        opened.setblocking(False)
        try:
            opened.connect(address)
        except OSError:
            opened.close()  # who asked has gone
        else:
            self._sockets.append((opened, start))

    def _tell(self, words: bytes) -> None:
        for opened, start in self._sockets:
            with suppress(OSError):  # who watches may have gone; the loop goes on
                opened.send(start + words)

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

    @property
    def dismissed(self) -> bool:
        """Whether ``tokt run --watchdog`` started this process and wants it to end, or has died.

        Another one may have been started since, and two loops would contradict each other.
        """
        if self._parent is not None and os.getppid() != self._parent:
            return True
        return any(start and _says_end(opened, start) for opened, start in self._sockets)

    def close(self) -> None:
        """Close the sockets."""
        for opened, _ in self._sockets:
            opened.close()
        self._sockets.clear()


def _says_end(opened: socket.socket, start: bytes) -> bool:
    try:
        return opened.recv(_MAX_DATAGRAM) == start + END
    except BlockingIOError:
        return False
    except ConnectionError:
        return True  # nobody listens any more


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
_MAX_DATAGRAM = 65_535  # Windows raises where one is longer than what is asked for


@dataclass(eq=False)
class Watchdog:
    """Keep one command running, a program that tells its signs of life as `Notifier` does."""

    command: Sequence[str]
    say: Callable[[str], None]  # given one line for people each time something happens
    notifier: Notifier  # passes the runtime's signs of life on
    stderr: TextIO | None = None  # the runtime's; by default this process's own

    def __post_init__(self) -> None:
        self.restarts = 0
        self._asked_to_stop = False
        self._was_ready = False
        self._finished = False
        self._where: tuple[str, int] | None = None  # from which port the runtime speaks

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
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as signs:
            signs.bind(("127.0.0.1", 0))
            signs.settimeout(_POLL_S)
            while not self._asked_to_stop:
                started = time.monotonic()
                code, why = self._one_life(signs)
                never_ready = code == _USER_ERROR and not self._was_ready
                if self._asked_to_stop or self._finished or never_ready:
                    break
                lived_s = time.monotonic() - started
                quick = 0 if lived_s > STEADY_S else quick + 1
                self.restarts += 1
                self.say(f"{why}; started again ({self.restarts})")
                self._pause(quick)
        return max(code, 0)

    def _one_life(self, signs: socket.socket) -> tuple[int, str]:
        """Run the command once; its exit code, and why it ended."""
        # A new token each time: what the one before said last may still wait to be read.
        import secrets

        token, self._where = secrets.token_hex(8), None
        try:
            child = self._start(f"{signs.getsockname()[1]}:{token}:{os.getpid()}")
        except OSError as error:  # such as no memory, for which the last one may have died
            return _FAILED, f"the runtime cannot be started: {os_words(error)}"
        try:
            why = self._watch(child, signs, token.encode() + b" ")
        finally:
            child.kill()  # does nothing to one that has ended
            # One that the kernel holds, in a driver or a disk that hangs, dies when it is let go.
            with suppress(subprocess.TimeoutExpired):
                child.wait(HANG_S)
        return _KILLED if child.returncode is None else child.returncode, why

    def _start(self, where: str) -> subprocess.Popen[bytes]:
        environ = {**os.environ, WATCHDOG_VARIABLE: where, RESTARTS_VARIABLE: str(self.restarts)}
        environ.pop(SYSTEMD_VARIABLE, None)
        stdin, stderr = subprocess.DEVNULL, self.stderr
        return subprocess.Popen(self.command, env=environ, stdin=stdin, stderr=stderr)

    def _pause(self, quick: int) -> None:
        """None the first time, then longer ones for a runtime that cannot stay up."""
        if quick > 1:
            until = time.monotonic() + min(0.1 * 2**quick, _MAX_PAUSE_S)
            while time.monotonic() < until and not self._asked_to_stop:
                time.sleep(_POLL_S)

    def _watch(self, child: subprocess.Popen[bytes], signs: socket.socket, token: bytes) -> str:
        """Wait until the runtime has ended, or is to be killed; why."""
        ready = False
        # Not the runtime's clock: this one, as both processes, stands still in a suspend.
        until = time.monotonic() + START_S
        asked = ended = False
        sign: bytes | None = None
        while not ended or sign is not None:
            # Looked at before the signs are: what it said last is heard.
            ended = child.poll() is not None
            sign = self._next_sign(signs, token)
            if self._asked_to_stop and not asked:
                self._ask_to_end(child, signs, token)
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
        code = child.returncode
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"the runtime ended with {how}"

    def _pass_on(self, sign: bytes) -> None:
        if sign == ALIVE:
            self.notifier.alive()
        elif not self._was_ready:
            self._was_ready = True
            self.notifier.ready()

    def _next_sign(self, signs: socket.socket, token: bytes) -> bytes | None:
        """What the runtime said in the next moment, empty for what somebody else did, or None."""
        try:
            data, where = signs.recvfrom(_MAX_DATAGRAM)
        except (TimeoutError, ConnectionResetError):
            return None  # the latter: Windows reports another socket's ICMP answer here
        if not data.startswith(token):
            return b""
        self._where = where
        return data.removeprefix(token)

    def _ask_to_end(
        self, child: subprocess.Popen[bytes], signs: socket.socket, token: bytes
    ) -> None:
        if self._where is not None:
            signs.sendto(token + END, self._where)
        if os.name == "posix" or self._where is None:  # elsewhere this kills
            child.terminate()
