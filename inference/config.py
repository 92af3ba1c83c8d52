"""The description of a run: each option of `tokt run`, stated once.

The command line, configuration files, ``--print-config`` and the log's start event are made from
the fields here. An option's name is its field's, with dashes: ``stereo_scale`` is
``--stereo-scale`` and the key ``stereo-scale`` of the table ``[stereo]``.
"""

# Annotations are no strings here: types are read at run time.
# ruff: noqa: RUF009 - `option` makes a field.

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any, Self, get_args, get_origin

from tokt.features.common.address import without_credentials
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.models.pretrained.packaged import packaged_bundle

STALE_S = 0.5
"""Seconds after which a frame is old, and nothing said is too long: what ``--stale`` and
``--heartbeat`` are by default."""

BM, SGBM = "bm", "sgbm"
"""OpenCV's block matching and semi-global matching, as ``--stereo`` names them."""
MATCHERS = (BM, SGBM)
DEFAULT_SCALE = 0.5
"""Width of the views that are matched over the frames' width."""

MOVING = NEAR, ALL, NONE = "near", "all", "none"
"""What ``--moving`` can be."""

CAMERAS = "live cameras (--source pymba:ID, vimbax:ID or genicam:ID)"
VIDEO = "network video and USB cameras"
LIVE = "live cameras and network video"
FILES = "recorded frames"
PICTURES = "recorded frames and live cameras"
REAL_TIME = "live cameras, or recorded frames with --rate"
MODELS = "the policies that use a model"


@dataclass(frozen=True)
class Limits:
    """When the runtime no longer believes what it sees; ToktError if a time is not positive."""

    stale_s: float = STALE_S  # since a frame's arrival; from then on it is clear no more
    heartbeat_s: float = STALE_S  # without a report; then unknown is said
    # Times that a camera may repeat its picture exactly, which its noise forbids; and no longer
    # than `stale_s`, where frames have times.
    frozen_repeats: int = 5

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (math.isfinite(value) and value > 0):
                raise ToktError(f"{item.name} is a positive number, not {value}")


@dataclass(frozen=True)
class Option:
    """One option of `tokt run`."""

    text: str  # for ``--help``
    metavar: str = ""  # what stands for its value there: a name such as SECONDS, or a|b|c
    needs: tuple[str, ...] = ()  # other options, of which it needs one to do anything
    only: str = ""  # the runs in which it does anything: `CAMERAS`, `FILES`, ...
    not_with: tuple[str, ...] = ()  # options that say the same thing otherwise
    logged: str = ""  # its name in the log's start event (`tokt.inference.recording.run_start`)
    # As its field has them.
    name: str = ""
    section: str = ""
    annotation: Any = None
    default: Any = None

    @property
    def key(self) -> str:
        """Its name for users: of ``--key``, and in a configuration file."""
        return self.name.replace("_", "-")

    @property
    def many(self) -> bool:
        """Whether it may be repeated: a list in a file."""
        return any(get_origin(each) is list for each in get_args(self.annotation))

    @property
    def kind(self) -> Any:
        """bool, int, float, str or Path: of the value, or of each of several."""
        kind = self.annotation
        while inner := get_args(kind):
            kind = inner[0]
        return kind

    def typed(self, value: Any) -> Any:
        """A value as the field has it: a path may be text, a time a whole number."""
        if value is None or self.kind in (bool, int):
            return value
        if self.many:
            return [value] if isinstance(value, str) else [*value]
        return self.kind(value)


def option(default: Any, text: str, metavar: str = "", **more: Any) -> Any:
    """A section's field; the others are `Option`'s."""
    return field(default=default, metadata={"option": Option(text, metavar, **more)})


@dataclass(frozen=True)
class SourceConfig:
    """Where frames come from."""

    source: str = option(
        "",
        "Required. A folder of frames, a video file, network video (rtsp://HOST/PATH, "
        "rtp://:PORT, udp://:PORT, http://HOST/PATH) or a USB camera (v4l2:/dev/video0). "
        "Live cameras are pymba:ID, vimbax:ID or genicam:ID; two are LEFT,RIGHT. Another "
        "program's frames are stream:HOST:PORT.",
        logged="source",
    )
    frames: str | None = option(None, "Use these frames, such as 61-80,141-160.", only=FILES)
    rate: float | None = option(
        None, "Replay at this rate; late frames are dropped.", "FPS", only=FILES
    )
    pixel_format: str | None = option(
        None,
        "Live cameras: their pixel format. Gray image files: the raw camera pixels they hold, "
        "Mono8, BayerRG8, BayerGR8, BayerGB8 or BayerBG8.",
        only=PICTURES,
        logged="pixel_format",
    )
    exposure_us: float | None = option(None, "Live cameras: exposure time.", "US", only=CAMERAS)
    gain_db: float | None = option(None, "Live cameras: gain.", "DB", only=CAMERAS)
    packet_size: int | None = option(
        None, "Live cameras: packet size. Default: the largest that fits.", "BYTES", only=CAMERAS
    )
    bandwidth: float | None = option(
        None, "Live cameras: bandwidth that they share.", "BYTES/S", only=CAMERAS
    )
    camera_rate: float | None = option(None, "Live cameras: frame rate.", "FPS", only=CAMERAS)
    trigger: str | None = option(None, "Live cameras: trigger, such as Line1.", only=CAMERAS)
    ptp: bool = option(False, "Live cameras: synchronise their clocks by PTP.", only=CAMERAS)
    wait: bool = option(False, "Wait until the cameras or streams are there.", only=LIVE)
    split: str | None = option(
        None, "Each picture holds both cameras' views: left-right.", "LAYOUT", only=VIDEO
    )
    mask: list[str] | None = option(
        None,
        "What is no view, such as a burned-in clock: a picture in which that is white, or a box "
        "X,Y,WIDTH,HEIGHT. In parts of the view, 0.7,0,0.3,0.1; in pixels of a frame, "
        "952,0,408,102@1360x1024. Repeatable; left: or right: before it names one camera. model is "
        "what was masked in training, none is nothing. Default: the mask beside recorded frames.",
        "PICTURE|BOX|model|none",
    )
    nmea: str | None = option(
        None,
        "Read the vehicle's place by NMEA: udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD].",
        "LINK",
    )
    nmea_dpt: bool = option(
        False, "DPT sentences tell the vehicle's own depth, not the water's.", needs=("nmea",)
    )


@dataclass(frozen=True)
class ModelConfig:
    """Which models judge."""

    store: Path | None = option(
        None,
        "Run this store's active model, and the next one when it changes.",
        not_with=("bundle", "model"),
    )
    bundle: Path | None = option(None, "Run the model in this file.", not_with=("store", "model"))
    model: str | None = option(
        None, "Run the model that comes with tokt: waters.", "NAME", not_with=("store", "bundle")
    )
    accept_blind: bool = option(
        False,
        "Run a model that cannot tell a blurred view from open water: of compressed video, or of "
        "an older tokt. Each verdict's health says so.",
        only=MODELS,
    )
    sharp_frames: Path | None = option(
        None,
        "Folder or video of frames that you know to be sharp, of a camera that the model did not "
        "learn. They are this camera's, of the same size; some twenty are best, of clear water. "
        "Clear is then said of views that show as much detail as these.",
        "FRAMES",
        only=MODELS,
    )
    threads: int = option(1, "Threads that share a frame's work.", logged="threads")
    fixed_boundary: bool = option(
        False,
        "Keep the boundary between water and obstacles fixed from frame to frame. Rates of false "
        "statuses were measured with one that moves.",
        only=MODELS,
        logged="fixed_boundary",
    )
    shadow: Path | None = option(
        None,
        "Another model that judges the same frames and sends nothing; needs --shadow-log.",
        "FILE|STORE|waters",
        needs=("shadow_log",),
    )
    shadow_log: Path | None = option(None, "Log of that model, for tokt shadow.", needs=("shadow",))

    @property
    def file(self) -> Path | None:
        """The bundle file to run; None where there is a store, or no model."""
        return self.bundle if self.model is None else packaged_bundle(self.model)


@dataclass(frozen=True)
class PolicyConfig:
    """How detectors are combined into a verdict."""

    policy: str = option(
        "fallback",
        "Which detector decides; fallback is disparity where texture cannot be relied on.",
        "texture|disparity|either|fallback",
        logged="policy",
    )
    anchor: float | None = option(
        None,
        "Share of the frame that an object is to cover, such as 0.1. v2 and the log then say how "
        "far it is from that, and from the centre.",
        "SHARE",
        logged="anchor",
    )
    moving: str = option(
        NEAR,
        "Moving things, such as fish, that are avoided: those large or near, all, or none. "
        "The others are unknown.",
        "near|all|none",
        logged="moving",
    )
    anchor_from: str | None = option(
        None,
        "The object to hold: a box in the pixels of a picture, its file or a recorded frame's "
        "number. Without --anchor at the size that it has there.",
        "FRAME:X,Y,W,H",
    )


@dataclass(frozen=True)
class StereoConfig:
    """How pairs of frames are matched."""

    calibration: Path | None = option(None, "Stereo calibration file.", logged="calibration")
    stereo: str = option(
        BM,
        "Block matching, semi-global matching (slower) or a few distances only (fastest).",
        "bm|sgbm|pushbroom",
        logged="stereo_way",
    )
    stereo_scale: float = option(
        DEFAULT_SCALE, "Scale at which frames are matched, at most 1.", logged="stereo_scale"
    )
    odometry: Path | None = option(
        None, "Poses by frame (CSV), by which pushbroom moves what it saw.", logged="odometry"
    )


_MAVLINK, _LOGS, _RECORD = ("mavlink",), ("log", "shadow_log"), ("record",)


@dataclass(frozen=True)
class OutputConfig:
    """What is sent, and to whom."""

    udp: list[str] | None = option(
        None,
        "Send to HOST:PORT, or v1@HOST:PORT, v2@HOST:PORT. Repeatable. Default: 127.0.0.1:1130.",
    )
    format: str = option("v1", "Datagram format: v1 for LabVIEW, v2 is JSON.", "v1|v2")
    stale: float = option(
        STALE_S, "A frame older than this is never clear.", "SECONDS", only=REAL_TIME
    )
    heartbeat: float = option(
        STALE_S, "After this long without a verdict, unknown is sent.", "SECONDS", only=REAL_TIME
    )
    mavlink: list[str] | None = option(
        None,
        "Speak MAVLink, too: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or "
        "serial:DEVICE[:BAUD]. Repeatable.",
        "LINK",
    )
    camera_fov_deg: float | None = option(
        None,
        "MAVLink: the left camera's horizontal field of view in water.",
        "DEGREES",
        needs=_MAVLINK,
    )
    # Metres inside any margin an autopilot keeps; a part of the vehicle itself (autopilots are
    # system 1, too) that is there for obstacle avoidance (MAV_COMP_ID_OBSTACLE_AVOIDANCE).
    mavlink_assumed_m: float = option(
        1.0, "MAVLink: distance of an obstacle where none was measured.", "METRES", needs=_MAVLINK
    )
    mavlink_system: int = option(1, "MAVLink: system ID.", needs=_MAVLINK)
    mavlink_component: int = option(196, "MAVLink: component ID.", needs=_MAVLINK)
    mavlink_words_component: int | None = option(
        None,
        "MAVLink: component ID of the words for the pilot; 1 for Cockpit. Default: the same.",
        needs=_MAVLINK,
    )
    mavlink_messages: str = option(
        "both",
        "MAVLink: messages to send.",
        "both|obstacle_distance|distance_sensor",
        needs=_MAVLINK,
    )
    mavlink_unknown: str = option(
        "silence", "MAVLink: what an unknown frame sends.", "silence|message", needs=_MAVLINK
    )


@dataclass(frozen=True)
class MonitoringConfig:
    """How the run itself is watched."""

    metrics: str | None = option(
        None, "Serve Prometheus metrics on this port, or HOST:PORT.", "PORT"
    )
    view: int | None = option(
        None, "Show what the run sees on this port: a page and an MJPEG stream.", "PORT"
    )
    view_host: str | None = option(
        None,
        "Show the view on this address, to whoever has the token. Default: this computer alone.",
        "HOST",
        needs=("view",),
    )
    view_record: Path | None = option(
        None, "Record what the view shows as a video, .mp4.", "FILE", only=REAL_TIME
    )
    watchdog: bool = option(False, "Run supervised; restart on crash or hang.")
    strict: bool = option(
        True,
        "Refuse to start without a source, a detector or a receiver. Otherwise unknown is sent, "
        "with the reason, until they are there, as after each restart by the watchdog.",
    )
    json: bool = option(False, "Print a summary as one JSON object at the end.")


@dataclass(frozen=True)
class RecordingConfig:
    """What is kept of the run."""

    log: Path | None = option(None, "Append a JSON line per frame to this file, events beside it.")
    log_values: bool = option(False, "Log each patch's decision values as well.", needs=("log",))
    # Some 7 hours at 10 frames a second a file, with the older ones 2.1 GB and some 6 days.
    log_max_mb: float = option(100.0, "Size at which a new log file begins.", "MB", needs=_LOGS)
    log_keep: int = option(20, "Number of older log files to keep.", needs=_LOGS)
    record: Path | None = option(
        None, "Record the frames around detections, for tokt label.", "DIR", logged="record"
    )
    record_mb: float = option(10_000.0, "Disk space for recordings.", "MB", needs=_RECORD)
    record_before: float = option(
        2.0, "Time recorded before a detection.", "SECONDS", needs=_RECORD
    )
    record_after: float = option(2.0, "Time recorded after a detection.", "SECONDS", needs=_RECORD)


@dataclass(frozen=True)
class RunConfig:
    """Everything that a user can say about a run."""

    source: SourceConfig = SourceConfig()
    model: ModelConfig = ModelConfig()
    policy: PolicyConfig = PolicyConfig()
    stereo: StereoConfig = StereoConfig()
    outputs: OutputConfig = OutputConfig()
    monitoring: MonitoringConfig = MonitoringConfig()
    recording: RecordingConfig = RecordingConfig()
    # Names of the options that the user wrote, on the command line or in a file, be it with their
    # defaults: one that would do nothing is refused.
    given: frozenset[str] = frozenset()

    @classmethod
    def of(cls, *layers: Mapping[str, Any]) -> Self:
        """A run of options by name; those of a later layer win, and others have their defaults.

        A path may be text, and one receiver need be no list. Raises ToktError for an unknown name.
        """
        values: dict[str, Any] = {}
        for layer in layers:
            for name in layer:
                if name not in OPTIONS:
                    raise ToktError(f"unknown option {_nearest(name, OPTIONS)}")
                for other in OPTIONS[name].not_with:
                    values.pop(other, None)
            values |= {name: OPTIONS[name].typed(value) for name, value in layer.items()}
        made = {
            section: kind(**{name: values[name] for name in values.keys() & kind.__annotations__})
            for section, kind in SECTIONS.items()
        }
        return cls(**made, given=frozenset(values))

    @property
    def limits(self) -> Limits:
        """When the runtime no longer believes what it sees."""
        return Limits(self.outputs.stale, self.outputs.heartbeat)

    def value(self, name: str) -> Any:
        """An option's."""
        return getattr(getattr(self, OPTIONS[name].section), name)

    def logged(self) -> dict[str, Any]:
        """The options that verdicts depend on, by their names in the log's start event."""
        return {each.logged: self.value(each.name) for each in OPTIONS.values() if each.logged}

    def to_toml(self) -> str:
        """A configuration file of the same run: what was not given is a comment."""
        lines = ["# For tokt run --config FILE. The command line wins over this file."]
        for section, options in groupby(OPTIONS.values(), attrgetter("section")):
            lines += ["", f"[{section}]"]
            for each in options:
                given, value = each.name in self.given, self.value(each.name)
                shown = without_credentials(value) if each.name == "source" else value
                text = _toml(shown) if given or value else each.metavar or "..."
                lines.append(f"{'' if given else '# '}{each.key} = {text}  # {each.text}")
        return "\n".join(lines) + "\n"


SECTIONS: dict[str, Any] = {item.name: item.type for item in fields(RunConfig)[:-1]}
"""Their classes, by their names."""

OPTIONS: dict[str, Option] = {
    item.name: replace(
        item.metadata["option"],
        **{"name": item.name, "section": section, "annotation": item.type, "default": item.default},
    )
    for section, kind in SECTIONS.items()
    for item in fields(kind)
}
"""All of them, by name."""

_WORDS: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text in quotes",
    Path: "a path in quotes",
    list: "a list",
    dict: "a table",
}
_TOO_LARGE = 1e300


def read_config(path: Path) -> dict[str, Any]:
    """The options of a configuration file, by name.

    Raises ToktError if it cannot be read, or has a key or a value that no option takes.
    """
    import tomllib

    try:
        with os_errors_as(f"config {path}"):
            tables = tomllib.loads(path.read_text("utf-8"))
    except UnicodeDecodeError:
        raise ToktError(f"config {path}: not UTF-8 text") from None
    except (ValueError, RecursionError) as error:  # not TOML, 5,000 digits, 1,000 brackets
        raise ToktError(f"config {path}: {error}") from None
    known = {f"{each.section}.{each.key}": each for each in OPTIONS.values()}
    values: dict[str, Any] = {}
    for section, table in tables.items():
        if isinstance(table, dict) and section not in SECTIONS:
            raise ToktError(f"config {path}: unknown table {_nearest(section, SECTIONS)}")
        rows = {f".{key}": table[key] for key in table} if isinstance(table, dict) else {"": table}
        for key, value in rows.items():
            if (place := section + key) not in known:
                raise ToktError(f"config {path}: unknown key {_nearest(place, known)}")
            values[known[place].name] = _value(known[place], value, f"config {path}: {place}")
    return values


def _nearest(wrong: str, known: Iterable[str]) -> str:
    """The wrong name and the known one that it resembles most; a key's table matters least."""
    from difflib import SequenceMatcher

    last = wrong[:80].rpartition(".")[2]
    alike = {name: SequenceMatcher(None, last, name.rpartition(".")[2]).ratio() for name in known}
    return f"{wrong!r}: did you mean {max(alike, key=alike.__getitem__)}?"


def _value(each: Option, value: Any, where: str) -> Any:
    """What TOML has for an option, as its field's type."""
    kind, value = each.kind, _as_boxes(value) if each.name == "mask" else value
    types = {float: (int, float), Path: (str,)}.get(kind, (kind,))
    items = value if each.many and isinstance(value, list) else [value]
    wrong = [item for item in items if type(item) not in types]
    if wrong or isinstance(value, list) != each.many:
        found = type(wrong[0] if wrong else value)
        words = f"a list of {_WORDS[kind]}" if each.many else _WORDS[kind]
        raise ToktError(f"{where} is {words}, not {_WORDS.get(found, found.__name__)}")
    if any(abs(it) >= _TOO_LARGE if type(it) is int else "\0" in str(it) for it in items):
        raise ToktError(f"{where} is too large, or text with a NUL in it")
    return each.typed(value)


def _as_boxes(value: Any) -> Any:
    """Boxes as lists of numbers, or one picture, as they are written on the command line."""
    if not isinstance(value, list):
        return [value] if isinstance(value, str) else value
    one = bool(value) and all(type(number) in (int, float) for number in value)
    return [
        ",".join(map(repr, each)) if isinstance(each, list) else each
        for each in ([value] if one else value)
    ]


def _toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    try:
        str(value).encode()
    except UnicodeEncodeError:
        raise ToktError(f"{str(value)!r} is no UTF-8: no configuration file holds it") from None
    # JSON's escapes are TOML's, which wants one more.
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
