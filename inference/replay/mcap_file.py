"""A log as an MCAP file of ROS 2 messages, which Foxglove and ``ros2 bag`` read.

What is not known is never shown as free: an unknown verdict has a detection that says so, patches
of -1, and what was measured before has a value that is not a number.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import cv2
import numpy as np

from tokt.features.common.arrays import F64
from tokt.features.common.errors import ToktError, printable
from tokt.features.frames.mission import LEFT, RIGHT, FolderMission, Mission, open_mission
from tokt.inference.recording.run_start import ModelName, RunStart
from tokt.inference.report import MODEL, START
from tokt.inference.verdict import CLEAR, OBSTACLE, STATUS_WORDS, TEXTURE, UNKNOWN

from .replay import NOT_SHOWN, judged_picture, model_of, pictures_of

T = TypeVar("T")
Message = tuple[str, dict[str, Any]]
"""Its topic below ``/tokt/``, and its fields other than 0, empty, or the present time and frame."""

_VISION = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "Point2D position\nfloat64 theta",
    "BoundingBox2D": "Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "Detection2D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\n"
    "BoundingBox2D bbox\nstring id",
    "Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
}
"""The fields of vision_msgs 4, which rosbags does not bring."""
_PLOTTED = ("mean", "closing_m_s", "contact_s", "latency_ms", "depth_m", "heading_deg")
_TYPES = {
    "verdict": "diagnostic_msgs/msg/DiagnosticArray",
    "detections": "vision_msgs/msg/Detection2DArray",
    "patches": "nav_msgs/msg/OccupancyGrid",
    "distance": "sensor_msgs/msg/Range",
    "position": "sensor_msgs/msg/NavSatFix",
    **dict.fromkeys(_PLOTTED, "std_msgs/msg/Float64"),
    **dict.fromkeys((LEFT, RIGHT), "sensor_msgs/msg/CompressedImage"),
    "events": "rcl_interfaces/msg/Log",
}

_MEASURED: dict[str, tuple[tuple[str, ...], Callable[..., dict[str, Any]]]] = {
    "distance": (("distance_m",), lambda m: {"max_range": math.inf, "range": m}),
    "position": (
        ("lat_deg", "lon_deg"),  # the altitude is over an ellipsoid, which the depth is not
        lambda lat, lon: {
            "status": {"status": -1 if math.isnan(lat) else 0},
            **{"latitude": lat, "longitude": lon, "altitude": math.nan},
        },
    ),
    **{name: ((name,), lambda value: {"data": value}) for name in _PLOTTED},
}
"""By topics, the fields of the log that they need, and of the message."""
_FRAME_IDS = {"verdict": "tokt", "position": "tokt", RIGHT: RIGHT}  # else the left camera
_LEVELS = {CLEAR: 0, OBSTACLE: 1, UNKNOWN: 2}  # OK, WARN, ERROR
_FREE, _OCCUPIED, _NOT_KNOWN = 0, 100, -1
_INFO = 20
_JPEG = (cv2.IMWRITE_JPEG_QUALITY, 90)
_MOST = 1e30  # a float32 holds it
_LAST_S = 2**31  # of ROS 2's time stamps


def number(value: Any) -> float | None:
    """A measured number; None where it cannot be one: JSON's have no end."""
    return float(value) if type(value) in (int, float) and abs(value) < _MOST else None


def said_at(line: Mapping[str, Any]) -> float | None:
    """When a line was said, in seconds since 1970; None where it is no time that ROS 2 has.

    A heartbeat's `t` is that of the newest frame.
    """
    t = number(line.get("t"))
    if t is not None and "event" not in line and line.get("frame") is None:
        t += (number(line.get("age_ms")) or 0.0) / 1000
    return t if t is not None and 0 <= t < _LAST_S else None


@dataclass
class Exported:
    """What an export has written, and what it could not."""

    frames: int = 0
    heartbeats: int = 0
    events: int = 0
    damaged: int = 0  # places and lines of the log that cannot be read
    untimed: int = 0  # lines without a time, which MCAP does not take
    with_picture: int = 0
    no_picture: Counter[str] = field(default_factory=Counter)  # frames, by why
    notes: list[str] = field(default_factory=list)


def write_mcap(
    lines: Iterable[Mapping[str, Any]],
    log: Path,
    source: Path | None,
    store: Path | None,
    file: BinaryIO,
    done: Exported,
) -> None:
    """Write sound lines of a log, with pictures and models as `export_log` finds them.

    `done` counts the pictures and what has no time.
    """
    mcap, view = _McapFile(file), _View(log, source, store, done)
    for line in lines:
        if "event" in line:
            view.hear(line)
        if (t := said_at(line)) is None:
            done.untimed += 1
            continue
        for topic, fields in view.messages(line):
            mcap.write(round(t * 1e9), line["seq"] % 2**32, topic, fields)
    mcap.finish()


class _McapFile:
    """An MCAP file, each message's schema with the text of all that it needs."""

    def __init__(self, file: BinaryIO) -> None:
        from mcap.writer import Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in _VISION.items():
            self._store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))
        self._writer = Writer(file)
        self._writer.start(profile="ros2", library="tokt")
        self.finish = self._writer.finish
        self._channels: dict[str, int] = {}
        self._unless_given: dict[str, dict[str, Any]] = {"geometry_msgs/msg/Quaternion": {"w": 1.0}}

    def write(self, ns: int, seq: int, topic: str, fields: Mapping[str, Any]) -> None:
        """Write a message of this time and number."""
        name = _TYPES[topic]
        if topic not in self._channels:
            text, _ = self._store.generate_msgdef(name, ros_version=2)
            schema = self._writer.register_schema(name, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(f"/tokt/{topic}", "cdr", schema)
        stamp = dict(zip(("sec", "nanosec"), divmod(ns, 10**9), strict=True))
        self._unless_given["builtin_interfaces/msg/Time"] = stamp
        self._unless_given["std_msgs/msg/Header"] = {"frame_id": _FRAME_IDS.get(topic, LEFT)}
        data = bytes(self._store.serialize_cdr(self._built(name, fields), name))
        self._writer.add_message(self._channels[topic], ns, data, ns, seq)

    def _built(self, name: str, given: Mapping[str, Any] | None) -> Any:
        """A message of the type store's, within it those that it holds."""
        given = given or self._unless_given.get(name, {})
        values: dict[str, Any] = {}
        described: Any = self._store.get_msgdef(name).fields  # a type's names, nested as they are
        for each, (node, what) in described:
            value = given.get(each)
            if node.name == "NAME":
                value = self._built(what, value)
            elif node.name == "BASE" and value is None:
                value = "" if what[0] == "string" else 0
            elif node.name == "ARRAY":
                value = np.zeros(what[1])
            elif node.name == "SEQUENCE" and what[0][0].name == "NAME":
                value = [self._built(what[0][1], one) for one in value or ()]
            values[each] = value
        return self._store.types[name](**values)


class _View:
    """What lines are shown as, with the pictures and models that the runs had.

    What was shown must not stand for what is later.
    """

    def __init__(self, log: Path, source: Path | None, store: Path | None, done: Exported) -> None:
        if source is not None:
            open_mission(source)  # refused now, not at the first frame
        self._log, self._store, self._done = log, store, done
        self._starts: dict[str, RunStart] = {}
        self._models: dict[str, ModelName | None] = {}  # that judge now
        newest = lru_cache(maxsize=4)  # runs follow each other, and a video is an open file
        self._mission = newest(
            lambda run: self._noted(pictures_of, log, run, self._starts.get(run), source)
        )
        self._bundle = newest(partial(self._noted, model_of))
        self._shown: set[str] = set()
        self._grid = 0, 0  # rows, columns

    def _noted(self, find: Callable[..., T], *asked: Any) -> T | None:
        """What is found; None where it is not, with a note why."""
        try:
            return find(*asked)
        except ToktError as error:
            self._done.notes.append(str(error))
            return None

    def hear(self, event: Mapping[str, Any]) -> None:
        """Hear of a run's start and of its models."""
        run = event["run"]
        if event["event"] == MODEL:
            self._models[run] = ModelName(str(event.get("label")), str(event.get("sha256")))
        elif event["event"] == START:
            start = self._noted(RunStart.from_fields, event, str(self._log))
            if start is not None:
                self._starts[run], self._models[run] = start, start.model

    def messages(self, line: Mapping[str, Any]) -> Iterator[Message]:
        """The messages of a frame, a heartbeat or an event."""
        if "event" in line:
            said = {"name": line["event"], "msg": line["words"], "file": line["run"]}
            yield "events", {"level": _INFO, **{key: printable(said[key]) for key in said}}
            return
        yield "verdict", {"status": [_verdict(line)]}
        yield "detections", {"detections": list(_detections(line))}
        for topic, (names, fields) in _MEASURED.items():
            values = [number(line.get(name)) for name in names]
            if None not in values:
                self._shown.add(topic)
            if topic in self._shown:
                yield topic, fields(*(math.nan if None in values else each for each in values))
        yield from self._patches(line)
        if line.get("frame") is not None:
            yield from self._pictures(line)

    def _patches(self, line: Mapping[str, Any]) -> Iterator[Message]:
        """The grid of patches, the lowest row first, as maps have it."""
        values, name, bundle = line.get("decision_values"), self._models.get(line["run"]), None
        # Where the event of another model is lost, the line still has its name.
        if values is not None and name and line.get("model") in (None, name.label):
            start = self._starts.get(line["run"])
            there = Path(start.models_from) if start and start.models_from else None
            if bundle := self._bundle(name, self._store or there):
                self._grid = bundle.grid.rows, bundle.grid.cols
        rows, columns = self._grid
        cells = np.full(rows * columns, _NOT_KNOWN, np.int8)
        if bundle is not None:
            decided = _array(values, (cells.size, len(bundle.model.bias)))
            sure = np.isfinite(decided).all(axis=1)
            obstacle = sure & bundle.model.obstacle_patches(decided)
            # Only where the model itself was believed, and saw the obstacle where there is one.
            seen = line["status"] == CLEAR or (line["status"] == OBSTACLE and obstacle.any())
            if seen and TEXTURE in str(line.get("method")):
                cells[sure] = _FREE
            cells[obstacle] = _OCCUPIED
        if cells.size:
            info = {"resolution": 1.0, "width": columns, "height": rows}
            yield "patches", {"info": info, "data": cells.reshape(rows, columns)[::-1].ravel()}

    def _pictures(self, line: Mapping[str, Any]) -> Iterator[Message]:
        """The pictures that were judged; a frame is counted by what became of them."""
        found, whys = self._mission(line["run"]), []
        for side in (LEFT, RIGHT):
            if isinstance(mark := line.get(side), str):
                jpeg, why = _jpeg(*found, line["frame"], side, mark) if found else (b"", NOT_SHOWN)
                whys.append(why)
                if jpeg:
                    yield side, {"format": "jpeg", "data": np.frombuffer(jpeg, np.uint8)}
        if any(whys) or not whys:
            self._done.no_picture[next(filter(None, whys), "the run had none")] += 1
        else:
            self._done.with_picture += 1


def _jpeg(
    mission: Mission, pixel_format: str | None, frame: int, side: str, mark: str
) -> tuple[bytes, str]:
    """The picture of this mark, its file as it is where it is JPEG, or why there is none."""
    picture, why = judged_picture(mission, frame, side, pixel_format, mark)
    if picture is None:
        return b"", why
    if pixel_format is None and isinstance(mission, FolderMission):
        data, suffix = mission.encoded(frame, side)
        if suffix in (".jpg", ".jpeg"):
            return data, ""
    return cv2.imencode(".jpg", picture, _JPEG)[1].tobytes(), ""


def _verdict(line: Mapping[str, Any]) -> dict[str, Any]:
    """Status, reason and health in words, and every field as JSON."""
    words = f"{STATUS_WORDS[line['status']]} ({line.get('reason')}): {line.get('health')}"
    values = [
        {"key": printable(key), "value": json.dumps(value)}
        for key, value in line.items()
        if key != "decision_values"
    ]
    said = {"level": _LEVELS[line["status"]], "name": "tokt", "message": printable(words)}
    return {**said, "hardware_id": printable(line.get("model") or ""), "values": values}


def _detections(line: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """The box, in pixels of the mask; nothing where it is clear."""
    if line["status"] != CLEAR:
        x, y, width, height = map(float, line.get("box") or (0, 0, 0, 0))
        center = {"position": {"x": x + width / 2, "y": y + height / 2}}
        word = STATUS_WORDS[line["status"]]
        kinds = [{"hypothesis": {"class_id": word, "score": 1.0}}]
        box = {"center": center, "size_x": width, "size_y": height}
        yield {"results": kinds, "bbox": box, "id": word}


def _array(values: Any, shape: tuple[int, int]) -> F64:
    """Decision values as an array of this shape; not a number where they are none."""
    try:
        array = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    return array if array.shape == shape else np.full(shape, np.nan)
