"""Running the web application until it is told to end."""

from __future__ import annotations

import socket
from collections.abc import Callable

import uvicorn

from tokt.labels.page.state.session import Session

from .access import AccessRules
from .app import create_app

_LAST_ANSWERS_S = 1  # how long answers that are under way may take when the server ends
_IDLE_S = 60  # how long a connection is kept for the next request


class _PageServer(uvicorn.Server):
    """A uvicorn server that says when it answers, and that open event streams do not hold up."""

    def __init__(
        self, config: uvicorn.Config, ready: Callable[[], None], ending: Callable[[], None]
    ) -> None:
        super().__init__(config)
        self._ready = ready
        self._ending = ending

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._ending()
        await super().shutdown(sockets)


def serve(
    session: Session, listener: socket.socket, rules: AccessRules, ready: Callable[[], None]
) -> None:
    """Serve `session` on a listening socket until SIGINT or SIGTERM.

    Parameters
    ----------
    session : Session
    listener : socket.socket
    rules : AccessRules
    ready : callable
        Called when the server answers.
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
        timeout_graceful_shutdown=_LAST_ANSWERS_S,
    )
    _PageServer(config, ready, session.live.close).run([listener])
