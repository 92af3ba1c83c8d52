"""Waiting for what another thread or process does: only what hangs makes a test fail."""

import time
from collections.abc import Callable
from typing import TypeVar

Found = TypeVar("Found")

MAX_S = 120.0
"""Seconds that nothing takes on the busiest machine; a test has more (pyproject.toml)."""


def until(true: Callable[[], Found], said: Callable[[], object] = lambda: "") -> Found:
    """Wait until something is true; what it is.

    Parameters
    ----------
    true : callable
        Asked again and again; may raise, where what is waited for can no longer come.
    said : callable
        What is told where it never comes true.
    """
    deadline = time.monotonic() + MAX_S
    while not (found := true()):
        assert time.monotonic() < deadline, f"it never came true: {said()}"
        time.sleep(0.002)
    return found
