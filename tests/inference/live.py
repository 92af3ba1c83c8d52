"""A source whose frames a test hands out, the loop it is for, and sockets to hear it with."""

import queue
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.waiting import MAX_S
from tokt.inference.clock import SYSTEM_CLOCK, Clock
from tokt.inference.frame import Frame
from tokt.inference.links.datagrams import DatagramSocket
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.report import Event, Report
from tokt.inference.runtime import Runtime


def bound_socket() -> socket.socket:
    """A UDP socket on a loopback port of its own."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    opened.bind(("127.0.0.1", 0))
    opened.settimeout(MAX_S)
    return opened


BROADCAST = "127.255.255.255"
"""The loopback's, which leaves no computer."""


def refuse(sender: DatagramSocket, refused: bool = True) -> None:
    """Take from a sender to `BROADCAST` its leave to broadcast, so that the system refuses it."""
    sender._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, not refused)


def start_tokt(*arguments: object) -> subprocess.Popen[str]:
    """The command line in a process of its own."""
    command = [sys.executable, "-m", "tokt", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@contextmanager
def looping(runtime: Runtime) -> Iterator[list[Any]]:
    """Run a loop in a thread, then stop its source; its summary or what it raised, in the list."""
    ended: list[Any] = []

    def go() -> None:
        try:
            ended.append(runtime.run())
        except Exception as error:  # noqa: BLE001 - a test looks at it
            ended.append(error)

    thread = threading.Thread(target=go, name="the loop", daemon=True)
    thread.start()
    try:
        yield ended
    finally:
        runtime.source.stop()
        thread.join(MAX_S)


class HandSource:
    """Deliver what `give` is given, at once; `stop` ends it."""

    live = True

    def __init__(self, clock: Clock = SYSTEM_CLOCK) -> None:
        self.clock = clock
        self._frames: queue.Queue[Frame | Exception | None] = queue.Queue()
        self._number = 0
        self.passed_on = 0

    def frame(self, left: NDArray[np.uint8] | None, age_s: float = 0.0, **more: object) -> Frame:
        self._number += 1
        arrived = self.clock.monotonic() - age_s
        now = self.clock.time()
        made = {"right": None, "timed": True, "arrived": arrived, **more}
        return Frame(number=self._number, t=now, left=left, **made)  # type: ignore[arg-type]

    def give(self, left: NDArray[np.uint8] | None, age_s: float = 0.0, **more: object) -> None:
        """Deliver a picture as the next frame."""
        self.deliver(self.frame(left, age_s, **more))

    def deliver(self, frame: Frame) -> None:
        """Deliver a frame that was made before."""
        self._frames.put(frame)

    def fail(self, error: Exception) -> None:
        """Raise in the source's thread."""
        self._frames.put(error)

    def __iter__(self) -> Iterator[Frame]:
        while (item := self._frames.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item
            self.passed_on += 1  # who reads has asked for the next one

    def stop(self) -> None:
        """Deliver no further frame."""
        self._frames.put(None)


class Sent:
    """A receiver in memory."""

    failed = 0
    last_error = ""

    def __init__(self) -> None:
        self.reports: list[Report] = []

    @property
    def sent(self) -> int:
        return len(self.reports)

    def send(self, report: Report) -> None:
        self.reports.append(report)

    def close(self) -> None: ...


class Listener(Observer):
    """Remember everything, and call back after each report."""

    def __init__(self, then: Callable[[Report], None] = lambda report: None) -> None:
        self.reports: list[Report] = []
        self.heartbeats: list[Report] = []
        self.events: list[Event] = []
        self.frames: list[Frame] = []
        self._then = then

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        self.frames.append(frame)
        self.reports.append(report)
        self._then(report)

    def heartbeat(self, report: Report) -> None:
        self.heartbeats.append(report)
        self._then(report)

    def event(self, event: Event) -> None:
        self.events.append(event)
