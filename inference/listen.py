"""Receive datagrams: what ``tokt listen`` shows."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

from ..features.errors import ToktError
from .udp import resolve

_LARGEST_DATAGRAM = 65535
_STOP_CHECK_S = 0.2


def datagrams(
    host: str, port: int, stopped: Callable[[], bool], ready: Callable[[], None]
) -> Iterator[tuple[str, bytes]]:
    """Yield ``(sender, datagram)`` as they come, until `stopped` says so.

    Parameters
    ----------
    host, port
        The address to listen on.
    stopped
        Asked every 0.2 s, and after each datagram.
    ready
        Called once the port is open, so that nothing sent after it is missed.

    Raises
    ------
    ToktError
        If the host is not known or the port cannot be opened.
    """
    family, address = resolve(host, port)
    with socket.socket(family, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind(address)
        except OSError as error:
            raise ToktError(f"cannot listen on {host}:{port}: {error.strerror or error}") from None
        receiver.settimeout(_STOP_CHECK_S)
        ready()
        while not stopped():
            try:
                data, sender = receiver.recvfrom(_LARGEST_DATAGRAM)
            except TimeoutError:
                continue
            except ConnectionResetError:
                continue  # Windows reports another socket's ICMP answer here
            yield f"{sender[0]}:{sender[1]}", data
