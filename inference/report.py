"""One frame's report, the table of its fields for datagrams, logs and metrics, and other events."""

import json
import math
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, ClassVar

from tokt.inference.links.vehicle import VehiclePlace

from .reason import Reason
from .verdict import Verdict

V2 = 2
HEALTH_BYTES, MODEL_BYTES = 300, 420
"""Longest health text and model name that are sent or logged, in the bytes that JSON takes for
them: any datagram fits one Ethernet frame (1472), and every model's name of ASCII is whole."""

FIRST, REPLAYABLE, WITH_TREND, WITH_ANCHOR, WITH_BOUNDARY, WITH_PLACE = 1, 2, 3, 4, 5, 6
"""Versions of the table: the first datagrams, the first logs that can be replayed, and those since
a trend, an anchor, a boundary that moves and the vehicle's place. A new field gets a new version
and stands at the end of its datagram or log line, where every older reader leaves it out."""


@dataclass(frozen=True)
class ReportField:
    """One field of what is said about a frame; udp.md and logs_and_metrics.md explain it."""

    name: str
    kind: type  # in JSON: int, float, str, bool, or list for a box of four ints
    filled: str  # where a `Report` has its value; of log lines only: where `recording.run_log` has
    nullable: bool = True
    unit: str = ""
    since: int = FIRST  # older datagrams and logs do not have it
    v1: bool = False  # whether datagrams of that version have it; logs have every field
    v2: bool = True
    metric: str = ""  # what tells it among the metrics, without ``tokt_``
    replayed: bool = False  # it says what was judged, and not when: a replay compares it
    max_bytes: int = 0  # where its text is cut, if it is

    def as_json(self, value: Any) -> Any:
        """A value as JSON has it: not a number that is not finite, of a long text the beginning."""
        if value is None:
            return None
        if self.kind is float:
            return value if math.isfinite(value) else None
        if self.kind is list:
            return list(value)
        if self.max_bytes:  # as JSON of ASCII, without its quotes
            value = value[: self.max_bytes]
            while len(json.dumps(value)) - 2 > self.max_bytes:
                value = value[:-1]
        return value.value if isinstance(value, Reason) else value

    def fits(self, value: Any) -> bool:
        """Whether a JSON value other than None can be this field's."""
        if self.kind is list:
            return isinstance(value, list) and len(value) == 4 and all(map(_is_finite, value))
        if self.kind is float:
            return _is_finite(value, (int, float))
        return _is_finite(value) if self.kind is int else isinstance(value, self.kind)


def _is_finite(value: Any, kinds: type | tuple[type, ...] = int) -> bool:
    """Neither NaN, nor infinite (1e999 is, to a JSON parser), nor whole but beyond any float."""
    number = isinstance(value, kinds) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max


def _verdict(name: str, kind: type, **more: Any) -> ReportField:
    """What a replay compares."""
    return ReportField(name, kind, f"verdict.{name}", replayed=True, **more)


def _log(name: str, kind: type, filled: str, **more: Any) -> ReportField:
    """What only log lines have."""
    return ReportField(name, kind, filled, since=more.pop("since", REPLAYABLE), v2=False, **more)


FIELDS = (
    ReportField("v", int, "v", nullable=False),
    ReportField("seq", int, "seq", nullable=False),
    ReportField("t", float, "t", unit="s"),
    _verdict("status", int, nullable=False, v1=True, metric="status"),
    _verdict("x", int, unit="px", v1=True),
    _verdict("y", int, unit="px", v1=True),
    _verdict("box", list, unit="px"),
    _verdict("mean", float, v1=True),
    _verdict("distance_m", float, unit="m"),
    _verdict("method", str, nullable=False),
    _verdict("model", str, metric="model_info", max_bytes=MODEL_BYTES),
    ReportField("latency_ms", float, "latency_ms", unit="ms", metric="verdict_latency_seconds"),
    _verdict("health", str, nullable=False, max_bytes=HEALTH_BYTES),
    _verdict("closing_m_s", float, unit="m/s", since=REPLAYABLE),
    _verdict("contact_s", float, unit="s", since=REPLAYABLE),
    _verdict("reason", str, nullable=False, since=REPLAYABLE, metric="verdicts_total"),
    ReportField(
        "age_ms", float, "age_ms", unit="ms", since=REPLAYABLE, metric="datagram_age_seconds"
    ),
    _verdict("trend", str, since=WITH_TREND),
    _verdict("trend_confidence", float, since=WITH_TREND),
    _verdict("expansion_contact_s", float, unit="s", since=WITH_TREND),
    _verdict("anchor_x", float, since=WITH_ANCHOR),
    _verdict("anchor_y", float, since=WITH_ANCHOR),
    _verdict("anchor_size", float, since=WITH_ANCHOR),
    ReportField("depth_m", float, "place.depth_m", unit="m", since=WITH_PLACE),
    ReportField("heading_deg", float, "place.heading_deg", unit="deg", since=WITH_PLACE),
    ReportField("lat_deg", float, "place.lat_deg", unit="deg", since=WITH_PLACE),
    ReportField("lon_deg", float, "place.lon_deg", unit="deg", since=WITH_PLACE),
    _log("run", str, "run", nullable=False),
    _log("frame", int, "report.frame"),
    _log("missed", int, "frame.missed", nullable=False, metric="frames_missed_total"),
    _log("left_out", int, "report.left_out", nullable=False, metric="frames_left_out_total"),
    _log("timed", bool, "frame.timed", nullable=False),
    _log("texture_s", float, "judgement.texture_s", unit="s"),
    _log("left", str, "left", nullable=False),
    _log("right", str, "right", nullable=False),
    _log("boundary", float, "judgement.boundary", since=WITH_BOUNDARY),
    _log("place_age_ms", float, "report.place.age_ms", unit="ms", since=WITH_PLACE),
    _log("roll_deg", float, "report.place.roll_deg", unit="deg", since=WITH_PLACE),
    _log("pitch_deg", float, "report.place.pitch_deg", unit="deg", since=WITH_PLACE),
    _log("vehicle_t", float, "report.place.vehicle_t", unit="s", since=WITH_PLACE),
    _log("captured_t", float, "frame.captured_t", unit="s", since=WITH_PLACE),
)
"""All of them, in the order in which they are written."""
V1_FIELDS = tuple(each for each in FIELDS if each.v1)
V2_FIELDS = tuple(each for each in FIELDS if each.v2)
LOG_ONLY = tuple(each for each in FIELDS if not each.v2)


def filler(of: Sequence[ReportField]) -> Callable[[Any], dict[str, Any]]:
    """What turns an object that has the values of some fields into these, JSON."""
    values_of = attrgetter(*(each.filled for each in of))

    def fill(told: Any) -> dict[str, Any]:
        values = zip(of, values_of(told), strict=True)
        return {each.name: each.as_json(value) for each, value in values}

    return fill


_v2 = filler(V2_FIELDS)


@dataclass(frozen=True)
class Report:
    """What is said about one frame, or, as a heartbeat, of there being none.

    A heartbeat has no number, and time and age of the newest frame, or None before the first.
    """

    seq: int  # 1 for a run's first report, then rising by one, whatever was sent
    frame: int | None  # its number in its source
    t: float | None  # seconds since 1970 (UTC) when the source delivered it
    latency_ms: float | None  # from when it was taken up to its verdict
    verdict: Verdict
    age_ms: float | None = None  # from its arrival in this process to the datagram
    left_out: int = 0  # frames just before it that there was no time for
    place: VehiclePlace = VehiclePlace()  # noqa: RUF009 - frozen; where the vehicle was then
    v: ClassVar[int] = V2

    def fields(self) -> dict[str, Any]:
        """The fields of UDP v2 (docs/reference/udp.md)."""
        return _v2(self)


_MAX_WAITING = 1000
"""Events that wait at most; the oldest are lost, which a loop that comes round never sees."""


@dataclass(frozen=True)
class Event:
    """Something that happened besides frames, such as a new model."""

    t: float  # seconds since 1970 (UTC)
    name: str  # what kind, for programs: ``start``, ``model``, ``camera_lost``, ...
    words: str  # one line for people
    fields: Mapping[str, Any] = field(default_factory=dict)  # JSON: the figures that belong to it


class EventQueue:
    """Collect events until the loop passes them on between two frames."""

    def __init__(self) -> None:
        self._waiting: deque[Event] = deque(maxlen=_MAX_WAITING)

    def put(self, event: Event) -> None:
        """Add one; from any thread, and while others are being passed on."""
        self._waiting.append(event)

    def take(self) -> list[Event]:
        """Those that wait, oldest first."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]
