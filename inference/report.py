"""One frame's report, the table of its fields for datagrams, logs and metrics, and other events."""

import json
import math
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar

from tokt.inference.links.vehicle import VehiclePlace

from .reason import Reason
from .verdict import Verdict

V2 = 2
START, MODEL = "start", "model"
"""Events: a run began, another model runs."""
HEALTH_BYTES, MODEL_BYTES, CLASSES_BYTES = 250, 420, 500
"""Longest health text, model name and classes that are sent or logged, in the bytes that JSON takes
for them: every model's name of ASCII is whole. A datagram without classes fits one Ethernet frame,
`DATAGRAM_BYTES`; they are left out where it does not fit with them."""
DATAGRAM_BYTES = 1472

FIRST, REPLAYABLE, WITH_TREND, WITH_ANCHOR, WITH_BOUNDARY, WITH_PLACE, WITH_CLASSES = range(1, 8)
WITH_MOVING, WITH_ANCHOR_STATE, WITH_SIGHT, WITH_FILE = 8, 9, 10, 11
"""Versions of the table (`SINCE` says what each brought). A new field gets a new version and stands
at the end of its datagram or log line, where every older reader leaves it out."""


@dataclass(frozen=True)
class ReportField:
    """One field of what is said about a frame; `MEANINGS` explains it."""

    name: str
    kind: type  # in JSON: int, float, str, bool, list for a box of four ints, or dict for lists of
    # numbers by class
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
        if self.kind is dict:
            kept = {name: list(numbers) for name, numbers in value.items()}
            while self.max_bytes and len(json.dumps(kept, separators=(",", ":"))) > self.max_bytes:
                kept.popitem()
            return kept
        if self.max_bytes:  # as JSON of ASCII, without its quotes
            value = value[: self.max_bytes]
            while len(json.dumps(value)) - 2 > self.max_bytes:
                value = value[:-1]
        return value.value if isinstance(value, Reason) else value

    def fits(self, value: Any) -> bool:
        """Whether a JSON value other than None can be this field's."""
        if self.kind is list:
            return isinstance(value, list) and len(value) == 4 and all(map(is_finite, value))
        if self.kind is dict:
            lists = value.values() if isinstance(value, dict) else (value,)
            return all(isinstance(each, list) and _are_finite(each) for each in lists)
        if self.kind is float:
            return is_finite(value, (int, float))
        return is_finite(value) if self.kind is int else isinstance(value, self.kind)


def is_finite(value: Any, kinds: type | tuple[type, ...] = int) -> bool:
    """Neither NaN, nor infinite (1e999 is, to a JSON parser), nor whole but beyond any float."""
    number = isinstance(value, kinds) and not isinstance(value, bool)
    return number and abs(value) <= sys.float_info.max


def _are_finite(values: list[Any]) -> bool:
    return all(is_finite(each, (int, float)) for each in values)


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
    _verdict("classes", dict, unit="px", since=WITH_CLASSES, max_bytes=CLASSES_BYTES),
    _verdict("moving", float, since=WITH_MOVING),
    _verdict("anchor", str, since=WITH_ANCHOR_STATE),
    _verdict("sight", dict, since=WITH_SIGHT),
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
    _log("class_patches", dict, "judgement.class_patches", since=WITH_CLASSES),
    _log("file", str, "frame.file", since=WITH_FILE),
)
"""All of them, in the order in which they are written."""
MEANINGS = {
    "v": "version of the format: 2",
    "seq": "1 for a run's first datagram, then rising by one a datagram, heartbeats included",
    "t": "since 1970, UTC, when the frame came; in a heartbeat the newest frame; null before any",
    "status": "1 obstacle, 0 clear, -1 unknown",
    "x": "-(cx - width // 2) in pixels of the mask: the way to steer; null when unknown",
    "y": "-(cy - height // 2) in pixels of the mask: the way to steer; null when unknown",
    "box": "[x0, y0, width, height] around everything seen, in pixels of the mask",
    "mean": "mean of the mask, whose pixels are 0 or 255",
    "distance_m": "distance of the near end: the nearest fifth, or twentieth of pushbroom's",
    "method": "texture, disparity, pushbroom, two of them joined by +, or none",
    "model": "name/version of the model that judged; cut at 420 bytes of the datagram",
    "latency_ms": "from when the frame was taken up to its verdict; null in a heartbeat",
    "health": "ok, or what is not as it should be, or that the frame rule waits or holds; cut at "
    "250 bytes of the datagram",
    "closing_m_s": "speed at which the distance falls; negative where it grows",
    "contact_s": "until the distance is 0 at that speed, where it falls",
    "reason": "why a verdict is unknown, or what one that stands had to do without",
    "age_ms": "from the frame's arrival in the program to this datagram; null where not known",
    "trend": "growing, steady or shrinking: the mean over the last seconds; null where not known",
    "trend_confidence": "how sure the trend is, 0.5 to 1",
    "expansion_contact_s": "until what is seen is reached, from how the mean grows",
    "anchor_x": "of --anchor: the object's centre from the frame's, -1 to 1, right positive",
    "anchor_y": "of --anchor: the object's centre from the frame's, -1 to 1, down positive",
    "anchor_size": "of --anchor: ln of the wanted distance over the distance; positive too near",
    "depth_m": "of the vehicle below the surface; null where unknown, doubtful or 2 s old",
    "heading_deg": "of the vehicle, clockwise from north; null where unknown, doubtful or 2 s old",
    "lat_deg": "of the vehicle, north positive; null where unknown, doubtful or 2 s old",
    "lon_deg": "of the vehicle, east positive; null where unknown, doubtful or 2 s old",
    "classes": "for each class seen but water the box around its patches, x0, y0, width, height, "
    "and its share of the mask. Null without a model of several classes. Obstacles come first, "
    "then the largest; what is beyond 500 bytes, or the datagram, is left out",
    "moving": "share of the view, 0 to 1, that moving things cover. Null without times of frames, "
    "in the first three pairs, and where the water shows too few points",
    "anchor": "held, searching or lost: the object that somebody named; null without one, and in "
    "heartbeats",
    "sight": "seen: part of the view in which an obstacle would be seen, 0 to 1. blind: box around "
    "the largest part where none would be: x0, y0, width, height, as parts of the view. masked: "
    "part of it that is no view. visibility: contrast of the last 15 frames over the training "
    "frames'. visibility_m: how far off stereo has matched anything in as many pairs. Null in "
    "heartbeats, and where nothing was looked at",
    "run": "the run's id: a log holds run after run",
    "frame": "the frame's number in its source; null in a heartbeat's line",
    "missed": "frames not delivered since the one before",
    "left_out": "those of the missed frames that the loop had no time for",
    "timed": "whether t tells frames' times apart as they were taken",
    "texture_s": "time that the texture model took, where the verdict depends on it",
    "left": "mark of the picture (CRC-32 of every 32nd row), or why there is none: reason, words",
    "right": "the same of the right camera's picture",
    "boundary": "score at which water ended in this frame; null where no boundary moves",
    "place_age_ms": "age of the oldest of depth, heading, latitude and longitude; null without any",
    "roll_deg": "of the vehicle, starboard down positive",
    "pitch_deg": "of the vehicle, bow up positive",
    "vehicle_t": "the vehicle's clock: since 1970, UTC",
    "captured_t": "when the frame was taken, since 1970, by the stream's sender, where it tells",
    "class_patches": "for each class seen its patches, numbered row by row from 0",
    "file": "name of the left picture's file; null where the frame had none of its own",
}
"""What each field says, by name: docs/reference/report.md is made from it."""
SINCE = {
    FIRST: "the first datagrams",
    REPLAYABLE: "the first logs that `tokt replay` reads",
    WITH_TREND: "a trend",
    WITH_ANCHOR: "an anchor",
    WITH_BOUNDARY: "a boundary that moves",
    WITH_PLACE: "the vehicle's place",
    WITH_CLASSES: "the classes seen",
    WITH_MOVING: "moving things",
    WITH_ANCHOR_STATE: "an object that is named",
    WITH_SIGHT: "what is seen of the view",
    WITH_FILE: "the frame's file",
}
"""What each version of the table brought."""
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
        """The fields of UDP v2."""
        return dict(self._fields)

    @cached_property
    def _fields(self) -> dict[str, Any]:
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

    @property
    def model(self) -> Mapping[str, Any] | None:
        """The model that a `START` or a `MODEL` event tells of, or None."""
        told = self.fields.get("model") if self.name == START else self.fields
        return told or None


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
