"""A lock between processes that dies with the process that holds it."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import ToktError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_POLL_S = 0.02


def _take(handle: int) -> None:
    """Lock an open file, or raise BlockingIOError (on Windows PermissionError) where it is held."""
    if sys.platform == "win32":
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _give_back(handle: int) -> None:
    if sys.platform == "win32":
        msvcrt.locking(handle, msvcrt.LK_UNLCK, 1)
    else:
        fcntl.flock(handle, fcntl.LOCK_UN)


@contextmanager
def locked(file: Path, wait_s: float) -> Iterator[None]:
    """Hold the lock on `file`, which is made where it is missing.

    The operating system keeps the lock, so a killed process leaves none behind.

    Parameters
    ----------
    file : Path
    wait_s : float
        How long to wait for another process that has it, in seconds.

    Raises
    ------
    ToktError
        If another process keeps it longer.
    """
    deadline = time.monotonic() + wait_s
    with file.open("ab") as opened:
        handle = opened.fileno()
        while True:
            try:
                _take(handle)
                break
            except (BlockingIOError, PermissionError):
                if time.monotonic() > deadline:
                    raise ToktError(
                        f"{file.parent}: another tokt has been writing to it for {wait_s:g} s; "
                        "nothing was changed, try again"
                    ) from None
            time.sleep(_POLL_S)
        try:
            yield
        finally:
            _give_back(handle)
