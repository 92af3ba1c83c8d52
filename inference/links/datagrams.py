"""UDP sockets: one that only sends, and one that hears answers (``udpout:``, ``udpin:``)."""

import ipaddress
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from tokt.features.common.address import resolve
from tokt.features.common.errors import ToktError, os_errors_as, os_words

NOBODY, OTHER, OWN = range(3)
"""Senders of a datagram: it holds no message; another system; the system that is configured."""
Heard = Callable[[bytes, str], int]
"""Function of what came and its sender's name; returns `NOBODY`, `OTHER` or `OWN`."""
READ_S = 0.2
"""Longest wait in seconds of a reading thread before it looks whether it is to end."""
PEER_S = 10.0
"""Seconds of silence after which a peer is answered no more."""
PLACES = {OTHER: 8, OWN: 32}
"""Peers that are answered. Others never take a place of the own system's."""
_MAX_DATAGRAM = 2048
_PACE_S = 0.001  # between two datagrams: a flood of them cannot take the loop's processor


class DatagramSocket:
    """A socket for datagrams to one address, which never waits for the network.

    It does not block and is not connected: an unreachable host, a cable that is out or a receiver
    that is not running costs one failed call at most. A name is looked up once, here: that can
    take seconds, which no loop has. Of datagrams `sent` were taken by the system, which does not
    tell whether anyone listens; `failed` were refused, the last of them for `last_error`. Raises
    ToktError if the host name is not known, or is none that can be sent to.
    """

    def __init__(self, host: str, port: int, listening: bool = False) -> None:
        self.sent = self.failed = 0
        self.last_error = ""
        family, self._address = resolve(host, port)
        receiver = ipaddress.ip_address(self._address[0])
        if receiver.is_unspecified and not listening:
            raise ToktError(f"{host} is an address to listen on: name the receiver's own")
        if family is socket.AF_INET6 and receiver.is_link_local and not self._address[3]:
            raise ToktError(f"{host} is on no network yet: add its name, such as [{host}%eth0]")
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        if family is socket.AF_INET:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.setblocking(False)

    def write(self, data: bytes) -> None:
        """Send one datagram, or count why not."""
        self._write_to(data, [self._address])

    def _write_to(self, data: bytes, addresses: Iterable[Any]) -> None:
        went = False
        for address in addresses:
            try:
                self._socket.sendto(data, address)
                went = True
            except OSError as error:
                self.last_error = os_words(error)
        self.sent += went
        self.failed += not went

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UdpLink(DatagramSocket):
    """``udpout:``: send there, and hear the answers. ``udpin:``: be `listening` there, and answer.

    `whole` tells that what is heard comes as whole messages; `gaps` grows where somebody new
    listens, or messages were lost to who does. `full` has the kinds of peers whose `PLACES` have
    all been taken.
    """

    whole = True

    def __init__(self, host: str, port: int, listening: bool = False) -> None:
        super().__init__(host, port, listening)
        self.gaps = 0
        self.full: set[int] = set()
        self._listening = listening
        self._peers: dict[Any, tuple[int, float]] = {}  # kind, when heard; heard last stands last
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        # Windows does not receive on a socket without a port.
        with os_errors_as(f"cannot listen on {host}:{port}"):
            self._socket.bind(self._address if listening else ("", 0))

    def listen(self, heard: Heard) -> None:
        """Pass on what comes, on a thread of its own."""
        thread = threading.Thread(target=self._read, args=(heard,), name="tokt link", daemon=True)
        self._thread = thread
        thread.start()

    def _read(self, heard: Heard) -> None:
        while not self._closing.is_set():
            try:
                if not select.select([self._socket], [], [], READ_S)[0]:
                    continue
                data, sender = self._socket.recvfrom(_MAX_DATAGRAM)
            except OSError:  # Windows reports ICMP answers and what is too long here
                self._closing.wait(READ_S)
                continue
            if kind := heard(data, f"{sender[0]}:{sender[1]}"):
                self._spoke(sender, kind)
            time.sleep(_PACE_S)

    def _spoke(self, sender: Any, kind: int) -> None:
        with self._lock:
            known, _ = self._peers.pop(sender, (NOBODY, 0.0))
            # Behind a router several systems share one socket: the best of them counts.
            kind = max(kind, known)
            alike = [peer for peer, (other, _) in self._peers.items() if other == kind]
            if known != kind and len(alike) >= PLACES[kind]:
                # Others are never put out by those who come later, however many. Of many that have
                # the own system's number the vehicle is one that speaks often.
                if kind == OTHER:
                    return
                del self._peers[alike[0]]
            self.gaps += known == NOBODY
            self._peers[sender] = kind, time.monotonic()
            if len(alike) + 1 >= PLACES[kind]:
                self.full.add(kind)

    def write(self, data: bytes) -> None:
        """Send one datagram to whom it is for, or count why not."""
        now = time.monotonic()
        with self._lock:
            heard = self._peers.items()
            self._peers = {peer: it for peer, it in heard if now - it[1] <= PEER_S}
            peers = list(self._peers) if self._listening else [self._address]
        if not peers:
            self.last_error = "nobody is heard there"
        self._write_to(data, peers)

    def close(self) -> None:
        """End the thread and close the socket."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()
        super().close()
