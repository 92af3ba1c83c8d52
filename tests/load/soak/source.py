"""A live source that gives the next frame as soon as the loop has finished with the last one."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tokt.inference.clock import Clock
from tokt.inference.frame import Frame
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.reason import NO_FAULT, Fault, Reason
from tokt.inference.report import Report

from .plan import FrameKind, time_of
from .synthetic_frames import PICTURES, dark, near, some, water

_TORN = Fault(Reason.INCOMPLETE, "the camera gave 40 of 135 rows")


class SoakSource(Observer):
    """Frames after a plan, each with pixels of its own as from a camera.

    As the last observer of the loop it learns when a frame is done with.

    Parameters
    ----------
    kinds : array of uint8, shape (frames,)
        `soak_plan.plan`.
    clock : Clock
    rest_s : float
        Seconds between a frame's end and the next frame.
    pause_every_s, pause_s : float
        How often no frame comes for a while, and for how long; 0 seconds is never.

    Attributes
    ----------
    pauses : int
    may_end : threading.Event
        The last frame is given once this is set.
    arrived : array of float64, shape (frames,)
        The clock's `monotonic` at each hand-over.
    """

    live = True

    def __init__(
        self,
        kinds: NDArray[np.uint8],
        clock: Clock,
        rest_s: float = 0.0,
        pause_every_s: float = 0.0,
        pause_s: float = 0.0,
    ) -> None:
        self.pauses = 0
        self.may_end = threading.Event()
        # Filled, as zeros alone take no memory until they are written over: that would be growth.
        self.arrived = np.full(len(kinds), 0.0)
        self._kinds = kinds
        self._clock = clock
        self._rest_s = rest_s
        self._pause_every_s = pause_every_s if pause_s else 0.0
        self._pause_s = pause_s
        self._stopped = False
        self._finished: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._pictures = {
            FrameKind.WATER: some(water),
            FrameKind.NEAR: some(near),
            FrameKind.DARK: some(dark),
        }

    def __iter__(self) -> Iterator[Frame]:
        """Frames, until all of the plan were given."""
        paused = self._clock.monotonic()
        last = self._pictures[FrameKind.WATER][0]
        for number, code in enumerate(self._kinds):
            kind = FrameKind(code)
            if number:
                self._finished.get()
            if number == len(self._kinds) - 1:
                self.may_end.wait()
            if self._stopped:
                return
            if self._rest_s:
                self._clock.sleep(self._rest_s)
            due = paused + self._pause_every_s
            # Not among repeated pictures: how long they were the same counts, too.
            if self._pause_every_s and kind is FrameKind.WATER and self._clock.monotonic() > due:
                self._clock.sleep(self._pause_s)
                self.pauses += 1
                paused = self._clock.monotonic()
            if kind not in (FrameKind.SAME, FrameKind.FROZEN):
                last = self._pictures[_LOOKS_LIKE[kind]][number % PICTURES]
            yield self._frame(number, kind, last.copy())

    def _frame(self, number: int, kind: FrameKind, picture: NDArray[np.uint8]) -> Frame:
        torn = kind is FrameKind.TORN
        self.arrived[number] = arrived = self._clock.monotonic()
        return Frame(
            number,
            time_of(number),
            None if torn else picture,
            None,
            _TORN if torn else NO_FAULT,
            timed=True,
            arrived=arrived,
        )

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """The next frame may come."""
        self._finished.put(None)

    def stop(self) -> None:
        """Give no further frame."""
        self._stopped = True
        self.may_end.set()
        self._finished.put(None)


_LOOKS_LIKE = {
    FrameKind.WATER: FrameKind.WATER,
    FrameKind.NEAR: FrameKind.NEAR,
    FrameKind.DARK: FrameKind.DARK,
    FrameKind.TORN: FrameKind.WATER,
    FrameKind.FAILING: FrameKind.WATER,
}
