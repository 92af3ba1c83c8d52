"""The live view (``--view``, ``--view-record``): what the loop sees, passed on to its process.

::

    loop ──> newest frame ──> thread ──pipe──> process: draws, serves, writes the video
             (never a queue)    │ <──drawn────────┘
                                └──> starts it again when it dies or hangs
"""

import math
import multiprocessing
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from urllib.parse import quote

from tokt.features.common.address import resolve, shown_host
from tokt.features.common.arrays import U8
from tokt.features.common.errors import ToktError, os_errors_as, os_words
from tokt.inference.clock import SYSTEM_CLOCK, awake_s
from tokt.inference.frame import Frame, shape_fault
from tokt.inference.policy.object_model import Box, detail_picture
from tokt.inference.policy.object_naming import REFUSED, ObjectNaming
from tokt.inference.policy.object_tracker import HELD
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.report import MODEL, START, Event, Report

from .view_picture import ViewMoment, fitted
from .view_process import serve
from .view_video import new_video

LOOPBACK = "127.0.0.1"
VIEW_LOST, VIDEO_FAILED = "view_lost", "video_failed"
"""Events: the process died or hung, and is started again; the video is not written any more."""

START_S, ANSWER_S = 60.0, 5.0
"""Seconds after which the process is taken for hung: as it starts, and later."""
_PERIOD_S, _POLL_S = 1 / 15, 0.02
_PAUSE_S, _CLOSE_S = 5.0, 2.0
_KEPT_STATUSES = 2000
_KEPT_FRAMES = 150  # at least 10 s, in which a box is drawn


def listening(host: str, port: int) -> socket.socket:
    """A socket that listens there; ToktError if the port is taken, or the address not ours."""
    if not 0 <= port <= 65535:
        raise ToktError(f"--view is a port, 1 to 65535, not {port}")
    family, address = resolve(host, port)
    with os_errors_as(f"the view cannot be served on {host}:{port}"):
        return socket.create_server(address[:2], family=family)


def view_url(host: str, port: int, token: str | None) -> str:
    """What a person opens; holds the token, if one is needed."""
    asks = "" if token is None else f"?token={quote(token, safe='')}"
    return f"http://{shown_host(host)}:{port}/{asks}"


@dataclass(eq=False)
class LiveView(Observer):
    """Pass what the loop sees on to the view's process, and keep that alive.

    Raises ToktError if the video is no ``.mp4``, its file cannot be made, or PyAV is not installed.
    """

    listener: socket.socket | None  # to serve on; closed by `close`
    token: str | None  # that a request has to show
    record: Path | None  # of the video
    stale_s: float  # from which age on a frame is old
    tell: Callable[[Event], None]  # from another thread
    naming: ObjectNaming  # of the object to hold

    def __post_init__(self) -> None:
        if self.record is not None and self.record.suffix.lower() != ".mp4":
            raise ToktError(f"--view-record writes an .mp4 file, not {self.record.name!r}")
        if self.record is not None and find_spec("av") is None:
            raise ToktError("--view-record needs the extra 'video'")
        self._part = None if self.record is None else new_video(self.record)
        # No lock: the loop would wait for whoever has it, should that be kept from the processor.
        self._newest: deque[ViewMoment] = deque(maxlen=1)
        self._statuses: deque[tuple[float, int]] = deque(maxlen=_KEPT_STATUSES)
        self._shown: deque[tuple[int | None, U8]] = deque(maxlen=_KEPT_FRAMES)
        self._refused = self._model = ""
        self._ended = threading.Event()
        self._told: set[str] = set()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._hung_at = math.inf
        self._thread = threading.Thread(target=self._run, name="tokt view", daemon=True)
        self._thread.start()

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """Remember the frame as the newest; nothing is copied here."""
        now = SYSTEM_CLOCK.monotonic()
        arrived_s = now if frame.arrived is None else frame.arrived
        held = judgement.held if report.verdict.anchor == HELD else None
        seen = frame.left, judgement.mask, judgement.grid, held, self._refused, self._model
        self._put(ViewMoment(report, now, arrived_s, (), *seen, no_view=frame.mask("left")))

    def heartbeat(self, report: Report) -> None:
        """Remember that unknown was said."""
        now = SYSTEM_CLOCK.monotonic()
        arrived_s = now - (report.age_ms or 0.0) / 1000
        self._put(ViewMoment(report, now, arrived_s, (), model=self._model))

    def event(self, event: Event) -> None:
        """Note which model runs."""
        if event.name in (START, MODEL):
            self._model = str(event.model["label"]) if event.model else ""

    def _put(self, moment: ViewMoment) -> None:
        self._statuses.append((moment.said_s, moment.report.verdict.status))
        self._newest.append(moment)
        if awake_s(SYSTEM_CLOCK) > self._hung_at and self._process is not None:
            self._process.kill()

    def close(self) -> None:
        """Have the last picture say that the run is over, and end the process."""
        self._ended.set()
        self._thread.join(_CLOSE_S)
        if self._process is not None and self._thread.is_alive():
            self._process.kill()
            self._thread.join(_CLOSE_S)
        if self.listener is not None:
            self.listener.close()

    def _run(self) -> None:
        """Start the process again and again, until the run is over; what the thread does."""
        while True:
            why = self._one_process()
            if self._ended.is_set():
                return
            self.fault = f"its process ended: {why}"
            self._say(VIEW_LOST, f"the live view is started again: {why}")
            if self._ended.wait(_PAUSE_S):
                return
            if self.record is not None and self._part is None:
                try:
                    self._part = new_video(self.record)
                except ToktError as error:
                    self._say(VIDEO_FAILED, str(error))

    def _one_process(self) -> str:
        """Start it and pass moments on, until the run is over or it is; why it is."""
        spawning = multiprocessing.get_context("spawn")
        ours, theirs = spawning.Pipe()
        does = (theirs, self.listener, self.token, self._part, self.stale_s)
        made = spawning.Process(target=serve, args=does, name="tokt view", daemon=True)
        self._hung_at = awake_s(SYSTEM_CLOCK) + START_S
        with closing(ours):
            try:
                with closing(theirs):
                    made.start()
            except OSError as error:
                return f"its process cannot be started: {os_words(error)}"
            self._process, self._part = made, None
            with suppress(EOFError, OSError):
                self._pass_on(ours)
        made.join(_CLOSE_S)
        made.kill()  # Python would wait at its end for one that is still there
        made.join(_CLOSE_S)
        hung, self._hung_at = awake_s(SYSTEM_CLOCK) > self._hung_at, math.inf
        return "its process did not answer" if hung else f"exit code {made.exitcode}"

    def _pass_on(self, connection: Connection) -> None:
        connection.recv()  # it has begun
        self.fault = ""
        while True:
            self._hung_at = math.inf
            found = self._next()
            self._hung_at = awake_s(SYSTEM_CLOCK) + ANSWER_S
            connection.send(found)
            if found is None:
                return
            fault, *drawn = connection.recv()
            for frame, box in drawn:
                self._name(frame, box)
            if fault:
                self._say(VIDEO_FAILED, f"the video is not written: {fault}")

    def _name(self, number: int, box: Box) -> None:
        """Name what is in a box of a frame that was shown."""
        self._refused = ""
        try:
            detail = dict(self._shown).get(number)
            if detail is None:
                raise ToktError(f"frame {number} is not kept any more: draw again")
            self.naming.name(number, detail, box)
        except ToktError as error:
            self._refused = str(error)
            self.tell(Event(SYSTEM_CLOCK.time(), REFUSED, self._refused))

    def _next(self) -> ViewMoment | None:
        """The newest, waiting for one; None when the run is over."""
        self._ended.wait(_PERIOD_S)  # no more are shown
        while not self._newest:
            if self._ended.wait(_POLL_S):
                return None
        moment = self._newest.pop()
        said = tuple(self._statuses.popleft() for _ in range(len(self._statuses)))
        left = moment.picture
        picture = None if left is None or shape_fault(left) else fitted(left)
        if left is not None and picture is not None and self.listener is not None:
            with suppress(ToktError):
                self._shown.append((moment.report.frame, detail_picture(left)))
        return replace(moment, statuses=said, picture=picture)

    def _say(self, name: str, words: str) -> None:
        if name not in self._told:
            self._told.add(name)
            self.tell(Event(SYSTEM_CLOCK.time(), name, words))
