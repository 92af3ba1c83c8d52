"""MAVLink: verdicts as the distances that autopilots read, and what the pilot's screen shows.

What each message means, and what autopilots make of it, is in mavlink.md. ArduPilot takes a
message full of "unknown" for a healthy sensor that sees nothing, and only silence for one without
data: nothing but heartbeats, words and figures is sent for an unknown verdict, unless asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.config import OPTIONS, OutputConfig
from tokt.inference.links.autopilot import AUTOPILOT, MavlinkReader, mavlink_dialect
from tokt.inference.links.datagrams import OTHER, PLACES
from tokt.inference.links.link import Link
from tokt.inference.links.vehicle import VehicleState
from tokt.inference.reason import Reason
from tokt.inference.report import Event, Report
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.matching import FARTHEST_M
from tokt.inference.stereo.pushbroom import DISTANCES_M
from tokt.inference.verdict import CLEAR, DISPARITY, OBSTACLE, PUSHBROOM, UNKNOWN, Verdict

from .pilot_words import ENDED, PilotWords

SECTORS = 72
"""As many as MAVLink's OBSTACLE_DISTANCE has."""
SECTOR_DEG = 360 / SECTORS

MIN_FOV_DEG, MAX_FOV_DEG = 10.0, 170.0
"""Between these at least one sector is wholly in view, and a pinhole is a fair description."""


@dataclass(frozen=True)
class Lens:
    r"""A pinhole camera's horizontal view; distortion is left out.

    ::

                     0 deg, ahead                 a column's angle, seen from above:
                 k=-1  k=0  k=1                   negative left, positive right, of a pinhole camera
                   \    |    /
            left    \   |   /   right             sector k: SECTOR_DEG wide, around k * SECTOR_DEG;
         of picture  \  |  /  of picture          its index is k % SECTORS, so that a thing at the
                      camera                      left has the highest indices
    """

    focal: float  # focal length over the picture's width
    centre: float = 0.5  # the optical axis's column, over the width: 0 left edge, 1 right one

    def angle_deg(self, column: float) -> float:
        """Direction of a column, given over the picture's width; positive to the right."""
        return math.degrees(math.atan2(column - self.centre, self.focal))

    @property
    def edges_deg(self) -> tuple[float, float]:
        """Directions of the picture's left and right edge."""
        return self.angle_deg(0.0), self.angle_deg(1.0)

    def fov_deg(self, height_over_width: float = 1.0) -> float:
        """Angle of view across the width, or across a height given over the width."""
        return 2 * math.degrees(math.atan2(height_over_width / 2, self.focal))


def lens_of(fov_deg: float | None, calibration: StereoCalibration | None) -> Lens:
    """The lens of the angle a user gave from edge to edge, otherwise of the calibration.

    Raises ToktError without both, or if the angle is not `MIN_FOV_DEG` to `MAX_FOV_DEG`.
    """
    if fov_deg is not None:
        if not MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
            known = f"{MIN_FOV_DEG:g} to {MAX_FOV_DEG:g} degrees"
            raise ToktError(f"a camera's field of view is {known}, not {fov_deg:g}")
        return Lens(0.5 / math.tan(math.radians(fov_deg / 2)))
    if calibration is None:
        raise ToktError(
            "MAVLink tells directions: give the camera's horizontal field of view in water "
            "(--camera-fov-deg), or a calibration"
        )
    width, K1 = calibration.frame_size[0], calibration.K1
    # The centre of the first pixel is at 0, half a pixel from the edge.
    return Lens(float(K1[0, 0] / width), float((K1[0, 2] + 0.5) / width))


def sectors_of(left_deg: float, right_deg: float, wholly: bool) -> list[int]:
    """Indices of the sectors that a range of angles touches, or holds `wholly`; left to right."""
    half = SECTOR_DEG / 2 if wholly else -SECTOR_DEG / 2
    first, last = (left_deg + half) / SECTOR_DEG, (right_deg - half) / SECTOR_DEG
    return [k % SECTORS for k in range(math.ceil(first), math.floor(last) + 1)]


UNKNOWN_CM = 65535
"""OBSTACLE_DISTANCE's word for unknown, or not used (UINT16_MAX)."""
NEAREST_CM = 1
"""Least distance that is said: 0 and what is below a sensor's least distance, ArduPilot ignores."""

MEASURED_TO_M = {DISPARITY: FARTHEST_M, PUSHBROOM: max(DISTANCES_M)}
"""Metres up to which a detector's clear holds. Texture has no such distance."""


@dataclass(frozen=True)
class Ranges:
    """A judged frame in distances, all in whole centimetres."""

    nearest: int  # to the obstacle; `most` + 1 where there is none
    most: int  # up to where there would have been said to be one
    sectors: tuple[int, ...]  # `nearest`, or `UNKNOWN_CM` where nothing is said of a sector


def ranges_of(verdict: Verdict, lens: Lens, assumed_m: float) -> Ranges | None:
    """A verdict in distances, or None of one that is unknown; `assumed_m` where none was measured.

    A clear is one of the sectors that are wholly in view. An obstacle is in every sector that its
    box touches, or in all of the view where the verdict does not say in which picture its box is.
    """
    if verdict.status == UNKNOWN:
        return None
    if verdict.status == CLEAR:
        most = _cm(_reach_m(verdict.method, assumed_m))
        nearest = most + 1
    elif verdict.distance_m is None or not math.isfinite(verdict.distance_m):
        most = _cm(assumed_m)
        nearest = most - 1  # PX4 takes an obstacle at the very end of the range for none
    else:
        most = _cm(_reach_m(verdict.method, max(MEASURED_TO_M.values())))
        nearest = min(max(_cm(verdict.distance_m), NEAREST_CM), most - 1)
    left_deg, right_deg = lens.edges_deg
    if verdict.status == OBSTACLE and verdict.box is not None and verdict.mask_size is not None:
        edges = verdict.box[0], verdict.box[0] + verdict.box[2]
        left_deg, right_deg = (lens.angle_deg(x / verdict.mask_size[1]) for x in edges)
    said = sectors_of(left_deg, right_deg, wholly=verdict.status == CLEAR)
    sectors = (nearest if index in said else UNKNOWN_CM for index in range(SECTORS))
    return Ranges(nearest, most, tuple(sectors))


def _reach_m(method: str, otherwise_m: float) -> float:
    """Metres up to which a method, which may be two joined by ``+``, measures."""
    measured = [MEASURED_TO_M[part] for part in method.split("+") if part in MEASURED_TO_M]
    return max(measured, default=otherwise_m)


def _cm(metres: float) -> int:
    """Whole centimetres, rounded towards the nearer."""
    return math.floor(100 * min(max(metres, 0.0), 600.0) + 1e-6)


HEARTBEAT_S = 1.0
VALUES_S = 0.2
"""Between two sets of figures to plot, unless the status changes."""
_CHOICES = {
    "mavlink_messages": ("both", "obstacle_distance", "distance_sensor"),
    "mavlink_unknown": ("silence", "message"),
}


def check_mavlink(wanted: OutputConfig) -> None:
    """Refuse what MAVLink does not have: a `ToktError`."""
    if not 0.1 <= wanted.mavlink_assumed_m <= 100:
        raise ToktError(f"an assumed distance is 0.1 to 100 m, not {wanted.mavlink_assumed_m:g}")
    for name in ("mavlink_system", "mavlink_component", "mavlink_words_component"):
        number = getattr(wanted, name)
        if number is not None and not 1 <= number <= 255:
            raise ToktError(f"--{OPTIONS[name].key} is 1 to 255, not {number}")
    if wanted.mavlink_component == AUTOPILOT:
        raise ToktError(f"--mavlink-component {AUTOPILOT} is the autopilot: give a free number")
    for name, known in _CHOICES.items():
        if (word := getattr(wanted, name)) not in known:
            raise ToktError(f"--{OPTIONS[name].key} is {' or '.join(known)}, not {word!r}")


class MavlinkSender:
    """Send verdicts as MAVLink messages over one link, and read what is heard on it.

    A heartbeat goes out with the first report a second after the one before, CRITICAL where that is
    unknown, such as while the loop hangs. The lens is the left camera's, in water; `wanted` has
    passed `check_mavlink`; `vehicle` is told what the autopilot says of itself; `tell` is given the
    events ``mavlink_clash`` and ``mavlink_strangers``. ToktError without pymavlink.
    """

    # Messages that the system took, those that it did not, and why not the last of these.
    sent = property(attrgetter("_to.sent"))
    failed = property(attrgetter("_to.failed"))
    last_error = property(attrgetter("_to.last_error"))

    def __init__(
        self,
        link: Link,
        lens: Lens,
        wanted: OutputConfig,
        clock: Clock,
        vehicle: VehicleState,
        tell: Callable[[Event], None],
    ) -> None:
        self._words = mavlink_dialect()
        self._to, self._lens, self._wanted = link, lens, wanted
        self._clock, self._tell = clock, tell
        self._heartbeat_due = self._values_due = -math.inf
        self._values_status = UNKNOWN
        self._stamp_us = 0
        # They number and frame what they are given, and write that to the link.
        ids = wanted.mavlink_system, wanted.mavlink_component
        self._link = self._pilot = self._words.MAVLink(link, *ids)
        if wanted.mavlink_words_component not in (None, ids[1]):
            self._pilot = self._words.MAVLink(link, ids[0], wanted.mavlink_words_component)
        self._pilot_words = PilotWords()
        self._reader = MavlinkReader(ids, link.whole, vehicle, self._clashed)
        self._gaps = link.gaps
        self._full: set[int] = set()
        link.listen(self._reader.heard)

    def close(self) -> None:
        """Say that nothing more is said, and end the link."""
        self._send_text(self._words.MAV_SEVERITY_WARNING, ENDED)
        self._to.close()

    def _clashed(self) -> None:
        ids = f"system {self._wanted.mavlink_system}, component {self._wanted.mavlink_component}"
        advice = "give one of the two another number (--mavlink-component)"
        words = f"another MAVLink sender is {ids}, too: {advice}"
        self._tell(Event(self._clock.time(), "mavlink_clash", words))

    def _tell_strangers(self) -> None:
        """Tell once of each kind of peers that is full."""
        for kind in self._to.full - self._full:
            self._full.add(kind)
            which = "systems other than " if kind == OTHER else ""
            rule = "no more are answered" if kind == OTHER else "the last ones heard are answered"
            words = f"{PLACES[kind]} senders of {which}system {self._wanted.mavlink_system}: {rule}"
            self._tell(Event(self._clock.time(), "mavlink_strangers", f"MAVLink has {words}"))

    def send(self, report: Report) -> None:
        """Send what a report comes to in distances, words and figures, and a heartbeat when due."""
        verdict, now = report.verdict, self._clock.monotonic()
        if now >= self._heartbeat_due:
            self._heartbeat_due = now + HEARTBEAT_S
            self._send_heartbeat(verdict)
        self._send_ranges(report, now)
        if now >= self._values_due or verdict.status != self._values_status:
            self._values_due, self._values_status = now + VALUES_S, verdict.status
            self._send_values(verdict, now)
        self._tell_strangers()
        if (gaps := self._to.gaps + self._reader.met) != self._gaps:
            self._gaps = gaps
            self._pilot_words.tell_again()
        text = self._pilot_words.due(verdict, now)
        if text is not None:
            words, is_clear = self._words, verdict.status == CLEAR
            # Stations read warnings aloud: a clear is not to be relied on by ear.
            severity = words.MAV_SEVERITY_INFO if is_clear else words.MAV_SEVERITY_WARNING
            self._send_text(severity, text)

    def _send_heartbeat(self, verdict: Verdict) -> None:
        words, state = self._words, self._words.MAV_STATE_ACTIVE
        if verdict.status == UNKNOWN:
            starting = verdict.reason is Reason.NO_FRAME
            state = words.MAV_STATE_BOOT if starting else words.MAV_STATE_CRITICAL
        kind, none = words.MAV_TYPE_ONBOARD_CONTROLLER, words.MAV_AUTOPILOT_INVALID
        self._link.heartbeat_send(kind, none, 0, 0, state)

    def _send_text(self, severity: int, text: str) -> None:
        self._pilot.statustext_send(severity, text.encode("ascii"))

    def _send_values(self, verdict: Verdict, now: float) -> None:
        """Figures to plot, -1 where there is none: a station shows the last one for ever."""
        figures = verdict.status, verdict.mean, verdict.distance_m
        for name, value in zip((b"tokt_stat", b"tokt_mean", b"tokt_dist"), figures, strict=True):
            number = -1.0 if value is None or not 0 <= value < 1e9 else float(value)
            self._pilot.named_value_float_send(int(1000 * now) % 2**32, name, number)

    def _send_ranges(self, report: Report, now: float) -> None:
        age_ms = report.age_ms or 0.0  # since the frame arrived, where that is known
        taken = max(0.0, now - age_ms / 1000) if age_ms > 0 else now
        self._stamp_us = max(self._stamp_us, int(1e6 * taken))
        ranges = ranges_of(report.verdict, self._lens, self._wanted.mavlink_assumed_m)
        messages = self._wanted.mavlink_messages
        if ranges is None:
            if self._wanted.mavlink_unknown == "silence":
                return
            # DISTANCE_SENSOR says it never: its quality "invalid" only rangefinders read.
            ranges = Ranges(0, NEAREST_CM + 1, (UNKNOWN_CM,) * SECTORS)
        elif messages != "obstacle_distance":
            # Before the other: ArduPilot keeps what the last of the two said of the sectors ahead.
            self._send_distance(ranges, report.verdict.mask_size)
        if messages != "distance_sensor":
            self._send_sectors(ranges)

    def _send_sectors(self, ranges: Ranges) -> None:
        unknown, frame = self._words.MAV_DISTANCE_SENSOR_UNKNOWN, self._words.MAV_FRAME_BODY_FRD
        sectors = ranges.sectors, int(SECTOR_DEG), NEAREST_CM, ranges.most
        self._link.obstacle_distance_send(
            *(self._stamp_us, unknown, *sectors), increment_f=SECTOR_DEG, frame=frame
        )

    def _send_distance(self, ranges: Ranges, mask_size: tuple[int, int] | None) -> None:
        words, lens = self._words, self._lens
        height_deg = 0.0 if mask_size is None else lens.fov_deg(mask_size[0] / mask_size[1])
        self._link.distance_sensor_send(
            *(self._stamp_us // 1000 % 2**32, NEAREST_CM, ranges.most, ranges.nearest),
            *(words.MAV_DISTANCE_SENSOR_UNKNOWN, 0, words.MAV_SENSOR_ROTATION_NONE),
            covariance=255,  # unknown, as is the signal's quality by default
            horizontal_fov=math.radians(lens.fov_deg()),
            vertical_fov=math.radians(height_deg),
        )
