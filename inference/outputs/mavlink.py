"""MAVLink: verdicts as the distances that ArduPilot and other autopilots read.

What each message means, and what autopilots make of it, is in docs/mavlink.md. Unknown is kept
apart from clear in the way the autopilot at the other end can tell them apart: ArduPilot takes a
message full of "unknown" for a healthy sensor that sees nothing, and only silence for a sensor
that gives no data. Hence nothing but heartbeats is sent for an unknown verdict, unless asked for.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import StrEnum
from types import ModuleType

from tokt.features.common.address import parse_address
from tokt.features.common.errors import ToktError
from tokt.inference.clock import Clock
from tokt.inference.config import OutputConfig
from tokt.inference.reason import Reason
from tokt.inference.report import Report
from tokt.inference.stereo.calibration import StereoCalibration
from tokt.inference.stereo.matching import FARTHEST_M
from tokt.inference.stereo.pushbroom import DISTANCES_M
from tokt.inference.verdict import CLEAR, DISPARITY, OBSTACLE, PUSHBROOM, UNKNOWN, Verdict

from .udp import DatagramSocket

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

    @classmethod
    def of_fov_deg(cls, fov_deg: float) -> Lens:
        """A lens that sees so many degrees from edge to edge, `MIN_FOV_DEG` to `MAX_FOV_DEG`."""
        if not MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG:
            known = f"{MIN_FOV_DEG:g} to {MAX_FOV_DEG:g} degrees"
            raise ToktError(f"a camera's field of view is {known}, not {fov_deg:g}")
        return cls(0.5 / math.tan(math.radians(fov_deg / 2)))

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
    """The lens of the angle a user gave, otherwise of the calibration.

    Raises
    ------
    ToktError
        If there is neither.
    """
    if fov_deg is not None:
        return Lens.of_fov_deg(fov_deg)
    if calibration is None:
        raise ToktError(
            "MAVLink tells directions: give the camera's horizontal field of view in water "
            "(--camera-fov-deg), or a calibration"
        )
    width, K1 = calibration.frame_size[0], calibration.K1
    # The centre of the first pixel is at 0, half a pixel from the edge.
    return Lens(float(K1[0, 0] / width), float((K1[0, 2] + 0.5) / width))


def sectors_touching(left_deg: float, right_deg: float) -> list[int]:
    """Indices of the sectors that any part of a range of angles lies in, from left to right."""
    first = math.ceil((left_deg - SECTOR_DEG / 2) / SECTOR_DEG)
    last = math.floor((right_deg + SECTOR_DEG / 2) / SECTOR_DEG)
    return [k % SECTORS for k in range(first, last + 1)]


def sectors_within(left_deg: float, right_deg: float) -> list[int]:
    """Indices of the sectors that lie wholly in a range of angles, from left to right."""
    first = math.ceil((left_deg + SECTOR_DEG / 2) / SECTOR_DEG)
    last = math.floor((right_deg - SECTOR_DEG / 2) / SECTOR_DEG)
    return [k % SECTORS for k in range(first, last + 1)]


UNKNOWN_CM = 65535
"""OBSTACLE_DISTANCE's word for unknown, or not used (UINT16_MAX)."""
NEAREST_CM = 1
"""Least distance that is said: 0 and what is below a sensor's least distance, ArduPilot ignores."""

MEASURED_TO_M = {DISPARITY: FARTHEST_M, PUSHBROOM: max(DISTANCES_M)}
"""Metres up to which a detector's clear holds. Texture has no such distance."""


@dataclass(frozen=True)
class Ranges:
    """A judged frame in distances, all in whole centimetres.

    A receiver that thinks in distances cannot be told "obstacle" or "clear" without one. Where the
    verdict measured none, one has to be assumed, and the same figure serves both: an obstacle
    without a distance is said to be that near, and a clear without a range to reach no farther.
    Smaller is more careful either way.
    """

    nearest: int  # to the obstacle; `most` + 1 where there is none
    most: int  # up to where there would have been said to be one
    sectors: tuple[int, ...]  # `nearest`, or `UNKNOWN_CM` where nothing is said of a sector


NOTHING_KNOWN = (UNKNOWN_CM,) * SECTORS


def ranges_of(verdict: Verdict, lens: Lens, assumed_m: float) -> Ranges | None:
    """A verdict in distances, or None of one that is unknown.

    A clear is one of the sectors that are wholly in view. An obstacle is in every sector that its
    box touches, or in all of the view where the verdict does not say in which picture its box is;
    of the rest of that view nothing is said: an obstacle's verdict judged the frame, not each of
    its columns. Where nothing was measured `assumed_m` is said.
    """
    if verdict.status == CLEAR:
        most = _cm(_reach_m(verdict.method, assumed_m))
        return Ranges(most + 1, most, _spread(most + 1, sectors_within(*lens.edges_deg)))
    if verdict.status == OBSTACLE:
        nearest, most = _obstacle_cm(verdict, assumed_m)
        return Ranges(nearest, most, _spread(nearest, sectors_touching(*_span_deg(verdict, lens))))
    return None


def _reach_m(method: str, otherwise_m: float) -> float:
    """Metres up to which a method, which may be two joined by ``+``, measures."""
    measured = [MEASURED_TO_M[part] for part in method.split("+") if part in MEASURED_TO_M]
    return max(measured, default=otherwise_m)


def _obstacle_cm(verdict: Verdict, assumed_m: float) -> tuple[int, int]:
    """The obstacle's distance, and the range it is in.

    It is kept inside the range, since an obstacle at its very end is taken for none by PX4, and
    one beyond it by ArduPilot too.
    """
    distance_m = verdict.distance_m
    if distance_m is None or not math.isfinite(distance_m):
        return _cm(assumed_m) - 1, _cm(assumed_m)
    most = _cm(_reach_m(verdict.method, max(MEASURED_TO_M.values())))
    return min(max(_cm(distance_m), NEAREST_CM), most - 1), most


def _span_deg(verdict: Verdict, lens: Lens) -> tuple[float, float]:
    """The obstacle's left and right edge as directions."""
    if verdict.box is None or verdict.mask_size is None:
        return lens.edges_deg
    x0, _, box_width, _ = verdict.box
    width = verdict.mask_size[1]
    return lens.angle_deg(x0 / width), lens.angle_deg((x0 + box_width) / width)


def _cm(metres: float) -> int:
    """Whole centimetres, rounded towards the nearer."""
    return math.floor(100 * min(max(metres, 0.0), 600.0) + 1e-6)


def _spread(distance_cm: int, sectors: list[int]) -> tuple[int, ...]:
    said = list(NOTHING_KNOWN)
    for index in sectors:
        said[index] = distance_cm
    return tuple(said)


HEARTBEAT_S = 1.0

_VARIANCE_UNKNOWN = 255
_QUALITY_UNKNOWN = 0
_DEVICE = re.compile(r"udpout:(.+)")


class Messages(StrEnum):
    """The MAVLink messages that carry the distances."""

    BOTH = "both"
    OBSTACLE_DISTANCE = "obstacle_distance"
    DISTANCE_SENSOR = "distance_sensor"


class WhenUnknown(StrEnum):
    """Choices of what is sent for an unknown verdict, besides the heartbeat."""

    SILENCE = "silence"
    MESSAGE = "message"
    """OBSTACLE_DISTANCE with every sector unknown: for PX4, not for ArduPilot."""


@dataclass(frozen=True)
class MavlinkOptions:
    """Settings by which verdicts become distances, and the MAVLink ids of their sender.

    Parameters
    ----------
    lens : Lens
        Of the left camera, in water.
    assumed_m : float
        Metres to an obstacle whose distance nothing measured, and up to which a clear holds that
        no stereo detector gave.
    system, component : int
        MAVLink's numbers of the sender.
    messages : Messages
    unknown : WhenUnknown

    Raises
    ------
    ToktError
        If a number is not one MAVLink has, or the distance is not 0.1 to 100 m.
    """

    lens: Lens
    assumed_m: float = OutputConfig.mavlink_assumed_m
    system: int = OutputConfig.mavlink_system
    component: int = OutputConfig.mavlink_component
    messages: Messages = Messages.BOTH
    unknown: WhenUnknown = WhenUnknown.SILENCE

    def __post_init__(self) -> None:
        if not 0.1 <= self.assumed_m <= 100:
            raise ToktError(f"an assumed distance is 0.1 to 100 m, not {self.assumed_m:g}")
        for name, number in (("system", self.system), ("component", self.component)):
            if not 1 <= number <= 255:
                raise ToktError(f"a MAVLink {name} is numbered 1 to 255, not {number}")


def parse_device(text: str) -> tuple[str, int]:
    """Read ``udpout:HOST:PORT``, as pymavlink and MAVProxy write a UDP address to send to.

    Raises
    ------
    ToktError
        If it is something else; another kind of link needs a router such as mavlink-router.
    """
    match = _DEVICE.fullmatch(text.strip())
    if match is None:
        raise ToktError(
            f"not a MAVLink address: {text!r} (write udpout:HOST:PORT; what speaks MAVLink over "
            "another link is reached through a MAVLink router)"
        )
    return parse_address(match[1])


class MavlinkSender(DatagramSocket):
    """Send verdicts as MAVLink messages to one address, one message a datagram.

    A heartbeat goes out with the first report a second after the one before. It is no thread's
    own: a loop that says nothing any more has no heartbeat either.

    Parameters
    ----------
    host, port
        As of `DatagramSocket`.
    options : MavlinkOptions
    clock : Clock
        Its `monotonic` stamps the messages, as time since boot; what day it is does not matter.

    Raises
    ------
    ToktError
        If the host name is not known, or pymavlink is not installed.
    """

    def __init__(self, host: str, port: int, options: MavlinkOptions, clock: Clock) -> None:
        try:
            from pymavlink.dialects.v20 import common  # in version 2's framing
        except ImportError:
            wanted = "MAVLink needs the extra 'mavlink': pip install 'tokt[mavlink]'"
            raise ToktError(wanted) from None
        self._words: ModuleType = common
        super().__init__(host, port)
        self.options = options
        self._clock = clock
        self._heartbeat_due = -math.inf
        self._stamp_us = 0
        # It numbers and frames what it is given, and writes that to this socket.
        self._link = self._words.MAVLink(self, options.system, options.component)

    def send(self, report: Report) -> None:
        """Send what a report comes to in distances, and a heartbeat when one is due."""
        now = self._clock.monotonic()
        if now >= self._heartbeat_due:
            self._heartbeat_due = now + HEARTBEAT_S
            self._send_heartbeat(report)
        age_ms = report.age_ms or 0.0  # since the frame arrived, where that is known
        known = math.isfinite(age_ms) and age_ms > 0
        taken = max(now - age_ms / 1000, 0.0) if known else max(now, 0.0)
        self._stamp_us = max(self._stamp_us, int(1e6 * taken))
        ranges = ranges_of(report.verdict, self.options.lens, self.options.assumed_m)
        if ranges is None:
            self._tell_unknown()
            return
        # This order: ArduPilot keeps what the last of the two said of the sectors ahead.
        if self.options.messages is not Messages.OBSTACLE_DISTANCE:
            self._send_distance(ranges, report.verdict.mask_size)
        if self.options.messages is not Messages.DISTANCE_SENSOR:
            self._send_sectors(ranges.sectors, ranges.most)

    def _send_heartbeat(self, report: Report) -> None:
        words = self._words
        state = words.MAV_STATE_ACTIVE
        if report.verdict.status == UNKNOWN:
            starting = report.verdict.reason is Reason.NO_FRAME
            state = words.MAV_STATE_BOOT if starting else words.MAV_STATE_CRITICAL
        kind, none = words.MAV_TYPE_ONBOARD_CONTROLLER, words.MAV_AUTOPILOT_INVALID
        self._link.heartbeat_send(kind, none, 0, 0, state)

    def _tell_unknown(self) -> None:
        by_message = self.options.unknown is WhenUnknown.MESSAGE
        # DISTANCE_SENSOR is never sent: its quality "invalid" is read by no one but rangefinders.
        if by_message and self.options.messages is not Messages.DISTANCE_SENSOR:
            self._send_sectors(NOTHING_KNOWN, NEAREST_CM + 1)

    def _send_sectors(self, sectors: tuple[int, ...], most_cm: int) -> None:
        words = self._words
        self._link.obstacle_distance_send(
            self._stamp_us,
            words.MAV_DISTANCE_SENSOR_UNKNOWN,
            sectors,
            int(SECTOR_DEG),
            NEAREST_CM,
            most_cm,
            increment_f=SECTOR_DEG,
            angle_offset=0.0,
            frame=words.MAV_FRAME_BODY_FRD,
        )

    def _send_distance(self, ranges: Ranges, mask_size: tuple[int, int] | None) -> None:
        words, lens = self._words, self.options.lens
        height_deg = 0.0 if mask_size is None else lens.fov_deg(mask_size[0] / mask_size[1])
        self._link.distance_sensor_send(
            self._stamp_us // 1000 % 2**32,
            NEAREST_CM,
            ranges.most,
            ranges.nearest,
            words.MAV_DISTANCE_SENSOR_UNKNOWN,
            0,
            words.MAV_SENSOR_ROTATION_NONE,
            _VARIANCE_UNKNOWN,
            horizontal_fov=math.radians(lens.fov_deg()),
            vertical_fov=math.radians(height_deg),
            signal_quality=_QUALITY_UNKNOWN,
        )
