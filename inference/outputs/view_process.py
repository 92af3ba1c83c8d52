"""The process of the live view: takes moments from the runtime, draws, serves, writes the video.

One of its own at a lower priority: whoever looks, and however many, the loop does no more than hand
over a reference, and what crashes or hangs here is no part of the run.
"""

import os
import signal
import socket
import threading
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue

import cv2

from tokt.inference.clock import SYSTEM_CLOCK

from .view_picture import ViewMoment, ViewState
from .view_server import Pictures, ViewServer
from .view_video import ViewVideo

NICENESS = 10
REDRAW_S = 0.25
"""Seconds after which the same is drawn anew, with its age."""
_LAST_S = 0.5


def serve(
    connection: Connection,
    listener: socket.socket | None,
    token: str | None,
    part: Path | None,
    stale_s: float,
) -> None:
    """Show what comes until there is no more; what the process runs.

    It answers that it has begun, and each moment once that is drawn: with why the video is not
    written to `part`, or nothing, and the box that was drawn meanwhile, if one was.
    """
    # Who started it ends it, when the pipe closes.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    cv2.setNumThreads(1)
    pictures, state = Pictures(), ViewState(stale_s)
    video = None if part is None else ViewVideo(part)
    server = None if listener is None else ViewServer(listener, token, pictures)
    came: SimpleQueue[ViewMoment | str] = SimpleQueue()
    threading.Thread(target=_read, args=(connection, came), daemon=True).start()
    connection.send("")
    while not state.ended:
        found = None
        with suppress(Empty):
            found = came.get(timeout=REDRAW_S)
        moment = found if isinstance(found, ViewMoment) else None
        state.ended = found if isinstance(found, str) else ""
        if state.ended and server is not None:
            server.shutdown()
            server.server_close()  # a run that a watchdog starts at once wants the port
        _show(state, moment, pictures, video)
        if moment is not None:
            with suppress(OSError):  # that the run is gone is seen by who reads
                drawn = () if server is None or not server.drawn else (server.drawn.pop(),)
                connection.send(("" if video is None else video.fault, *drawn))
    if video is not None:
        video.close()
    if pictures.watched:
        time.sleep(_LAST_S)  # for who looks to get the last one


def _show(
    state: ViewState, moment: ViewMoment | None, pictures: Pictures, video: ViewVideo | None
) -> None:
    """Draw what there is now, for who looks."""
    now = arrived_s = SYSTEM_CLOCK.monotonic()
    if moment is not None:
        state.take(moment)
        arrived_s = moment.arrived_s
    films = video is not None and not video.fault and state.picture is not None
    if not (films or pictures.watched):
        return
    shown = state.shown(now)
    picture = state.draw(shown, now)
    if video is not None and films:
        video.add(picture, arrived_s)
    if pictures.watched:
        jpeg = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, 80))[1].tobytes()
        pictures.put(jpeg, shown, now)


def _read(connection: Connection, came: SimpleQueue[ViewMoment | str]) -> None:
    """Pass moments on, and how they ended: half a one in the pipe keeps no picture waiting."""
    ended = "the run is over"
    try:
        while (moment := connection.recv()) is not None:
            came.put(moment)  # no more than one waits: the run waits for the answer
    except (EOFError, OSError):
        ended = "the run died"
    came.put(ended)
