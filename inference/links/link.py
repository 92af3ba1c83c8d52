"""Links as users write them, and those over TCP and serial ports, on threads of their own."""

import re
import select
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing

from tokt.features.common.address import parse_address, resolve
from tokt.features.common.errors import ToktError, os_words

from .datagrams import NOBODY, READ_S, Heard, UdpLink

STALL_S = 2.0
"""Seconds that the other end may take nothing before the link is opened anew."""
FIRST_WAIT_S, MAX_WAIT_S = 0.5, 10.0
"""Before a link is opened again: at first, and at most after it has doubled."""
MAX_WAITING = 16
"""Messages that wait at most, a second's; of more, the oldest is left out."""
_READ_BYTES = 4096
_PACE_S = 0.01  # between two pieces: a flood of them cannot take the loop's processor
_FORMS = "udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD]"
_SERIAL = re.compile(
    r"(?:serial:)?((?<=:)[^:]+|/dev/serial/by-path/.+?|/dev/[^:]+|COM\d+)(?::(\d{1,8}))?",
    re.IGNORECASE,
)
# Little waits in the system, and not for long: what the other end reads later is old. Without an
# answer the system ends it, as when a cable is out; one that is only read is asked.
_TCP_OPTIONS = {
    "TCP_NODELAY": 1,
    "TCP_USER_TIMEOUT": int(1000 * STALL_S),
    "TCP_KEEPIDLE": int(STALL_S),
    "TCP_KEEPINTVL": int(STALL_S),
    "TCP_KEEPCNT": 1,
}


class _TcpChannel:
    """An open TCP connection; OSError where it is none any more."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), STALL_S)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 8192)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _TCP_OPTIONS.items():
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self.close = self._socket.close

    def read(self) -> bytes:
        """What has come; empty if nothing does for `READ_S`."""
        if not select.select([self._socket], [], [], READ_S)[0]:
            return b""
        data = self._socket.recv(_READ_BYTES)
        if not data:
            raise ConnectionResetError("the other end has closed it")
        return data

    def write(self, data: bytes) -> None:
        """Write all of it, for `STALL_S` at most."""
        try:
            self._socket.sendall(data)
        except TimeoutError:
            # Closing it throws away what still waits in the system.
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            raise TimeoutError("the other end does not read") from None


class _SerialChannel:
    """An open serial port; OSError where it is none any more."""

    def __init__(self, device: str, baud: int) -> None:
        import serial

        # A port that goes away while it is opened: no OSError on Linux.
        gone = getattr(sys.modules.get("termios"), "error", OSError)
        try:
            self._port = serial.Serial(device, baud, timeout=READ_S, write_timeout=STALL_S)
        except (ValueError, gone) as error:
            raise OSError(str(error)) from None
        self.write, self.close = self._port.write, self._port.close

    def read(self) -> bytes:
        return bytes(self._port.read(min(max(self._port.in_waiting, 1), _READ_BYTES)))


_Channel = _TcpChannel | _SerialChannel


class StreamLink:
    """A link that is kept open; what cannot be sent is counted, and nobody waits for it.

    Nothing is kept for a link that is down, and little for one that is slow. `sent`, `failed` and
    `last_error` are as of `DatagramSocket`, `gaps`, `whole` and `full` as of `UdpLink`; `name` is
    its only sender's.
    """

    whole = False
    full: frozenset[int] = frozenset()

    def __init__(self, connect: Callable[[], _Channel], name: str) -> None:
        self.sent = self.failed = self.gaps = 0
        self.last_error = ""
        self._name = name
        self._connect = connect  # OSError where it fails
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._channel: _Channel | None = None
        self._closing = False
        self._heard: Heard = lambda data, sender: NOBODY
        self._thread = threading.Thread(target=self._keep, name="tokt link", daemon=True)

    def listen(self, heard: Heard) -> None:
        """Open the link, and pass on what comes."""
        self._heard = heard
        self._thread.start()

    def write(self, data: bytes) -> None:
        """Have a message sent, or count why not."""
        with self._changed:
            if self._channel is None:
                self.failed += 1
                self.last_error = self.last_error or "not open yet"
                return
            if len(self._waiting) == MAX_WAITING:
                self._waiting.popleft()
                self.failed += 1
                self.gaps += 1
                self.last_error = "the other end does not read"
            self._waiting.append(data)
            self._changed.notify()

    def close(self) -> None:
        """Send what waits, though not for ever, and close the link."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(2 * STALL_S)

    def _keep(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._closing:
            try:
                with closing(self._connect()) as channel:
                    wait_s = FIRST_WAIT_S
                    self._serve(channel)
            except OSError as error:
                self.last_error = os_words(error)
            with self._changed:
                self._changed.wait_for(lambda: self._closing, wait_s)
            wait_s = min(2 * wait_s, MAX_WAIT_S)

    def _serve(self, channel: _Channel) -> None:
        """Write to an open channel until it breaks, while another thread reads."""
        with self._changed:
            self._channel = channel
            self.gaps += 1
        reader = threading.Thread(target=self._read, args=(channel,), name="tokt link", daemon=True)
        reader.start()
        try:
            while (data := self._next()) is not None:
                try:
                    channel.write(data)
                except OSError:
                    with self._changed:
                        self.failed += 1
                    raise
                self.sent += 1
        finally:
            self._drop()
            reader.join()

    def _next(self) -> bytes | None:
        """The message that waits longest; None once the channel has broken or is to be closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closing or self._channel is None)
            return self._waiting.popleft() if self._waiting else None

    def _drop(self) -> None:
        """Let go of the channel and of what waits for it."""
        with self._changed:
            self._channel = None
            self.failed += len(self._waiting)
            self._waiting.clear()
            self._changed.notify()

    def _read(self, channel: _Channel) -> None:
        try:
            while self._channel is channel:
                if data := channel.read():
                    self._heard(data, self._name)
                    time.sleep(_PACE_S)
        except OSError as error:
            self.last_error = os_words(error)
            self._drop()


Link = UdpLink | StreamLink
"""A two-way link, whose `write` never waits."""


def open_link(text: str) -> Link:
    """The link of a text such as ``udpout:192.168.2.2:14550``, ``/dev/ttyUSB0``, ``COM3:57600``.

    A TCP server that is not there yet, or a serial port, is no error: it is tried again. Raises
    ToktError if it is none, its host is not known, its port cannot be listened on, or pyserial
    lacks.
    """
    kind, _, rest = text.strip().partition(":")
    if kind in ("udpout", "udpin"):
        return UdpLink(*parse_address(rest), listening=kind == "udpin")
    if kind == "tcp":
        address = parse_address(rest)
        resolve(*address)
        return StreamLink(lambda: _TcpChannel(*address), text)
    match = _SERIAL.fullmatch(text.strip())
    if match is None:
        raise ToktError(f"not a link: {text!r} (write {_FORMS})")
    device, baud = match[1], int(match[2] or 115_200)
    if not 300 <= baud <= 12_000_000:
        raise ToktError(f"a serial port has 300 to 12000000 baud, not {baud}")
    try:
        import serial  # noqa: F401 - opened by a thread that could not say so
    except ImportError:
        wanted = "a serial port needs the extra 'mavlink'"
        raise ToktError(wanted) from None
    return StreamLink(lambda: _SerialChannel(device, baud), text)
