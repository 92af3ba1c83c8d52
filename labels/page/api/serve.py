"""Serving the page: the listening socket, its host names and URL, and the server until it ends."""

import atexit
import errno
import ipaddress
import os
import secrets
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType
from urllib.parse import quote

import uvicorn
from uvicorn.server import HANDLED_SIGNALS

from tokt.features.common.address import LOOPBACK_NAMES, shown_host
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.labels.page.state.session import Session

from .access import AccessRules
from .app import create_app

_LAST_ANSWERS_S = 1  # how long answers and steps that are under way may take when the server ends
_IDLE_S = 60  # how long a connection is kept for the next request


@dataclass(frozen=True)
class Address:
    """A socket that listens already, and what goes with it."""

    socket: socket.socket
    rules: AccessRules
    url: str
    """What a person opens; holds the token if one is needed."""
    opens_once: str
    """What a browser is started with: every account sees the words that a program was started with,
    so it holds what is good for one time only."""


def listen(host: str, port: int, token: str | None) -> Address:
    """Listen on a port, for those who have the token; on loopback it may be None.

    Raises ToktError if the address is not ours or the port is taken or not allowed.
    """
    loopback = _is_loopback(host)
    if token is None and not loopback:
        raise ToktError(f"--no-token is for this computer alone, and --host {host} is not")
    listener = _listening(host, port)
    port = listener.getsockname()[1]
    shown = shown_host(host)
    rules = AccessRules(port, LOOPBACK_NAMES | {shown}, not loopback, token)
    page = f"http://{shown}:{port}/"
    if token is None:
        return Address(listener, rules, page, page)
    ticket = secrets.token_urlsafe(18)
    rules.tickets.add(ticket)
    return Address(listener, rules, *(f"{page}?token={quote(t, safe='')}" for t in (token, ticket)))


def _listening(host: str, port: int) -> socket.socket:
    with os_errors_as(f"--host {host}"):
        family, kind, proto, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    listener = socket.socket(family, kind, proto)
    try:
        if os.name == "posix":  # elsewhere it would let two programs listen on one port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen()
    except OSError as error:
        listener.close()
        raise ToktError(_why_not(host, port, error)) from None
    return listener


def _why_not(host: str, port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} is taken (by another tokt label?); choose another with --port"
    if error.errno == errno.EACCES:
        return f"port {port} may not be used; choose another with --port"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"--host {host} is not an address of this computer"
    return f"cannot listen on {host} port {port}: {error.strerror or error}"


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class _PageServer(uvicorn.Server):
    """A uvicorn server that says when it answers, and that nothing under way holds up."""

    def __init__(self, config: uvicorn.Config, session: Session, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._session = session
        self._ready = ready
        self.end = threading.Timer(_LAST_ANSWERS_S, self._leave)
        self.end.daemon = True

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take Ctrl-C and SIGTERM for good: one that comes while all is put away does no harm."""
        for number in HANDLED_SIGNALS:
            signal.signal(number, self.handle_exit)
            # While Python puts itself away it would hand the signal back to the system.
            atexit.register(signal.signal, number, signal.SIG_IGN)
        yield

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self.should_exit = True

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self.end.start()
        self._session.live.close()
        await super().shutdown(sockets)

    def _leave(self) -> None:
        """End the process: a large frame takes half a minute. A label that was answered is kept."""
        self._session.jobs.close()
        with suppress(ToktError):
            self._session.store.fold_log()
        os._exit(0)


def serve(
    session: Session, listener: socket.socket, rules: AccessRules, ready: Callable[[], None]
) -> None:
    """Serve `session` on a listening socket until SIGINT or SIGTERM, which stay taken; close it.

    `ready` is called when the server answers. The process ends if an answer takes too long.
    """
    config = uvicorn.Config(
        create_app(session, rules),
        log_config=None,
        log_level="warning",
        access_log=False,
        ws="none",
        lifespan="on",
        proxy_headers=False,
        server_header=False,
        timeout_keep_alive=_IDLE_S,
    )
    server = _PageServer(config, session, ready)
    server.run([listener])
    session.close()
    server.end.cancel()
