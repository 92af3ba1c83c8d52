"""Responses of the server: JSON, and errors as one line."""

from __future__ import annotations

import sqlite3
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse, Response

from tokt.features.common.errors import FrameError, ToktError

NOT_SAVED = 507
UNREADABLE = 422
_NO_STORE = {"cache-control": "no-store"}


def json_response(value: dict[str, Any]) -> JSONResponse:
    """A JSON answer that no cache keeps."""
    return JSONResponse(value, headers=_NO_STORE)


def error_response(
    status: int, message: str, headers: dict[str, str] | None = None
) -> JSONResponse:
    """An error: one line, whatever `message` repeats of what was sent."""
    line = " ".join(message.encode("utf-8", "backslashreplace").decode().split())
    return JSONResponse({"error": line}, status, headers={**_NO_STORE, **(headers or {})})


def refuse(status: int, message: str) -> HTTPException:
    """An exception that becomes `error_response`."""
    return HTTPException(status, message)


def _is_store_fault(error: ToktError) -> bool:
    """Whether the label store could not be read or written, rather than asked something wrong."""
    return isinstance(error.__cause__, sqlite3.Error | OSError)


def add_error_handlers(app: FastAPI) -> None:
    """Make every exception of `app` an error response."""
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(ToktError, _user_error)
    app.add_exception_handler(Exception, _fault)


async def _http(_request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return error_response(error.status_code, str(error.detail), dict(error.headers or {}))


async def _invalid(_request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"][1:])
    return error_response(400, f"{where}: {first['msg']}" if where else str(first["msg"]))


async def _user_error(request: Request, error: Exception) -> Response:
    assert isinstance(error, ToktError)
    if _is_store_fault(error):
        request.app.state.session.fault = str(error)  # all pages hear of it
        return error_response(NOT_SAVED, str(error))
    return error_response(UNREADABLE if isinstance(error, FrameError) else 409, str(error))


async def _fault(_request: Request, _error: Exception) -> Response:
    return error_response(500, "fault in tokt label; what it printed in the terminal says more")
