"""The web application: all routes, the page's own files, and a watch over the store."""

import asyncio
import mimetypes
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

from fastapi import FastAPI, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp

from tokt.features.common.errors import ToktError
from tokt.labels.page.state.session import Session

from . import (
    class_routes,
    file_routes,
    job_routes,
    label_routes,
    mask_routes,
    mission_routes,
    picture_routes,
    sheet_routes,
)
from .access import Access, AccessRules
from .messages import add_error_handlers

LOOK_S = 0.25
"""How often the store is looked at for what other processes wrote."""
CHECK_S, CHECK_FAULT_S = 5.0, 1.0
"""How often it is tried whether something could be saved, and how often while it cannot."""
QUIET_S = 2.0
"""After the last label: then `labels.db` itself gets what was said, for whoever copies it."""

# Windows takes these from its registry, where they may be anything; browsers then run no script.
mimetypes.add_type("text/javascript", ".js")
mimetypes.add_type("text/css", ".css")


class _PageFiles(StaticFiles):
    """The page's own files. Browsers ask each time whether they changed: tokt may be updated."""

    def file_response(self, *args: Any, **more: Any) -> Response:
        response = super().file_response(*args, **more)
        response.headers["cache-control"] = "no-cache"
        return response


def create_app(session: Session, rules: AccessRules) -> ASGIApp:
    """The application that serves one session to those whom the rules admit."""

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        session.live.start()
        session.start()
        watching = asyncio.create_task(watch(session))
        yield
        watching.cancel()

    app = FastAPI(lifespan=lifespan, openapi_url=None, docs_url=None, redoc_url=None)
    app.state.session = session
    add_error_handlers(app)
    seeing = label_routes, mission_routes, picture_routes, sheet_routes
    for routes in (*seeing, mask_routes, file_routes, class_routes, job_routes):
        app.include_router(routes.router)
    files = _PageFiles(packages=[("tokt.labels.page", "static")])

    @app.get("/")
    async def get_page(request: Request) -> Response:
        return await files.get_response("index.html", request.scope)

    app.mount("/static", files)
    return Access(app, rules)


async def watch(session: Session) -> None:
    """Look for what others wrote and for faults, and tell the pages; until cancelled."""
    told, store = session.status(), _StoreWatch(session)
    while True:
        await asyncio.sleep(LOOK_S)
        await run_in_threadpool(store.look)
        status = session.status()
        if status != told:
            told = status
            session.live.publish()


class _StoreWatch:
    """A watch over the store: new labels of other processes, faults, and quiet moments."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._version: int | None = None
        self._checked_at = self._written_at = time.monotonic()

    def look(self) -> None:
        """Refresh the board if anybody wrote, and now and then try whether writing works."""
        wait = CHECK_FAULT_S if self._session.fault else CHECK_S
        if time.monotonic() - self._checked_at > wait:
            self._session.find_fault()
            self._checked_at = time.monotonic()
        try:
            version = self._session.store.data_version()
            if version != self._version:
                self._session.refresh()
                self._version, self._written_at = version, time.monotonic()
        except ToktError as error:
            self._session.fault = str(error)
        if time.monotonic() - self._written_at > QUIET_S:
            with suppress(ToktError):  # what is said stays in the log; `find_fault` tells why
                self._session.store.fold_log()
