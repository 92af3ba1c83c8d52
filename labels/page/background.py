"""A background thread that works in small steps and gives way to requests."""

import os
import sys
import threading
import time
from collections.abc import Callable

_QUIET_S = 0.05  # after a request: the page mostly asks several things at once
_NICE = 10


class Background:
    """A thread of low priority that takes one `step` after the other, and waits when none is left.

    A step is a few milliseconds of work; it returns False when there is nothing to do until `wake`.
    """

    def __init__(self, name: str, step: Callable[[], bool]) -> None:
        self._step = step
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._wake = threading.Event()
        self._ended = threading.Event()
        self._asked_at = 0.0

    def start(self) -> None:
        """Begin; once."""
        self._thread.start()

    def wake(self) -> None:
        """Say that there is something to do."""
        self._wake.set()

    def give_way(self) -> None:
        """Say that a request is being served: the next step waits a moment, never for long."""
        self._asked_at = time.monotonic()

    def close(self) -> None:
        """End after the step that is being done, and wait for it."""
        self._ended.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        if sys.platform == "linux":  # elsewhere a thread has no priority of its own
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        while not self._ended.is_set():
            if self._asked_at > time.monotonic() - _QUIET_S:
                self._ended.wait(_QUIET_S)
            self._wake.clear()
            # `close` may have come since the loop looked, and this has just cleared its wake.
            if not self._ended.is_set() and not self._step():
                self._wake.wait()
