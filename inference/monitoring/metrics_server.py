"""An HTTP server for one page of metrics, in a thread of its own.

One request at a time, each for a bounded silence of its client: whoever connects can keep other
scrapes waiting, and nothing else.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from socketserver import TCPServer
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from tokt.features.common.address import resolve
from tokt.features.common.errors import ToktError

_REQUEST_S = 2.0
"""Longest silence of a client within its request, in seconds."""
_STOP_CHECK_S = 0.2
_JOIN_S = 1.0


class MetricsServer:
    """Answer with what an application gives, until closed.

    Parameters
    ----------
    host : str
    port : int
        0 takes any that is free.
    application : callable
        WSGI.

    Attributes
    ----------
    port : int
        The one that is listened on.

    Raises
    ------
    ToktError
        If the address cannot be listened on.
    """

    def __init__(self, host: str, port: int, application: Callable[..., Any]) -> None:
        family, address = resolve(host, port)
        try:
            self._server = _QuietServer(family, address)
        except OSError as error:
            why = error.strerror or error
            raise ToktError(f"metrics cannot be served on {host}:{port}: {why}") from None
        self._server.set_app(application)
        self.port: int = self._server.server_address[1]
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="tokt metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self._closing.set()
        self._thread.join(_JOIN_S)
        self._server.server_close()

    def _serve(self) -> None:
        while not self._closing.is_set():
            self._server.handle_request()


class _Handler(WSGIRequestHandler):
    timeout = _REQUEST_S

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: standard error is for people."""


class _QuietServer(WSGIServer):
    timeout = _STOP_CHECK_S

    def __init__(self, family: socket.AddressFamily, address: Any) -> None:
        self.address_family = family
        super().__init__(address, _Handler)

    def server_bind(self) -> None:
        """Bind without looking the host's name up, for which a ship's network may take long."""
        TCPServer.server_bind(self)
        host, port = self.server_address[:2]
        self.server_name, self.server_port = str(host), int(port)
        self.setup_environ()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of clients that hang up or fall silent."""
