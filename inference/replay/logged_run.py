"""A run as its log or its recording tells it: its beginning, and its frames one by one."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tokt.features.common.errors import ToktError
from tokt.features.frames.mission import LEFT, RIGHT
from tokt.inference.policy.object_naming import NAMED
from tokt.inference.reason import Fault, Reason
from tokt.inference.recording.log import LogGap, read_log
from tokt.inference.recording.recording import FILE_NAME, read_recording
from tokt.inference.recording.run_log import events_path
from tokt.inference.recording.run_start import ModelName, RunStart
from tokt.inference.report import (
    FIELDS,
    MODEL,
    REPLAYABLE,
    START,
    WITH_MOVING,
    WITH_TREND,
    ReportField,
    is_finite,
)
from tokt.inference.verdict import CLEAR, OBSTACLE, STATUS_WORDS, UNKNOWN

TREND = tuple(each.name for each in FIELDS if each.since in (WITH_TREND, WITH_MOVING))
"""The fields that hang on the frames of the last seconds."""
ANCHOR = tuple(each.name for each in FIELDS if each.name.startswith("anchor"))
"""The fields that hang on all frames since an object was named."""
_LATER = {each.name for each in FIELDS if each.since > REPLAYABLE}
"""What the logs of an older tokt do not have."""


def _place(each: ReportField) -> tuple[bool, ...]:
    """Where a field stands: status and reason, figures, words, and then what came later."""
    late = each.name in _LATER
    return late, not late and each.name not in ("status", "reason"), not late and each.kind is str


VERDICT = tuple(each.name for each in sorted(FIELDS, key=_place) if each.replayed)
"""The fields of v2 that say what was judged, and not when."""


@dataclass(frozen=True)
class LoggedFrame:
    """A frame's line.

    It follows where the line before, if there is one, is that of the frame judged before; the first
    line, where it is the run's first frame.
    """

    seq: int
    number: int  # in its source
    t: float  # seconds since 1970; nan where it was no number
    timed: bool
    missed: int  # as in `tokt.inference.frame.Frame`
    left: str | Fault  # a picture's mark, or why there was none
    right: str | Fault
    texture_s: float | None  # that the texture detector took
    age_s: float | None  # from the frame's arrival to the datagram
    judging_s: float | None  # that it was being judged
    left_out: int  # frames before it that there was no time for
    verdict: Mapping[str, Any]  # `VERDICT`, as JSON, without what an older tokt did not log
    has_values: bool  # whether decision values were logged
    values: list[Any] | None  # these; None where the frame has none
    model: ModelName | None  # what judged it
    exchanged: int  # how often the model had been, even for the same one
    follows: bool
    named: Mapping[str, Any] | None = None  # the event of an object named just before


@dataclass(frozen=True)
class LoggedRun:
    """One run of a log."""

    path: Path  # the log file, or the recording's folder
    run: str
    start: RunStart
    models: tuple[ModelName, ...]  # all that judged in it, in their order
    n_frames: int  # lines of frames
    others: tuple[str, ...]  # the log's other runs, in their order

    @property
    def recorded(self) -> bool:
        """Whether it is a recording, whose pictures lie beside it."""
        return self.path.is_dir()

    def frames(self) -> Iterator[LoggedFrame]:
        """Its frames as they were judged; ToktError if a line is no frame's, or files have gone."""
        model, exchanged, named = self.start.model, 0, None
        continuity = _Recorded() if self.recorded else _Logged()
        gaps: list[LogGap] = []
        for line in logged_lines(self.path, self.run, gaps):
            if "event" in line:
                if line["event"] == NAMED:
                    named = line
                if line["event"] == MODEL:
                    model, exchanged = _model(line, str(self.path)), exchanged + 1
                continue
            follows = continuity.follows(line, len(gaps))
            if _is_frame(line):
                frame = _frame(line, str(self.path), model, exchanged, follows)
                yield replace(frame, named=named)
                named = None


def is_recording(path: Path) -> bool:
    """Whether a folder is that of a run's recording."""
    return (path / FILE_NAME).is_file()


def open_run(path: Path, run: str | None = None) -> LoggedRun:
    """Find a run by its id, by default the last one, in a log or in the folder of a recording.

    ToktError if there is no such log or run, or it does not say how the run began.
    """
    starts, models = _beginnings(path)
    if not starts:
        raise ToktError(f"{path} does not say how a run began (no start event)")
    if run is None:
        run = next(reversed(starts))
    if run not in starts:
        raise ToktError(f"{path} has no run {run} (it has {', '.join(starts)})")
    first = starts[run].model
    named = ([] if first is None else [first]) + models.get(run, [])
    frames = sum(_is_frame(line) for line in logged_lines(path, run, []))
    others = tuple(other for other in starts if other != run)
    return LoggedRun(path, run, starts[run], tuple(dict.fromkeys(named)), frames, others)


def _beginnings(path: Path) -> tuple[dict[str, RunStart], dict[str, list[ModelName]]]:
    """Each run's start, in their order, and the models that it went on with."""
    starts: dict[str, RunStart] = {}
    models: dict[str, list[ModelName]] = {}
    for line in _events(path):
        run, where = _run_of(line), str(path)
        if line.get("event") == START:
            starts[run] = RunStart.from_fields(line, where)
        elif line.get("event") == MODEL:
            models.setdefault(run, []).append(_model(line, where))
    return starts, models


def _run_of(line: Mapping[str, Any]) -> str:
    """The id of a line's run; that of none where a damaged line has no text there."""
    run = line.get("run")
    return run if isinstance(run, str) else ""


def _events(path: Path) -> Iterator[dict[str, Any]]:
    if is_recording(path):
        yield from (line for line in read_recording(path) if "event" in line)
        return
    if path.is_dir():
        raise ToktError(f"{path} is no recording: there is no recording.jsonl in it")
    if not path.exists():
        raise ToktError(f"log {path} does not exist")
    events = events_path(path)
    if not events.exists():
        raise ToktError(f"{path}: how its runs began stands in {events.name}, which is not there")
    yield from read_log(events)


def logged_lines(
    path: Path,
    run: str | None,
    gaps: list[LogGap],
    sound: Callable[[dict[str, Any]], bool] = lambda _: True,
) -> Iterator[dict[str, Any]]:
    """A run's lines, or all runs', that are sound, each event before a frame that came after it.

    Without its events a log has only the others.
    """

    def kept(lines: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        return (line for line in lines if run in (None, line.get("run")) and sound(line))

    if is_recording(path):
        return kept(read_recording(path, gaps))
    events = [] if path.is_file() and not events_path(path).exists() else list(kept(_events(path)))
    return _merged(events, kept(read_log(path, gaps)))


def _merged(
    events: list[dict[str, Any]], lines: Iterator[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """A log's lines, and each event before the first line of its run with a higher `seq`."""
    waiting: dict[str, list[dict[str, Any]]] = {}
    for event in events:
        waiting.setdefault(_run_of(event), []).append(event)
    for line in lines:
        due = waiting.get(_run_of(line), [])
        # Only a frame's: a heartbeat of the other thread may be ahead of a frame's line.
        while due and _is_frame(line) and _whole(due[0], "seq") < _whole(line, "seq"):
            yield due.pop(0)
        yield line
    for rest in waiting.values():
        yield from rest


def _is_frame(line: Mapping[str, Any]) -> bool:
    """Whether a line is a frame's, and no heartbeat's or event's."""
    return "event" not in line and line.get("frame") is not None


def kind_of(line: Mapping[str, Any]) -> str:
    """What a line is: ``frames``, ``heartbeats``, ``events``, or ``damaged`` where a field cannot
    be what it says.
    """
    seq = line.get("seq")
    if not isinstance(line.get("run"), str) or type(seq) is not int or seq < 0:
        return "damaged"
    if "event" in line:
        texts = isinstance(line["event"], str) and isinstance(line.get("words"), str)
        return "events" if texts and is_finite(line.get("t"), (int, float)) else "damaged"
    if all(_fits(each, line) for each in FIELDS) and line.get("status") in STATUS_WORDS:
        return "heartbeats" if line.get("frame") is None else "frames"
    return "damaged"


def _fits(each: ReportField, line: Mapping[str, Any]) -> bool:
    value = line.get(each.name)
    no_picture = each.name in (LEFT, RIGHT) and isinstance(value, dict)
    return value is None or no_picture or each.fits(value)


class _Logged:
    """Whether lines are missing in a log: every report of a run has a number, and a line."""

    def __init__(self) -> None:
        self._lines = 0
        self._missing = 0
        self._gaps = 0

    def follows(self, line: Mapping[str, Any], gaps: int) -> bool:
        """Whether the frame of this line follows the one before it."""
        if self._lines == 0:  # of an earlier run; whether this one's first are lost seq tells
            self._gaps = gaps
        self._lines += 1
        missing = _whole(line, "seq") - self._lines
        # A heartbeat's line may come before that of a frame with a lower number.
        if not _is_frame(line):
            return True
        broken = missing > self._missing or gaps > self._gaps
        self._missing, self._gaps = max(missing, self._missing), gaps
        return not broken


class _Recorded:
    """Whether frames are missing in a recording, which counts those that were judged."""

    def __init__(self) -> None:
        self._judged = 0

    def follows(self, line: Mapping[str, Any], gaps: int) -> bool:
        """Whether the frame of this line follows the one before it."""
        before, self._judged = self._judged, _whole(line, "judged")
        return self._judged == before + 1


def _model(line: Mapping[str, Any], where: str) -> ModelName:
    label, sha256 = line.get("label"), line.get("sha256")
    if not isinstance(label, str) or not isinstance(sha256, str):
        raise ToktError(f"{where}: an event says that the model was exchanged, but not for which")
    return ModelName(label, sha256)


def _frame(
    line: Mapping[str, Any], where: str, model: ModelName | None, exchanged: int, follows: bool
) -> LoggedFrame:
    try:
        t = _seconds(line, "t", 1.0)
        return LoggedFrame(
            seq=_whole(line, "seq"),
            number=_whole(line, "frame"),
            t=math.nan if t is None else t,
            timed=bool(line["timed"]),
            missed=_whole(line, "missed"),
            left=_side(line["left"]),
            right=_side(line["right"]),
            texture_s=_seconds(line, "texture_s", 1.0),
            age_s=_seconds(line, "age_ms", 1000.0),
            judging_s=_seconds(line, "latency_ms", 1000.0),
            left_out=_whole(line, "left_out"),
            verdict=_verdict(line),
            has_values="decision_values" in line,
            values=line.get("decision_values"),
            model=model,
            exchanged=exchanged,
            follows=follows,
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        detail = f"{type(error).__name__}: {error}"
        raise ToktError(f"{where}: a frame's line lacks what a replay needs ({detail})") from None


def _verdict(line: Mapping[str, Any]) -> dict[str, Any]:
    verdict = {name: line[name] for name in VERDICT if name in line or name not in _LATER}
    if verdict["status"] not in (OBSTACLE, CLEAR, UNKNOWN):
        raise ValueError(f"there is no status {verdict['status']!r}")
    if not isinstance(verdict["reason"], str):
        raise TypeError(f"{verdict['reason']!r} is no reason")
    return verdict


def _whole(line: Mapping[str, Any], name: str) -> int:
    value = line.get(name)
    if type(value) is not int or value < 0:
        raise ToktError(f"a line of the log has no {name!r}: it is not of this tokt's run")
    return value


def _side(value: Any) -> str | Fault:
    if isinstance(value, str):
        return value
    return Fault(Reason(value["reason"]), str(value["words"]))


def _seconds(line: Mapping[str, Any], name: str, per_s: float) -> float | None:
    """A duration, such that `per_s` times it is the logged number to the last bit.

    Words of a verdict, and whether it came in time, hang on that product.
    """
    value = line[name]
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name} is {value!r}, no number")
    seconds = value / per_s
    nearby = (seconds, math.nextafter(seconds, math.inf), math.nextafter(seconds, -math.inf))
    return next((near for near in nearby if per_s * near == value), seconds)
