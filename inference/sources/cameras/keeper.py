"""One camera is kept delivering: started, watched, and started again when it is lost.

::

    starting ──ToktError──> lost ──0.2, 0.4 .. 2 s──> starting
        │                    ^
        └──> delivering ─────┘  the driver says so, or nothing has come for too long
"""

from __future__ import annotations

import threading
from typing import Protocol

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock

from .capture import SIDES, CameraDriver, Capture

MIN_PAUSE_S, MAX_PAUSE_S = 0.2, 2.0
"""Seconds until a lost camera is tried again: the first time, and at most."""

_LOOK_S = 0.05  # how often a camera is looked after
_SILENT_PERIODS = 5
_MIN_SILENCE_S = 1.0
_FIRST_SILENCE_S = 3.0  # until there are two captures: a camera may take a second to begin
_DOUBT_S = 0.15  # of silence, after which the driver is asked whether its camera is there


class CameraListener(Protocol):
    """Told what becomes of a camera; called on the camera's own threads."""

    def captured(self, capture: Capture) -> None:
        """It delivered."""

    def lost(self, camera: int, words: str) -> None:
        """It delivers no more, for the reason given. Told at each attempt that fails."""


class CameraKeeper:
    """Keep one camera delivering, on a thread of its own.

    Parameters
    ----------
    camera : int
        `LEFT` or `RIGHT`.
    driver : CameraDriver
    clock : Clock
    listener : CameraListener
    wait : bool
        Whether a camera that cannot be opened at first is tried again, as one that was lost is.
    """

    def __init__(
        self, camera: int, driver: CameraDriver, clock: Clock, listener: CameraListener, wait: bool
    ) -> None:
        self.driver = driver
        self.refused: ToktError | None = None
        self._camera = camera
        self._clock = clock
        self._listener = listener
        self._wait = wait
        self._stopped = False
        self._started_s = 0.0
        self._captured_s: float | None = None
        self._gap_s: float | None = None
        self._pause_s = MIN_PAUSE_S
        self._tried = threading.Event()
        self._thread = threading.Thread(
            target=self._keep, name=f"tokt {SIDES[camera]} camera", daemon=True
        )

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def wait_for_first_try(self) -> None:
        """Return when the camera was opened or could not be; then `refused` says why."""
        self._tried.wait()

    def stop(self) -> None:
        """Come to an end soon; may be called from a signal handler."""
        self._stopped = True

    def join(self, timeout_s: float) -> bool:
        """Wait for the end, but not for ever; whether it has come."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def alive(self) -> bool:
        """Whether somebody looks after the camera."""
        return self._thread.is_alive()

    def _keep(self) -> None:
        try:
            while not self._stopped:
                words = self._opened() or self._watched()
                self._tried.set()
                if self._stopped or self.refused:
                    return
                self._listener.lost(self._camera, words)
                self._sleep(self._pause_s)
                self._pause_s = min(2 * self._pause_s, MAX_PAUSE_S)
        finally:
            self._tried.set()
            self.driver.stop()

    def _opened(self) -> str:
        """Open the camera; why that cannot be, or nothing."""
        self._captured_s = self._gap_s = None
        try:
            self.driver.start(self._deliver)
        except ToktError as error:
            if not self._tried.is_set() and not self._wait:
                self.refused = error
            return str(error)
        self._started_s = self._clock.monotonic()
        self._tried.set()
        return ""

    def _deliver(self, capture: Capture) -> None:
        if self._captured_s is not None:
            self._gap_s = capture.arrived - self._captured_s
        self._captured_s = capture.arrived
        self._pause_s = MIN_PAUSE_S
        self._listener.captured(capture)

    def _watched(self) -> str:
        """Look after a camera until it delivers no more; why."""
        words = ""
        while not self._stopped and not words:
            self._sleep(_LOOK_S)
            words = self._trouble()
        self.driver.stop()
        return words

    def _trouble(self) -> str:
        since = self._started_s if self._captured_s is None else self._captured_s
        silent_s = self._clock.monotonic() - since
        limit_s = _FIRST_SILENCE_S
        if self._gap_s is not None:
            limit_s = max(_MIN_SILENCE_S, _SILENT_PERIODS * self._gap_s)
        if silent_s > limit_s:
            return f"camera {self.driver.name} has sent nothing for {silent_s:.1f} s"
        return self.driver.lost() if silent_s > _DOUBT_S else ""

    def _sleep(self, seconds: float) -> None:
        """Sleep in short pieces, so that `stop` is noticed."""
        until = self._clock.monotonic() + seconds
        while not self._stopped:
            remaining = until - self._clock.monotonic()
            if remaining <= 0:
                return
            self._clock.sleep(min(remaining, _LOOK_S))
