"""The log of a run: a line for every frame and heartbeat, and the events in a file beside it."""

import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tokt.features.common.arrays import F64, U8
from tokt.features.common.errors import ToktError
from tokt.inference.clock import SYSTEM_CLOCK
from tokt.inference.frame import Frame, pixel_mark
from tokt.inference.policy.policy import Judgement
from tokt.inference.publisher import Observer
from tokt.inference.reason import Fault
from tokt.inference.report import LOG_ONLY, MODEL, START, Event, Report, filler

from .log import JsonLines, LinesApart, LogRotation

LOG_LOST = "log_lost"
"""Event: a file of the log was deleted, replaced or cut short, and is reopened."""

_log_only = filler(LOG_ONLY)


def frame_line(run: str, frame: Frame, judgement: Judgement, report: Report) -> dict[str, Any]:
    """The line of a frame that was judged: every one of `tokt.inference.report.FIELDS`.

    The fields of UDP v2 (udp.md), and what a replay needs to judge the frame again: what the
    policy saw of it, and how long the texture detector took. ``left`` and ``right`` are the
    `pixel_mark` of a picture, or ``{"reason", "words"}`` where there is none.
    """
    left, right = _side(frame.left, frame.left_fault), _side(frame.right, frame.right_fault)
    known = SimpleNamespace(
        run=run, frame=frame, judgement=judgement, report=report, left=left, right=right
    )
    return {**report.fields(), **_log_only(known)}


def heartbeat_line(run: str, report: Report) -> dict[str, Any]:
    """The line of a heartbeat: the fields of v2, ``run``, and ``frame`` None."""
    return {**report.fields(), "run": run, "frame": None}


def event_line(run: str, seq: int, event: Event) -> dict[str, Any]:
    """The line of an event: ``event``, ``t``, ``words``, ``run``, ``seq`` and its own fields.

    ``seq`` is that of the newest report when the event came, 0 before the first.
    """
    line = {"event": event.name, "t": event.t, "words": event.words, "run": run, "seq": seq}
    return {**line, **event.fields}


def json_values(values: F64 | None) -> list[Any] | None:
    """Decision values, exact to the last bit; what is not finite becomes None."""
    if values is None:
        return None
    if np.isfinite(values).all():
        return list(values.tolist())
    return [[v if math.isfinite(v) else None for v in row] for row in values.tolist()]


def _side(picture: U8 | None, fault: Fault) -> str | dict[str, str]:
    if picture is not None:
        return pixel_mark(picture)
    return {"reason": fault.reason.value, "words": str(fault)}


def events_path(log: Path) -> Path:
    """The events' file of a log: ``run.jsonl`` has ``run.events.jsonl``."""
    return log.with_name(f"{log.stem}.events{log.suffix}")


class RunLog(Observer):
    """Write down everything that is said, in the file of this path, and events in `events_path`.

    With `values` frames' lines carry each patch's decision values, exact to the last bit: what
    training and serving can be compared by. If it is `live` nobody waits for the disk, and lines
    are left out where that is too slow. `tell` takes the event `LOG_LOST`, from any thread: a file
    was deleted or replaced. ToktError if a file cannot be opened.
    """

    def __init__(
        self,
        path: Path,
        run: str,
        rotation: LogRotation | None = None,
        values: bool = False,
        live: bool = False,
        tell: Callable[[Event], None] = lambda _: None,
    ) -> None:
        rotation = LogRotation() if rotation is None else rotation
        self._run = run
        self._values = values
        self._seq = 0
        lines = LinesApart if live else JsonLines

        def lost(words: str) -> None:
            tell(Event(SYSTEM_CLOCK.time(), LOG_LOST, words))

        self._frames = lines(path, rotation, tell=lost)
        try:
            self._events = lines(events_path(path), rotation, tell=lost)
        except ToktError:
            self._frames.close()
            raise

    @property
    def failed(self) -> int:
        """Lines that could not be written."""
        return self._frames.failed + self._events.failed

    @property
    def fault(self) -> str:  # type: ignore[override]
        """Why lines are not on the disk at present."""
        # Events are few: whether one could be written now tells the state of their file.
        return self._frames.fault or ("" if self._events.is_open else self._events.fault)

    def judged(self, frame: Frame, judgement: Judgement, report: Report) -> None:
        """A frame's line."""
        self._seq = report.seq
        line = frame_line(self._run, frame, judgement, report)
        if self._values:
            line["decision_values"] = json_values(judgement.decision_values)
        self._frames.write(line)
        self._events.look()

    def heartbeat(self, report: Report) -> None:
        """A heartbeat's line."""
        self._seq = report.seq
        self._frames.write(heartbeat_line(self._run, report))

    def event(self, event: Event) -> None:
        """An event's line."""
        line = event_line(self._run, self._seq, event)
        self._events.write(line)
        if event.name in (START, MODEL):  # without which no frame is judged again
            self._events.header_lines[event.name] = line

    def close(self) -> None:
        """Close both files."""
        self._frames.close()
        self._events.close()
