"""What every command that writes to a deploy store does: be alone, and say who it was and when."""

from __future__ import annotations

import getpass
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ..features.errors import ToktError
from ..features.file_lock import locked

LOCK_WAIT_S = 10.0
"""How long a command waits for another one that is writing; that one takes about a second."""


@contextmanager
def alone(store: Path) -> Iterator[None]:
    """Be the one process that writes to the folder `store`, which is made where it is missing.

    What the system refuses, such as a full disk, becomes a ToktError.
    """
    try:
        store.mkdir(parents=True, exist_ok=True)
        with locked(store / "lock", LOCK_WAIT_S):
            yield
    except OSError as error:
        raise ToktError(f"store {store}: {error.strerror or error}") from None


def account() -> str:
    """The account that runs the command."""
    try:
        return one_line(getpass.getuser())
    except (OSError, KeyError, ImportError):
        return "unknown"


def now() -> str:
    """UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def time_in_name() -> str:
    """UTC to the microsecond, as part of a file name."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")


def one_line(text: str) -> str:
    """What a person typed, on one line that every terminal can show.

    A terminal of another encoding gives bytes that Python holds as halves of surrogate pairs; an
    entry with one in it is refused as damaged by whoever reads it.
    """
    words = " ".join(text.split())
    return "".join(sign if sign.isprintable() else "?" for sign in words)
