"""Signs of life of this process, for systemd or `watchdog`: ready, alive, stopping.

The words are those of systemd's ``sd_notify`` (READY=1, WATCHDOG=1, STOPPING=1): one datagram each
to the socket that ``NOTIFY_SOCKET`` names, or, from ``tokt run --watchdog``, which runs where there
is no systemd as well, to a port on loopback.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

from tokt.inference.clock import Clock

SYSTEMD_VARIABLE = "NOTIFY_SOCKET"
WATCHDOG_VARIABLE = "TOKT_WATCHDOG"
"""``PORT:TOKEN:PID``: a port on loopback, what each datagram to it begins with, and whose it is."""

READY, ALIVE, STOPPING = b"READY=1", b"WATCHDOG=1", b"STOPPING=1"

EVERY_S = 0.2
"""Seconds between two signs of life, however fast the loop goes."""


class Notifier:
    """Signs of life of this process; none where nobody asked for them.

    Parameters
    ----------
    clock : Clock
    environ : mapping
        The environment's variables.
    """

    def __init__(self, clock: Clock, environ: Mapping[str, str] = os.environ) -> None:
        self._clock = clock
        self._sockets: list[tuple[socket.socket, bytes]] = []
        self._alive_at: float | None = None
        path = environ.get(SYSTEMD_VARIABLE, "")
        if path:
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
            try:
                opened.send(start + words)
            except OSError:
                continue  # who watches may have gone; the loop goes on

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
        """The loop ends because it was asked to."""
        self._tell(STOPPING)

    @property
    def orphaned(self) -> bool:
        """Whether ``tokt run --watchdog`` started this process and has died.

        Another one may have been started since, and two loops would contradict each other.
        """
        return self._parent is not None and os.getppid() != self._parent

    def close(self) -> None:
        """Close the sockets."""
        for opened, _ in self._sockets:
            opened.close()
        self._sockets.clear()
